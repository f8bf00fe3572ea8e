//! Covariance of a pixel that a detector states for its own error.

use nalgebra::Matrix2;
use serde::{Deserialize, Serialize};

/// Largest squared correlation of the two axes: beyond it the inverse has no digits left in single precision.
const MAX_SQUARED_CORRELATION: f64 = 1.0 - 1e-5;

/// Variances between these, px^2: standard deviations of 0.001 to 10^6 px, beyond which no pixel is located.
const VARIANCES: std::ops::RangeInclusive<f64> = 1e-6..=1e12;

/// A symmetric, positive definite covariance of a pixel, px^2.
///
/// In single precision, since sessions hold millions of them and detectors know their errors to some per cent at best.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct PixelCovariance([f32; 3]);

impl PixelCovariance {
    /// From its entries `[xx, xy, yy]`, px^2; `None` where they are not finite or not positive definite.
    pub fn new([xx, xy, yy]: [f64; 3]) -> Option<Self> {
        let is_valid = VARIANCES.contains(&xx)
            && VARIANCES.contains(&yy)
            && xy.is_finite()
            && xy * xy <= MAX_SQUARED_CORRELATION * xx * yy;
        is_valid.then_some(Self([xx as f32, xy as f32, yy as f32]))
    }

    /// Of independent errors of the same standard deviation along both axes, px; `None` where it is not positive and finite.
    pub fn isotropic(sigma: f64) -> Option<Self> {
        Self::new([sigma * sigma, 0.0, sigma * sigma]).filter(|_| sigma > 0.0)
    }

    /// `[xx, xy, yy]`, px^2.
    pub fn entries(&self) -> [f32; 3] {
        self.0
    }

    /// The matrix, px^2.
    pub fn matrix(&self) -> Matrix2<f64> {
        let [xx, xy, yy] = self.0.map(f64::from);
        Matrix2::new(xx, xy, xy, yy)
    }

    /// After a map of pixels with the derivative `jacobian`: `J C J^T`; `None` where the map is singular.
    pub fn mapped(&self, jacobian: &Matrix2<f64>) -> Option<Self> {
        let mapped = jacobian * self.matrix() * jacobian.transpose();
        Self::new([mapped[(0, 0)], mapped[(0, 1)], mapped[(1, 1)]])
    }

    /// Geometric mean of the standard deviations along the principal axes, `det(C)^(1/4)`, px.
    pub fn size(&self) -> f64 {
        self.matrix().determinant().sqrt().sqrt()
    }

    /// The symmetric matrix of determinant 1 that whitens a share of the shape of the covariance: `(C / sqrt(det C))^(-share / 2)`.
    ///
    /// With `M = C / sqrt(det C)`, whose eigenvalues are `exp(t)` and `exp(-t)`, `M^p = cosh(p t) I + sinh(p t) / sinh(t) (M - cosh(t) I)`.
    pub fn whitening(&self, share: f64) -> Matrix2<f64> {
        let covariance = self.matrix();
        let shape = covariance / covariance.determinant().sqrt();
        let (power, cosh) = (-0.5 * share, (0.5 * shape.trace()).max(1.0));
        let t = cosh.acosh();
        // The ratio of the hyperbolic sines is `power` at t = 0.
        let ratio = if t > 1e-6 { (power * t).sinh() / t.sinh() } else { power };
        Matrix2::identity() * (power * t).cosh() + (shape - Matrix2::identity() * cosh) * ratio
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_positive_definite_covariances_exist() {
        assert_eq!(PixelCovariance::new([4.0, -1.0, 2.0]).unwrap().entries(), [4.0, -1.0, 2.0]);
        for entries in [[1.0, 1.0, 1.0], [1.0, -2.0, 1.0], [0.0, 0.0, 1.0], [1.0, 0.0, -1.0], [f64::NAN, 0.0, 1.0]] {
            assert_eq!(PixelCovariance::new(entries), None, "{entries:?}");
        }
        assert_eq!(PixelCovariance::isotropic(2.0).unwrap().entries(), [4.0, 0.0, 4.0]);
        for sigma in [0.0, -2.0, f64::INFINITY, f64::NAN] {
            assert_eq!(PixelCovariance::isotropic(sigma), None, "{sigma}");
        }
    }

    /// `W C W^T` of the whole shape is a circle of the size; half of it leaves half of the logarithms of the axes.
    #[test]
    fn the_rounded_covariance_is_a_circle() {
        let covariance = PixelCovariance::new([9.0, 3.0, 4.0]).unwrap();
        let (size, matrix) = (covariance.size(), covariance.matrix());
        assert!((size.powi(4) - 27.0).abs() < 1e-9);
        let round = covariance.whitening(1.0);
        assert!((round * matrix * round - Matrix2::identity() * size * size).norm() < 1e-9);
        assert!((round.determinant() - 1.0).abs() < 1e-12 && (round - round.transpose()).norm() < 1e-12);
        let half = covariance.whitening(0.5);
        assert!((half * half - round).norm() < 1e-12);
        assert!((covariance.whitening(0.0) - Matrix2::identity()).norm() < 1e-12);
        assert!((PixelCovariance::isotropic(3.0).unwrap().whitening(1.0) - Matrix2::identity()).norm() < 1e-9);
    }

    #[test]
    fn a_mirrored_covariance_leans_the_other_way() {
        let covariance = PixelCovariance::new([9.0, 3.0, 4.0]).unwrap();
        let mirrored = covariance.mapped(&Matrix2::new(-1.0, 0.0, 0.0, 1.0)).unwrap();
        assert_eq!(mirrored.entries(), [9.0, -3.0, 4.0]);
        let scaled = covariance.mapped(&(Matrix2::identity() * 2.0)).unwrap();
        assert_eq!(scaled.entries(), [36.0, 12.0, 16.0]);
        assert_eq!(covariance.mapped(&Matrix2::zeros()), None);
    }
}
