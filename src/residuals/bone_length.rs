//! The deviation of a bone from its length.

use nalgebra::{RowVector3, Vector3};

/// A bone residual and its derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoneLength {
    /// `ln(|a - b| / length) / sigma`.
    pub residual: f64,
    /// By the end `a`, per m; by `b` it is the negative.
    pub by_a: RowVector3<f64>,
    /// By the logarithm of the length: `-1 / sigma`.
    pub by_log_length: f64,
}

/// Ends nearer than this (m) define no direction, and the logarithm diverges: such a bone has no residual.
const MIN_LENGTH: f64 = 1e-6;

/// The residual `ln(|a - b| / length) / sigma`; `None` where the ends coincide.
///
/// `sigma`: relative standard deviation of the length, so to first order this is `(|a - b| - length) / (sigma length)`.
/// Why the logarithm: it does not depend on the unit of length, a common factor on everything changes nothing, and
/// estimating the length from it is linear and unbiased, whereas the quotient form favours long bones by `sigma^2`.
pub fn linearize(a: &Vector3<f64>, b: &Vector3<f64>, log_length: f64, sigma: f64) -> Option<BoneLength> {
    let difference = a - b;
    let squared = difference.norm_squared();
    if squared < MIN_LENGTH * MIN_LENGTH {
        return None;
    }
    Some(BoneLength {
        residual: (0.5 * squared.ln() - log_length) / sigma,
        by_a: difference.transpose() / (squared * sigma),
        by_log_length: -sigma.recip(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residuals::derivative_check::assert_derivative;
    use nalgebra::DMatrix;

    #[test]
    fn derivatives_match_central_differences() {
        let (a, b, log_length, sigma) = (Vector3::new(0.3, 1.0, -0.2), Vector3::new(0.1, 0.6, -0.1), -0.9, 0.05);
        let found = linearize(&a, &b, log_length, sigma).unwrap();
        let mut jacobian = DMatrix::zeros(1, 7);
        jacobian.view_mut((0, 0), (1, 3)).copy_from(&found.by_a);
        jacobian.view_mut((0, 3), (1, 3)).copy_from(&-found.by_a);
        jacobian[(0, 6)] = found.by_log_length;
        assert_derivative(&jacobian, |d| {
            let (a, b) = (a + Vector3::new(d[0], d[1], d[2]), b + Vector3::new(d[3], d[4], d[5]));
            vec![linearize(&a, &b, log_length + d[6], sigma).unwrap().residual]
        });
    }

    #[test]
    fn five_percent_too_long_is_one_sigma() {
        let b = Vector3::new(1.0, 2.0, 3.0);
        let found = linearize(&(b + Vector3::new(0.0, 0.42, 0.0)), &b, 0.4_f64.ln(), 0.05).unwrap();
        assert!((found.residual - 1.0).abs() < 0.03); // ln 1.05 = 0.0488
        assert_eq!(linearize(&b, &b, 0.0, 0.05), None);
    }
}
