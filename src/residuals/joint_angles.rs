//! Cost of one joint's rotation vector: a pull towards rest, and walls at the ends of its range.

use crate::body::joint_ranges::JointRange;
use crate::geometry::rotation;
use nalgebra::{Matrix3, Vector3};

/// A cost over a joint's right increment `R <- R exp(d)`, to second order: `cost + gradient . d + d^T hessian d / 2`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct JointAngleCost {
    /// Half the sum of squared residuals.
    pub cost: f64,
    /// Derivative of the cost, per rad.
    pub gradient: Vector3<f64>,
    /// Gauss-Newton approximation of the second derivative, per rad^2; positive semi-definite.
    pub hessian: Matrix3<f64>,
}

/// Weights of the cost of joint angles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointAngleWeights {
    /// Factor on the squared distance from rest in standard deviations.
    pub rest: f64,
    /// Width of the walls, rad: one such step over the limit costs a residual of 1.
    pub limit_width: f64,
}

/// Cost of one joint's `rotation` with its derivatives.
///
/// With `v = log(R)`, per component: `(v - rest) / spread` weighted by `weights.rest`, and the hinge
/// `max(0, v - max, min - v) / limit_width`. Derivative of both: `d v / d d = J_r^-1(v)` (method.md 9.2).
///
/// Known limit: near a rotation of pi `v` jumps to the other side. Only the pelvis, which has no such cost, gets there.
pub fn joint_angle_cost(rotation: &Matrix3<f64>, range: &JointRange, weights: &JointAngleWeights) -> JointAngleCost {
    let v = rotation::log(rotation);
    let (mut cost, mut slope, mut curvature) = (0.0, Vector3::zeros(), Vector3::zeros());
    for axis in 0..3 {
        let precision = weights.rest / (range.spread[axis] * range.spread[axis]);
        let from_rest = v[axis] - range.rest[axis];
        let over = (v[axis] - range.max[axis]).max(0.0) + (v[axis] - range.min[axis]).min(0.0);
        let wall = if over == 0.0 { 0.0 } else { 1.0 / (weights.limit_width * weights.limit_width) };
        cost += 0.5 * (precision * from_rest * from_rest + wall * over * over);
        slope[axis] = precision * from_rest + wall * over;
        curvature[axis] = precision + wall;
    }
    if curvature == Vector3::zeros() {
        return JointAngleCost::default(); // within all walls, and not drawn to rest
    }
    let jacobian = rotation::right_jacobian_inverse(&v);
    let hessian = jacobian.transpose() * Matrix3::from_diagonal(&curvature) * jacobian;
    JointAngleCost { cost, gradient: jacobian.transpose() * slope, hessian }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::joint_ranges::joint_ranges;
    use crate::residuals::derivative_check::assert_gradient;

    #[test]
    fn gradient_matches_differences_in_and_out_of_range() {
        let weights = JointAngleWeights { rest: 0.3, limit_width: 0.1 };
        for range in &joint_ranges()[1..22] {
            for v in [Vector3::new(0.1, 0.05, -0.1), Vector3::new(1.4, -0.9, 0.8)] {
                let at = |d: &[f64]| {
                    let increment = rotation::exp(&Vector3::from_column_slice(d));
                    joint_angle_cost(&(rotation::exp(&v) * increment), range, &weights)
                };
                assert_gradient(at(&[0.0; 3]).gradient.as_slice(), |d| at(d).cost);
            }
        }
    }

    #[test]
    fn rest_costs_zero_and_a_wall_half_at_its_width() {
        let range = joint_ranges()[4];
        let weights = JointAngleWeights { rest: 0.0, limit_width: 0.1 };
        assert_eq!(joint_angle_cost(&rotation::exp(&range.rest), &range, &weights).cost, 0.0);
        let over = rotation::exp(&Vector3::new(range.max.x + 0.1, 0.0, 0.0));
        assert!((joint_angle_cost(&over, &range, &weights).cost - 0.5).abs() < 1e-9);
    }
}
