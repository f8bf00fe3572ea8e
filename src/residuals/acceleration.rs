//! Accelerations from three successive frames: of positions and of joint rotations.

use crate::geometry::rotation;
use crate::optim::robust::{Robust, charbonnier};
use nalgebra::{Matrix3, Vector3};

/// Coefficients of three successive positions in their second difference.
pub const SECOND_DIFFERENCE: [f64; 3] = [1.0, -2.0, 1.0];

/// Second difference of three successive positions; over the squared frame interval it is the acceleration in the middle.
pub fn second_difference([a, b, c]: [Vector3<f64>; 3]) -> Vector3<f64> {
    a - b * 2.0 + c
}

/// Cost and weight of an acceleration over its standard deviation, `squared` being its squared length.
///
/// [`charbonnier`] at `knee` standard deviations: `knee^2 (r - 1)` and `1 / r`, `r = sqrt(1 + squared / knee^2)`.
pub fn acceleration_cost(squared: f64, knee: f64) -> Robust {
    charbonnier(1.0, squared, knee.powi(2))
}

/// A step `e` between two successive rotations ([`rotation::step`]) with its derivatives by their right increments (method.md 9.2):
/// `J_r^-1(e)` by that of the later one, `-J_r^-1(-e) = -J_r^-1(e)^T` by that of the earlier one. The difference of two successive steps is
/// zero for a constant rotation rate; over `dt^2` it is an angular acceleration, in the joint's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinearRotationStep {
    /// rad.
    pub value: Vector3<f64>,
    /// By the increment of the later rotation.
    pub by_later: Matrix3<f64>,
}

impl LinearRotationStep {
    /// The step between two successive rotations.
    pub fn new(earlier: &Matrix3<f64>, later: &Matrix3<f64>) -> Self {
        let value = rotation::step(earlier, later);
        Self { value, by_later: rotation::right_jacobian_inverse(&value) }
    }
}

/// Derivatives of the difference of two successive steps, `after - before`, by the increments of the earlier, middle and later rotation.
pub fn jacobians_of_change(before: &LinearRotationStep, after: &LinearRotationStep) -> [Matrix3<f64>; 3] {
    [before.by_later.transpose(), -after.by_later.transpose() - before.by_later, after.by_later]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residuals::derivative_check::assert_derivative;
    use nalgebra::DMatrix;

    #[test]
    fn constant_rotation_rate_has_no_change() {
        let (start, step) = (rotation::exp(&Vector3::new(0.3, 1.0, -0.2)), rotation::exp(&Vector3::new(0.1, 0.0, 0.3)));
        let [before, after] = [start, start * step].map(|from| rotation::step(&from, &(from * step)));
        assert!((after - before).norm() < 1e-12 && (before - rotation::log(&step)).norm() < 1e-12);
    }

    #[test]
    fn free_fall_accelerates_with_gravity() {
        let at = |t: f64| Vector3::new(2.0 * t, 1.0 - 0.5 * 9.81 * t * t, 0.0);
        let found = second_difference([at(0.0), at(0.04), at(0.08)]) / (0.04 * 0.04);
        assert!((found - Vector3::new(0.0, -9.81, 0.0)).norm() < 1e-9);
    }

    #[test]
    fn rotation_derivatives_match_central_differences() {
        let turns = [Vector3::new(0.3, 1.0, -0.2), Vector3::new(0.5, 0.7, 0.1), Vector3::new(-0.1, 0.9, 0.4)];
        let rotations = turns.map(|w| rotation::exp(&w));
        let step = |k: usize| LinearRotationStep::new(&rotations[k], &rotations[k + 1]);
        let jacobians = jacobians_of_change(&step(0), &step(1));
        let jacobian = DMatrix::from_fn(3, 9, |row, column| jacobians[column / 3][(row, column % 3)]);
        assert_derivative(&jacobian, |d| {
            let moved: [Matrix3<f64>; 3] = std::array::from_fn(|k| {
                rotations[k] * rotation::exp(&Vector3::from_column_slice(&d[3 * k..3 * k + 3]))
            });
            (rotation::step(&moved[1], &moved[2]) - rotation::step(&moved[0], &moved[1])).as_slice().to_vec()
        });
    }
}
