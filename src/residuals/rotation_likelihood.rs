//! Cost of one joint's rotation under a Gaussian over its right increments.

use crate::geometry::rotation::{right_jacobian_inverse, step};
use nalgebra::{Matrix3, Vector3};

/// A Gaussian over rotations: `R = M exp(e)`, `e ~ N(0, P^-1)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RotationGaussian {
    /// M.
    pub mean: Matrix3<f64>,
    /// P, rad^-2.
    pub precision: Matrix3<f64>,
}

/// Derivatives of [`rotation_cost`] by the right increment of the rotation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RotationDerivatives {
    /// Per rad.
    pub gradient: Vector3<f64>,
    /// Gauss-Newton approximation of the second derivative, per rad^2; positive semi-definite.
    pub hessian: Matrix3<f64>,
}

/// `e^T P e / 2` with `e = log(M^T R)`.
pub fn rotation_cost(rotation: &Matrix3<f64>, gaussian: &RotationGaussian) -> f64 {
    let off = step(&gaussian.mean, rotation);
    0.5 * off.dot(&(gaussian.precision * off))
}

/// Derivatives of [`rotation_cost`]: `J^T P e` and `J^T P J` with `J = J_r^-1(e)` (method.md 9.2).
pub fn rotation_derivatives(rotation: &Matrix3<f64>, gaussian: &RotationGaussian) -> RotationDerivatives {
    let off = step(&gaussian.mean, rotation);
    let jacobian = right_jacobian_inverse(&off);
    let pulled = jacobian.tr_mul(&gaussian.precision);
    RotationDerivatives { gradient: pulled * off, hessian: pulled * jacobian }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rotation::exp;
    use crate::residuals::derivative_check::assert_gradient;

    #[test]
    fn gradient_matches_differences_near_and_far() {
        let factor = Matrix3::new(3.0, 0.5, -0.2, 0.0, 2.0, 0.7, 0.0, 0.0, 1.5);
        let gaussian = RotationGaussian { mean: exp(&Vector3::new(0.3, -0.5, 0.2)), precision: factor.tr_mul(&factor) };
        for off in [[0.0, 0.0, 0.0], [0.1, -0.2, 0.05], [1.2, 0.8, -0.9]] {
            let rotation = gaussian.mean * exp(&Vector3::from(off));
            let found = rotation_derivatives(&rotation, &gaussian);
            assert_gradient(found.gradient.as_slice(), |d| {
                rotation_cost(&(rotation * exp(&Vector3::from_column_slice(d))), &gaussian)
            });
            assert!(found.hessian.symmetric_eigenvalues().min() > 0.0);
        }
    }
}
