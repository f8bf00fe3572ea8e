//! Two bodies that overlap.

/// The distance that two surfaces lack, over its standard deviation: `max(0, least - distance) / sigma`.
///
/// `least`, `distance`, `sigma`: metres. The derivative by the distance is `-1 / sigma` where the residual is positive, else 0.
pub fn missing_distance(least: f64, distance: f64, sigma: f64) -> f64 {
    (least - distance).max(0.0) / sigma
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residuals::derivative_check::assert_gradient;

    #[test]
    fn only_overlaps_have_a_residual() {
        assert_eq!(missing_distance(0.0, 0.1, 0.005), 0.0);
        assert!((missing_distance(-0.01, -0.02, 0.005) - 2.0).abs() < 1e-12);
        for (distance, slope) in [(-0.02, -1.0 / 0.005), (0.1, 0.0)] {
            assert_gradient(&[slope], |d| missing_distance(-0.01, distance + d[0], 0.005));
        }
    }
}
