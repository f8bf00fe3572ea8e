//! The prior of the detector's keypoint offsets, which all persons of a session share.

use super::term::BorderTerm;
use crate::optim::block_banded::Corner;
use nalgebra::Vector3;

/// `frames |offset / sigma|^2 / 2` over the offsets of all kinds of keypoints.
pub(crate) struct KeypointBiasPrior {
    /// Standard deviations by kind, per axis of the bone's frame, m.
    pub sigmas: Vec<Vector3<f64>>,
    /// Number of frames that carry as much information as one independent frame.
    pub correlated_frames: f64,
}

impl BorderTerm for KeypointBiasPrior {
    fn cost(&self, offsets: &[f64]) -> f64 {
        let in_sigmas = |(offset, sigma): (&[f64], _)| Vector3::from_column_slice(offset).component_div(sigma);
        let standardised = offsets.chunks_exact(3).zip(&self.sigmas).map(in_sigmas);
        self.correlated_frames * standardised.map(|o| 0.5 * o.norm_squared()).sum::<f64>()
    }

    fn add_to(&self, offsets: &[f64], first: usize, corner: &mut Corner) {
        for (k, (offset, sigma)) in offsets.iter().zip(self.sigmas.iter().flatten()).enumerate() {
            let weight = self.correlated_frames / sigma.powi(2);
            corner.hessian[(first + k, first + k)] += weight;
            corner.gradient[first + k] += weight * offset;
        }
    }
}
