//! The angular acceleration of a joint from three successive rotations.

use crate::geometry::rotation;
use nalgebra::{Matrix3, Vector3};

/// Change of turn between two successive steps, and its derivatives to the right increments of the three rotations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TurnChange {
    /// rad per frame interval squared.
    pub value: Vector3<f64>,
    /// To the earlier, middle and later rotation's increment.
    pub jacobians: [Matrix3<f64>; 3],
}

/// `log(R_b^T R_c) - log(R_a^T R_b)`: zero for a steady turn, over `dt^2` an angular acceleration in the joint's frame.
///
/// Derivatives of `e = log(R_1^T R_2)` (method.md 9.2): `J_r^-1(e)` to the second increment, `-J_r^-1(-e)` to the first.
/// Known limit: turns of more than half a circle within one frame are taken the short way round.
pub fn turn_change(earlier: &Matrix3<f64>, middle: &Matrix3<f64>, later: &Matrix3<f64>) -> TurnChange {
    let before = rotation::log(&(earlier.transpose() * middle));
    let after = rotation::log(&(middle.transpose() * later));
    TurnChange {
        value: after - before,
        jacobians: [
            rotation::right_jacobian_inverse(&-before),
            -rotation::right_jacobian_inverse(&-after) - rotation::right_jacobian_inverse(&before),
            rotation::right_jacobian_inverse(&after),
        ],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_steady_turn_changes_nothing() {
        let (start, step) = (rotation::exp(&Vector3::new(0.3, 1.0, -0.2)), rotation::exp(&Vector3::new(0.1, 0.0, 0.3)));
        assert!(turn_change(&start, &(start * step), &(start * step * step)).value.norm() < 1e-12);
    }

    #[test]
    fn derivatives_agree_with_central_differences() {
        let turns = [Vector3::new(0.3, 1.0, -0.2), Vector3::new(0.5, 0.7, 0.1), Vector3::new(-0.1, 0.9, 0.4)];
        let rotations = turns.map(|w| rotation::exp(&w));
        let jacobians = turn_change(&rotations[0], &rotations[1], &rotations[2]).jacobians;
        for which in 0..3 {
            for axis in 0..3 {
                let at = |h: f64| {
                    let mut r = rotations;
                    r[which] *= rotation::exp(&Vector3::ith(axis, h));
                    turn_change(&r[0], &r[1], &r[2]).value
                };
                let difference = (at(1e-6) - at(-1e-6)) / 2e-6;
                assert!((difference - jacobians[which].column(axis)).norm() < 1e-8);
            }
        }
    }
}
