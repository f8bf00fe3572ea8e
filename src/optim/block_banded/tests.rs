use super::*;
use nalgebra::DMatrixView;
use rand::{RngExt, SeedableRng};

/// Jacobian of rows over the unknowns of three successive frames and the border, added to the band and to a dense system.
struct Both {
    system: BlockBanded,
    dense: DMatrix<f64>,
    gradient: DVector<f64>,
    n: usize,
    n_frames: usize,
}

impl Both {
    fn zeros(n_frames: usize, n_groups: usize, n_border: usize) -> Self {
        let n = 3 * n_groups;
        let n_all = n * n_frames + n_border;
        let system = BlockBanded::zeros(n_frames, n_groups, n_border);
        Self { system, dense: DMatrix::zeros(n_all, n_all), gradient: DVector::zeros(n_all), n, n_frames }
    }

    /// Adds the square of `rows`, whose columns are the listed groups of frames (frame, group), then the border.
    fn add_square(&mut self, rows: &DMatrix<f64>, groups: &[[usize; 2]]) {
        let square = rows.tr_mul(rows);
        let n_border = self.system.layout.n_border;
        let own = 3 * groups.len();
        let border = self.n * self.n_frames;
        let places: Vec<usize> = groups
            .iter()
            .flat_map(|[t, g]| (0..3).map(move |i| [*t, *g, i]))
            .map(|[t, g, i]| self.n * t + 3 * g + i)
            .chain(border..border + if rows.ncols() > own { n_border } else { 0 })
            .collect();
        for (i, &a) in places.iter().enumerate() {
            for (j, &b) in places.iter().enumerate() {
                self.dense[(a, b)] += square[(i, j)];
            }
        }
        let block = |i: usize, k: usize| -> Matrix3<f64> { square.fixed_view::<3, 3>(3 * i, 3 * k).into() };
        for (i, &[later, row]) in groups.iter().enumerate() {
            for (k, &[earlier, column]) in groups.iter().enumerate() {
                if [later, row] >= [earlier, column] || later > earlier {
                    self.system.add_block([later, earlier], [row, column], &block(i, k));
                }
            }
            for k in 0..places.len() - own {
                let across = square.fixed_view::<1, 3>(own + k, 3 * i).into_owned();
                self.system.frame(later).add_border(k, 3 * row, &across);
            }
        }
        let corner: DMatrixView<f64> = square.view((own, own), (places.len() - own, places.len() - own));
        let mut target = self.system.corner.hessian.view_mut((0, 0), corner.shape());
        target += corner;
    }
}

/// A random positive definite system of this pattern: a sum of squares of rows within it; `mixes`: every group of a frame with
/// every group of the next two, too.
fn random_system([n_frames, n_groups, n_border]: [usize; 3], mixes: bool, seed: u64) -> Both {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut uniform = || rng.random_range(-1.0..1.0);
    let mut both = Both::zeros(n_frames, n_groups, n_border);
    let n = 3 * n_groups;
    for t in 0..n_frames {
        let groups: Vec<[usize; 2]> = (0..n_groups).map(|g| [t, g]).collect();
        both.add_square(&DMatrix::from_fn(n + 4, n + n_border, |_, _| uniform()), &groups);
    }
    for t in 0..n_frames.saturating_sub(2) {
        for g in 0..n_groups {
            let groups = [[t, g], [t + 1, g], [t + 2, g]];
            both.add_square(&DMatrix::from_fn(3, 9, |_, _| uniform()), &groups);
        }
        let all: Vec<[usize; 2]> = (t..t + 3).flat_map(|t| (0..n_groups).map(move |g| [t, g])).collect();
        let ends: Vec<[usize; 2]> = (t..t + 3).flat_map(|t| [[t, 0], [t, n_groups - 1]]).collect();
        let groups = if mixes { all } else { ends };
        both.add_square(&DMatrix::from_fn(3, 3 * groups.len(), |_, _| uniform()), &groups);
    }
    for t in 0..n_frames {
        let part = nalgebra::SVector::<f64, 3>::from_fn(|_, _| uniform());
        for g in 0..n_groups {
            both.system.frame(t).add_gradient(3 * g, &part);
            both.gradient.fixed_rows_mut::<3>(n * t + 3 * g).copy_from(&part);
        }
    }
    both.system.corner.gradient = DVector::from_fn(n_border, |_, _| uniform());
    both.gradient.rows_mut(n * n_frames, n_border).copy_from(&both.system.corner.gradient);
    both
}

/// A system whose terms across runs ask something of the diagonals of the two frames before.
struct Copied<'a> {
    whole: &'a BlockBanded,
}

const ACROSS: f64 = 0.25;

impl Fill for Copied<'_> {
    type Rest = usize;

    fn within(&self, frames: Range<usize>, panels: &mut [FramePanel], n_frames: &mut usize) {
        let mut whole = self.whole.clone();
        let is_last = frames.end == whole.n_frames();
        let rows = frames.len();
        *n_frames += rows;
        for (i, (panel, source)) in panels.iter_mut().zip(&mut whole.frames()[frames]).enumerate() {
            panel.clear();
            panel.values.copy_from_slice(source.values);
            panel.starts.copy_from_slice(source.starts);
            if i + 2 >= rows && !is_last {
                panel.add_to_diagonal(-ACROSS);
            }
        }
    }

    fn across(&self, first: usize, panels: &mut [FramePanel], _n_frames: &mut usize) {
        assert_eq!(panels.len(), 4 - usize::from(first + 1 == self.whole.n_frames()));
        panels[..2].iter_mut().for_each(|panel| panel.add_to_diagonal(ACROSS));
    }
}

#[test]
fn filled_run_by_run_is_the_same_factor_with_any_threads() {
    for n_frames in [1, 2, 3, 4, 5, 9, 16, 17, 38] {
        let whole = random_system([n_frames, 5, 4], true, 11).system;
        let expected = whole.clone().solve(0.01).unwrap();
        let by_threads = [1, 2, 8].map(|n_threads| {
            let (mut filled, mut n_filled) = (BlockBanded::default(), [0; N_RESTS]);
            filled.resize(n_frames, 5, 4);
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
            pool.install(|| filled.fill_and_eliminate(0.01, &Copied { whole: &whole }, &mut n_filled)).unwrap();
            assert_eq!(n_filled.iter().sum::<usize>(), n_frames);
            filled.corner = whole.corner.clone();
            filled.solved(0.01).unwrap()
        });
        for found in &by_threads {
            assert_eq!((&found.frames, &found.border), (&by_threads[0].frames, &by_threads[0].border));
            let error: f64 = found.frames.iter().zip(&expected.frames).map(|(a, b)| (a - b).norm()).sum();
            assert!(error < 1e-9 && (&found.border - &expected.border).norm() < 1e-9, "{n_frames}: {error}");
        }
    }
}

#[test]
fn the_banded_solution_equals_the_dense_one() {
    let sizes = [[1, 2, 3], [2, 3, 0], [7, 9, 4], [5, 21, 10], [4, 17, 30], [6, 8, 7]];
    for (size, mixes) in sizes.into_iter().flat_map(|size| [(size, false), (size, true)]) {
        for damping in [0.0, 0.3] {
            let mut both = random_system(size, mixes, 5);
            let step = both.system.solve(damping).unwrap();
            let expected = damped(&both.dense, damping).lu().solve(&-&both.gradient).unwrap();
            let found = step.frames.iter().flat_map(|f| f.iter()).chain(step.border.iter()).copied();
            let found = DVector::from_iterator(expected.len(), found);
            assert!((found - &expected).norm() < 1e-8 * expected.norm(), "{size:?} {mixes} {damping}");
        }
    }
}

#[test]
fn a_system_is_as_new_after_a_reset_to_another_size() {
    let mut used = random_system([5, 6, 4], true, 3).system.eliminated(1.0).unwrap().into_system();
    used.reset(7, 3, 0);
    let fresh = BlockBanded::zeros(7, 3, 0);
    assert_eq!((used.layout, &used.panels[..], used.starts), (fresh.layout, &fresh.panels[..], fresh.starts));
    assert_eq!(used.corner.hessian, fresh.corner.hessian);
}

#[test]
fn rejects_indefinite_systems() {
    for value in [-1e3, f64::NAN] {
        let mut both = random_system([4, 8, 2], false, 1);
        let mut block = Matrix3::zeros();
        block[(1, 1)] = value;
        both.system.add_block([2, 2], [6, 6], &block);
        assert!(both.system.solve(0.0).is_none());
    }
}

#[test]
fn inverse_blocks_and_responses_equal_the_dense_ones() {
    for (n_frames, n_groups, n_border) in [(1, 2, 3), (2, 3, 2), (7, 9, 4)] {
        let Both { system, dense: h, .. } = random_system([n_frames, n_groups, n_border], true, 7);
        let eliminated = system.eliminated(0.0).unwrap();
        let (n, all) = (3 * n_groups, 3 * n_groups * n_frames);
        let inverse = h.view((0, 0), (all, all)).into_owned().try_inverse().unwrap();
        let follows = -&inverse * h.view((0, all), (all, n_border));
        let mut visited = 0;
        eliminated.for_each_inverse_block(|t, block, response| {
            visited += 1;
            let expected = inverse.view((n * t, n * t), (n, n));
            assert!((block - expected).norm() < 1e-8 * expected.norm(), "frame {t} of {n_frames}");
            assert!((response - follows.rows(n * t, n)).norm() < 1e-8 * follows.norm(), "frame {t} of {n_frames}");
        });
        assert_eq!(visited, n_frames);

        let columns = DMatrix::from_fn(n_border, 2, |i, j| 1.0 + i as f64 - 2.0 * j as f64);
        let expected = follows * &columns;
        for (t, response) in eliminated.responses(&columns).iter().enumerate() {
            assert!((response - expected.rows(n * t, n)).norm() < 1e-8 * expected.norm(), "frame {t} of {n_frames}");
        }
        let border = columns.column(1).into_owned();
        let step = eliminated.step(border.clone(), 0.0).unwrap();
        for (t, frame) in step.frames.iter().enumerate() {
            let expected = expected.column(1);
            assert!((frame - expected.rows(n * t, n)).norm() < 1e-8 * expected.norm(), "frame {t} of {n_frames}");
        }
        let [whole, half] = [1.0, 0.5].map(|share| eliminated.step(border.clone(), share).unwrap());
        for (t, frame) in half.frames.iter().enumerate() {
            let expected = (&whole.frames[t] + &step.frames[t]) * 0.5;
            assert!((frame - &expected).norm() < 1e-8 * expected.norm(), "frame {t} of {n_frames}");
        }
    }
}

/// Of 4,000 draws covariances err by up to 2.2 % of the standard deviations' products; four times that is beyond all 576.
#[test]
fn samples_have_the_covariance_of_the_frames() {
    let (n_frames, n_groups, n_border, n_samples) = (4, 2, 3, 4000);
    let Both { system, dense: h, .. } = random_system([n_frames, n_groups, n_border], true, 7);
    let eliminated = system.eliminated(0.0).unwrap();
    let (n, all) = (3 * n_groups, 3 * n_groups * n_frames);
    let inverse = h.view((0, 0), (all, all)).into_owned().try_inverse().unwrap();
    let border = DMatrix::identity(n_border, n_border);
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    let frames = eliminated.responses_and_samples(&border, n_samples, &mut rng);
    for (found, expected) in frames.iter().zip(eliminated.responses(&border)) {
        assert!((found.columns(0, n_border) - &expected).norm() < 1e-12 * expected.norm());
    }
    for (a, b) in (0..n_frames).flat_map(|a| (0..n_frames).map(move |b| (a, b))) {
        let [left, right] = [a, b].map(|t| frames[t].columns(n_border, n_samples));
        let found = left * right.transpose() / n_samples as f64;
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let (row, column) = (n * a + i, n * b + j);
            let size = (inverse[(row, row)] * inverse[(column, column)]).sqrt();
            assert!((found[(i, j)] - inverse[(row, column)]).abs() < 0.09 * size, "{row}, {column}");
        }
    }
}

/// A smooth path that little but its accelerations holds, for long: rounding errors must not grow with its length.
#[test]
fn inverse_blocks_of_a_long_smooth_path_stay_exact() {
    let n_frames = 300;
    let mut both = Both::zeros(n_frames, 2, 0);
    let scaled = |factor: f64| DMatrix::identity(3, 3) * factor;
    let observed = DMatrix::from_row_slice(3, 3, &[0.1, 0.02, 0.0, 0.0, 0.07, 0.01, 0.0, 0.0, 0.05]);
    for t in 0..n_frames {
        both.add_square(&observed, &[[t, 0]]);
        both.add_square(&scaled(0.01), &[[t, 1]]);
    }
    let accelerations = DMatrix::from_fn(3, 9, |i, k| if k % 3 == i { [1.0, -2.0, 1.0][k / 3] } else { 0.0 });
    for t in 0..n_frames - 2 {
        (0..2).for_each(|g| both.add_square(&accelerations, &[[t, g], [t + 1, g], [t + 2, g]]));
    }
    let Both { system, dense, .. } = both;
    let inverse = dense.try_inverse().unwrap();
    system.eliminated(0.0).unwrap().for_each_inverse_block(|t, block, _| {
        let expected = inverse.view((6 * t, 6 * t), (6, 6));
        assert!((block - expected).norm() < 1e-6 * expected.norm(), "frame {t}");
    });
}

/// Of blocks that lie within a strip, over two, and in any order of rows, against blocks added one by one.
#[test]
fn products_of_derivatives_are_blocks() {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
    let mut block = |first: usize| (first, Matrix3::from_fn(|_, _| rng.random_range(-1.0..1.0)));
    let [later, earlier] = [[21, 0, 6, 9], [0, 6, 12, 21]].map(|places| places.map(&mut block));
    let (_, by_positions) = block(0);
    let [mut found, mut expected] = [0; 2].map(|_| BlockBanded::zeros(3, 8, 5));
    // After those of another point, in the same memory.
    let mut rows = Vec::new();
    append_rows(&mut rows, &earlier);
    let start = rows.len();
    append_rows(&mut rows, &later);
    let mut border = StripRows::with_room();
    border.add(1, &later[0].1);
    for lag in 0..3 {
        found.frame(0).add_product(lag, &rows[start..], &by_positions, &earlier);
        for (row, a) in &later {
            for (column, b) in &earlier {
                expected.frame(0).add_block(lag, [*row, *column], &(a.tr_mul(&by_positions) * b));
            }
        }
    }
    found.frame(0).add_border_product(&border, &by_positions, &earlier);
    for (column, b) in &earlier {
        expected.frame(0).add_border(1, *column, &(later[0].1.tr_mul(&by_positions) * b));
    }
    let layout = found.layout;
    for column in 0..layout.n {
        for row in (column..layout.n).chain(layout.frame_rows(1)..layout.border_rows() + layout.n_border) {
            let at = layout.row(row) + layout::STRIP * column;
            assert!((found.panels[at] - expected.panels[at]).abs() < 1e-12, "row {row}, column {column}");
        }
    }
    assert!(found.starts.iter().zip(&expected.starts).all(|(found, expected)| found <= expected));
}
