use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const N_BORDER: usize = 7;
const N_LOCAL: usize = 6;

/// Residuals of one block: local unknowns in a chain, each residual touching two of them and two border unknowns.
fn linearize(i: usize, block: &mut Block) {
    let mut rng = ChaCha8Rng::seed_from_u64(i as u64);
    let columns = [(i * 3 + 4) % N_BORDER, (i * 3 + 1) % N_BORDER, (i * 3) % N_BORDER];
    block.reset(N_LOCAL, &columns);
    for r in 0..24 {
        let mut column =
            |index| Column { index, derivative: [rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0)] };
        let local = [column(r % N_LOCAL), column((r + 1) % N_LOCAL)];
        let border = [column(r % 3), column((r + 1) % 3)];
        let residual = [rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0)];
        block.add_residual(0.5 + r as f64 * 0.1, &residual, &local, &border);
        block.add_cost(residual[0] * residual[0]);
    }
}

/// The whole system, assembled: border first, then the blocks.
fn dense_system(n_blocks: usize, damping: f64) -> (DMatrix<f64>, DVector<f64>) {
    let n = N_BORDER + n_blocks * N_LOCAL;
    let (mut hessian, mut gradient) = (DMatrix::zeros(n, n), DVector::zeros(n));
    for i in 0..n_blocks {
        let mut block = Block::default();
        linearize(i, &mut block);
        let place: Vec<usize> =
            (0..N_LOCAL).map(|k| N_BORDER + i * N_LOCAL + k).chain(block.columns.iter().copied()).collect();
        let m = block.width;
        let value = |a: usize, b: usize| match (a.checked_sub(N_LOCAL), b.checked_sub(N_LOCAL)) {
            (None, None) => block.hessian[a.max(b) * N_LOCAL + a.min(b)],
            (None, Some(b)) => block.coupling[a * m + b],
            (Some(a), None) => block.coupling[b * m + a],
            (Some(a), Some(b)) => block.border_hessian[a.max(b) * m + a.min(b)],
        };
        for a in 0..place.len() {
            gradient[place[a]] += if a < N_LOCAL { block.gradient[a] } else { block.border_gradient[a - N_LOCAL] };
            for b in 0..place.len() {
                hessian[(place[a], place[b])] += value(a, b);
            }
        }
    }
    for k in 0..n {
        hessian[(k, k)] *= 1.0 + damping;
    }
    (hessian, gradient)
}

#[test]
fn elimination_solves_the_whole_system_exactly() {
    let (n_blocks, damping) = (9, 0.01);
    let (hessian, gradient) = dense_system(n_blocks, damping);
    let expected = hessian.lu().solve(&-gradient).unwrap();

    let reduced = reduce(n_blocks, N_BORDER, damping, linearize);
    let border_step = reduced.hessian.cholesky().unwrap().solve(&-reduced.gradient);
    let local = back_substitute(n_blocks, damping, &border_step, linearize, |_, _, step| step.to_vec());

    let found = DVector::from_iterator(expected.len(), border_step.iter().copied().chain(local.into_iter().flatten()));
    assert!((found - expected).amax() < 1e-9);
}

#[test]
fn one_and_two_threads_give_the_same_bits() {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| reduce(200, N_BORDER, 1e-3, linearize))
    };
    assert_eq!(run(1), run(2));
}

/// Eight unknowns of each of 300 people: 64 portions had 3 GB.
#[test]
fn sums_of_portions_grew_with_the_square_of_the_border() {
    assert!([0, 1, 7, 300, 1024].iter().all(|&n| n_portions(n) == MAX_PORTIONS));
    assert_eq!([2400, 8000, usize::MAX].map(n_portions), [11, 1, 1]);
}

#[test]
fn an_unobserved_unknown_does_not_move() {
    let with_idle = |i: usize, block: &mut Block| {
        block.reset(3, &[0]);
        let local = [Column { index: 0, derivative: [1.0] }, Column { index: 2, derivative: [2.0] }];
        block.add_residual(1.0, &[1.0 + i as f64], &local, &[Column { index: 0, derivative: [1.0] }]);
        block.add_residual(1.0, &[0.5], &local[..1], &[]);
        block.add_residual(1.0, &[-0.5], &local[1..], &[]);
    };
    let reduced = reduce(4, 1, 0.0, with_idle);
    let step = reduced.hessian.clone().cholesky().unwrap().solve(&-&reduced.gradient);
    for local in back_substitute(4, 0.0, &step, with_idle, |_, _, step| step.to_vec()) {
        assert!(local[1] == 0.0 && local.iter().all(|v| v.is_finite()));
    }
}

#[test]
fn elimination_of_a_tree_has_no_fill_in() {
    // A star with centre 0 and a tail 3-4: every eliminated vertex has at most one neighbour left.
    let edges = [(0, 1), (0, 2), (0, 3), (3, 4)];
    let order = elimination_order(5, edges);
    let place = |v| order.iter().position(|&o| o == v).unwrap();
    for v in 0..5 {
        let later = edges.iter().filter(|&&(a, b)| (a == v && place(b) > place(v)) || (b == v && place(a) > place(v)));
        assert!(later.count() <= 1);
    }
}

/// Two blocks that differ in how their residuals are added.
fn with_spans(i: usize, block: &mut Block, in_spans: bool) {
    let mut rng = ChaCha8Rng::seed_from_u64(i as u64);
    block.reset(N_LOCAL, &[4, 5, 6, 0, 1, 2]);
    for r in 0..12 {
        let mut by = || [0, 1].map(|_| [0, 1, 2].map(|_| rng.random_range(-1.0..1.0)));
        let local = Span { first: 3 * (r % 2), derivatives: by() };
        let border = Span { first: 3 * (r / 2 % 2), derivatives: by() };
        let residual = [rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0)];
        let columns = |span: &Span<2, 3>| {
            [0, 1, 2].map(|k| Column { index: span.first + k, derivative: span.derivatives.map(|row| row[k]) })
        };
        if in_spans {
            block.add_spans(0.7, &residual, &local, &border);
        } else {
            block.add_residual(0.7, &residual, &columns(&local), &columns(&border));
        }
    }
}

#[test]
fn spans_are_columns_that_follow_each_other() {
    let of = |in_spans: bool| {
        let linearize = |i: usize, block: &mut Block| with_spans(i, block, in_spans);
        let reduced = reduce(3, N_BORDER, 0.01, linearize);
        let border_step = DVector::from_fn(N_BORDER, |k, _| 0.3 * k as f64 - 1.0);
        let local = back_substitute(3, 0.01, &border_step, linearize, |_, _, step| step.to_vec());
        (reduced.hessian, reduced.gradient, DVector::from_vec(local.concat()))
    };
    let (spans, columns) = (of(true), of(false));
    assert!((spans.0 - columns.0).amax() < 1e-12);
    assert!((spans.1 - columns.1).amax() < 1e-12);
    assert!((spans.2 - columns.2).amax() < 1e-12);
}
