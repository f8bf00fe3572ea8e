//! Robust costs over the world position of one landmark.

use crate::optim::robust::{Robust, geman_mcclure};
use nalgebra::{Matrix3, Vector3};
use std::ops::Add;

/// A robust cost over a position in the world, to second order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PositionCost {
    /// Robust half of the squared residual.
    pub cost: f64,
    /// Derivative of the cost, per m.
    pub gradient: Vector3<f64>,
    /// Gauss-Newton approximation of the second derivative, per m^2; positive semi-definite.
    pub hessian: Matrix3<f64>,
}

impl Add for PositionCost {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            cost: self.cost + other.cost,
            gradient: self.gradient + other.gradient,
            hessian: self.hessian + other.hessian,
        }
    }
}

/// Geman-McClure cost of the distance between `position` and a triangulated `point`, in units of `sigma` (m per axis).
///
/// `robust_scale`: in standard deviations, see [`geman_mcclure`].
pub fn point_cost(position: &Vector3<f64>, point: &Vector3<f64>, sigma: f64, robust_scale: f64) -> PositionCost {
    let residual = (position - point) / sigma;
    let Robust { cost, weight, .. } = geman_mcclure(residual.norm_squared(), robust_scale);
    PositionCost {
        cost,
        gradient: residual * (weight / sigma),
        hessian: Matrix3::identity() * (weight / (sigma * sigma)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residuals::derivative_check::assert_gradient;

    /// At 0.17 and 3.5 robust scales.
    #[test]
    fn gradient_matches_differences_for_inlier_and_outlier() {
        let position = Vector3::new(0.3, -0.2, 0.4);
        for off in [0.012, 0.24] {
            let cost = |d: &[f64]| {
                point_cost(&(position + Vector3::from_column_slice(d)), &(position + Vector3::repeat(off)), 0.03, 4.0)
            };
            assert_gradient(cost(&[0.0; 3]).gradient.as_slice(), |d| cost(d).cost);
        }
    }
}
