use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::PI;

fn random_direction(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0)).normalize()
}

/// Directions times angles from the smallest to those just below pi.
fn turns() -> Vec<Vector3<f64>> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let angles = [0.0, 1e-12, 1e-7, 0.99e-4, 1.01e-4, 1e-3, 0.1, 1.0, 2.0, 3.0, PI - 1e-4, PI - 1e-7];
    angles.iter().flat_map(|t| [random_direction(&mut rng) * *t, random_direction(&mut rng) * *t]).collect()
}

#[test]
fn a_quarter_turn_about_z_takes_x_to_y() {
    let quarter = exp(&Vector3::new(0.0, 0.0, 0.5 * PI));
    assert!((quarter * Vector3::x() - Vector3::y()).norm() < 1e-15);
}

#[test]
fn log_undoes_exp_near_zero_and_near_pi() {
    for w in turns() {
        assert!((log(&exp(&w)) - w).norm() < 1e-12, "{w}");
        assert!((exp(&w).transpose() * exp(&w) - Matrix3::identity()).norm() < 1e-14);
    }
    let half = exp(&(Vector3::y() * PI));
    assert!((log(&half).norm() - PI).abs() < 1e-14);
}

/// On either side of where the power series end.
#[test]
fn series_meet_the_closed_forms() {
    let direction = Vector3::new(2.0, 1.0, -2.0) / 3.0;
    for k in 1..400 {
        let w = direction * (0.005 * f64::from(k));
        assert!((log(&exp(&w)) - w).norm() < 2e-15, "{w}");
        assert!((left_jacobian_inverse(&w) * left_jacobian(&w) - Matrix3::identity()).norm() < 1e-14, "{w}");
    }
}

#[test]
fn jacobians_agree_with_central_differences() {
    let step = 1e-6;
    for w in turns() {
        let (left, right) = (left_jacobian(&w), right_jacobian(&w));
        for axis in 0..3 {
            let mut d = Vector3::zeros();
            d[axis] = step;
            let (ahead, behind) = (exp(&(w + d)), exp(&(w - d)));
            let by_left = log(&(ahead * behind.transpose())) / (2.0 * step);
            let by_right = log(&(behind.transpose() * ahead)) / (2.0 * step);
            assert!((by_left - left.column(axis)).norm() < 1e-9, "{w}");
            assert!((by_right - right.column(axis)).norm() < 1e-9, "{w}");
        }
    }
}

#[test]
fn inverse_jacobians_are_the_inverses() {
    for w in turns() {
        assert!((left_jacobian(&w) * left_jacobian_inverse(&w) - Matrix3::identity()).norm() < 1e-12, "{w}");
        assert!((right_jacobian(&w) * right_jacobian_inverse(&w) - Matrix3::identity()).norm() < 1e-12, "{w}");
    }
}

#[test]
fn angles_between_rotations_are_exact_to_the_ends() {
    let base = exp(&Vector3::new(0.3, -0.2, 0.9));
    for t in [0.0, 1e-9, 0.5, 3.0, PI - 1e-9] {
        let turned = base * exp(&(Vector3::new(2.0, 1.0, -2.0) / 3.0 * t));
        assert!((angle_between(&base, &turned) - t).abs() < 1e-14, "{t}");
    }
}

#[test]
fn an_increment_changes_the_trace_by_the_axial_vector() {
    let (m, e) = (exp(&Vector3::new(0.4, -0.9, 0.2)), Vector3::new(0.5, 0.1, -0.7));
    let slope = ((m * exp(&(e * 1e-6))).trace() - (m * exp(&(e * -1e-6))).trace()) / 2e-6;
    assert!((slope + e.dot(&axial(&m))).abs() < 1e-9);
}

#[test]
fn rotation_between_is_the_smallest_one() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for gap in [0.0, 1e-14, 1e-9, 1e-5, 0.1, 1.0] {
        let a = random_direction(&mut rng);
        let tilt = exp(&(any_perpendicular(&a) * gap));
        for b in [tilt * a, -(tilt * a)] {
            let turn = rotation_between(&(a * 3.0), &(b * 0.2));
            assert!((turn * a - b).norm() < 1e-14, "{gap}: {}", (turn * a - b).norm());
            assert!((angle_between(&turn, &Matrix3::identity()) - a.angle(&b)).abs() < 1e-7, "the smallest one");
        }
    }
    assert_eq!(rotation_between(&Vector3::zeros(), &Vector3::x()), Matrix3::identity());
}
