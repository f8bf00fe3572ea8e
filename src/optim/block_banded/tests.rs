use super::*;
use rand::{RngExt, SeedableRng};

/// A random positive definite system of this pattern: a sum of squares of rows within it.
fn random_system(n_frames: usize, n_groups: usize, n_border: usize, seed: u64) -> BlockBanded {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut uniform = || rng.random_range(-1.0..1.0);
    let n = 3 * n_groups;
    let mut system = BlockBanded::zeros(n_frames, n_groups, n_border);
    for t in 0..n_frames {
        let rows = DMatrix::from_fn(n + 4, n + n_border, |_, _| uniform());
        let square = rows.tr_mul(&rows);
        system.diagonal[t] += square.view((0, 0), (n, n));
        system.border[t] += square.view((0, n), (n, n_border));
        system.corner.hessian += square.view((n, n), (n_border, n_border));
        system.gradient[t] = DVector::from_fn(n, |_, _| uniform());
    }
    for t in 0..n_frames.saturating_sub(2) {
        for g in 0..n_groups {
            let j: [Matrix3<f64>; 3] = std::array::from_fn(|_| Matrix3::from_fn(|_, _| uniform()));
            for (i, a) in j.iter().enumerate() {
                let mut view = system.diagonal[t + i].fixed_view_mut::<3, 3>(3 * g, 3 * g);
                view += a.transpose() * a;
            }
            system.next[t].add(g, g, j[1].transpose() * j[0]);
            system.next[t + 1].add(g, g, j[2].transpose() * j[1]);
            system.after_next[t].add(g, g, j[2].transpose() * j[0]);
        }
        // A residual of two groups.
        let (g, h) = (0, n_groups - 1);
        let j: [Matrix3<f64>; 3] = std::array::from_fn(|_| Matrix3::from_fn(|_, _| uniform()));
        for (row, a) in [(g, 1.0), (h, 0.5)] {
            for (column, b) in [(g, 1.0), (h, 0.5)] {
                let block = |i: usize, k: usize| j[i].transpose() * j[k] * (a * b);
                for i in 0..3 {
                    let mut view = system.diagonal[t + i].fixed_view_mut::<3, 3>(3 * row, 3 * column);
                    view += block(i, i);
                }
                system.next[t].add(row, column, block(1, 0));
                system.next[t + 1].add(row, column, block(2, 1));
                system.after_next[t].add(row, column, block(2, 0));
            }
        }
    }
    system.corner.gradient = DVector::from_fn(n_border, |_, _| uniform());
    system
}

fn dense(system: &BlockBanded) -> (DMatrix<f64>, DVector<f64>) {
    let (n, t_count, m) = (system.diagonal[0].nrows(), system.diagonal.len(), system.corner.gradient.len());
    let mut h = DMatrix::zeros(n * t_count + m, n * t_count + m);
    let mut g = DVector::zeros(n * t_count + m);
    for t in 0..t_count {
        h.view_mut((n * t, n * t), (n, n)).copy_from(&system.diagonal[t]);
        h.view_mut((n * t, n * t_count), (n, m)).copy_from(&system.border[t]);
        h.view_mut((n * t_count, n * t), (m, n)).copy_from(&system.border[t].transpose());
        g.rows_mut(n * t, n).copy_from(&system.gradient[t]);
        for (distance, couplings) in [(1, &system.next), (2, &system.after_next)] {
            if let Some(block) = couplings.get(t).map(Coupling::dense) {
                h.view_mut((n * (t + distance), n * t), (n, n)).copy_from(&block);
                h.view_mut((n * t, n * (t + distance)), (n, n)).copy_from(&block.transpose());
            }
        }
    }
    h.view_mut((n * t_count, n * t_count), (m, m)).copy_from(&system.corner.hessian);
    g.rows_mut(n * t_count, m).copy_from(&system.corner.gradient);
    (h, g)
}

#[test]
fn the_banded_solution_equals_the_dense_one() {
    for (n_frames, n_groups, n_border) in [(1, 2, 3), (2, 3, 0), (7, 9, 4), (5, 21, 10)] {
        let system = random_system(n_frames, n_groups, n_border, 5);
        let step = system.solve(0.0).unwrap();
        let (h, g) = dense(&system);
        let expected = h.lu().solve(&-g).unwrap();
        let found: Vec<f64> = step.frames.iter().flat_map(|f| f.iter()).chain(step.border.iter()).copied().collect();
        assert!((DVector::from_vec(found) - &expected).norm() < 1e-8 * expected.norm());
    }
}

#[test]
fn rejects_indefinite_systems() {
    let mut system = random_system(4, 8, 2, 1);
    system.diagonal[2][(20, 20)] = -1.0;
    assert!(system.solve(0.0).is_none());
    system.diagonal[2][(20, 20)] = f64::NAN;
    assert!(system.solve(0.0).is_none());
}

#[test]
fn inverse_blocks_and_responses_equal_the_dense_ones() {
    for (n_frames, n_groups, n_border) in [(1, 2, 3), (2, 3, 2), (7, 9, 4)] {
        let system = random_system(n_frames, n_groups, n_border, 7);
        let eliminated = system.eliminated(0.0).unwrap();
        let (n, all) = (3 * n_groups, 3 * n_groups * n_frames);
        let (h, _) = dense(&system);
        let inverse = h.view((0, 0), (all, all)).into_owned().try_inverse().unwrap();
        let mut visited = 0;
        eliminated.for_each_inverse_block(|t, block| {
            visited += 1;
            let expected = inverse.view((n * t, n * t), (n, n));
            assert!((block - expected).norm() < 1e-8 * expected.norm(), "frame {t} of {n_frames}");
        });
        assert_eq!(visited, n_frames);

        let columns = DMatrix::from_fn(n_border, 2, |i, j| 1.0 + i as f64 - 2.0 * j as f64);
        let expected = -inverse * h.view((0, all), (all, n_border)) * &columns;
        for (t, response) in eliminated.responses(&columns).iter().enumerate() {
            assert!((response - expected.rows(n * t, n)).norm() < 1e-8 * expected.norm(), "frame {t} of {n_frames}");
        }
    }
}

/// A smooth path that little but its accelerations holds, for long: rounding errors must not grow with its length.
#[test]
fn inverse_blocks_of_a_long_smooth_path_stay_exact() {
    let n_frames = 300;
    let mut system = BlockBanded::zeros(n_frames, 2, 0);
    let identity = Matrix3::<f64>::identity();
    for t in 0..n_frames {
        let observed = Matrix3::new(1.0, 0.2, 0.0, 0.2, 0.5, 0.1, 0.0, 0.1, 0.3) * 1e-2;
        system.add_block([t, t], [0, 0], observed);
        system.add_block([t, t], [1, 1], identity * 1e-4);
        system.add_block([t, t], [1, 0], observed * 0.01);
        system.diagonal[t].fill_upper_triangle_with_lower_triangle();
    }
    for t in 0..n_frames - 2 {
        for (i, a) in [1.0, -2.0, 1.0].into_iter().enumerate() {
            for (k, b) in [1.0, -2.0, 1.0].into_iter().enumerate().take(i + 1) {
                (0..2).for_each(|g| system.add_block([t + i, t + k], [g, g], identity * (a * b)));
            }
        }
    }
    let inverse = dense(&system).0.try_inverse().unwrap();
    system.eliminated(0.0).unwrap().for_each_inverse_block(|t, block| {
        let expected = inverse.view((6 * t, 6 * t), (6, 6));
        assert!((block - expected).norm() < 1e-6 * expected.norm(), "frame {t}");
    });
}
