//! The prior of a person's bone offsets: bones are nearly as long as the betas say.

use super::term::BorderTerm;
use crate::optim::block_banded::Corner;
use nalgebra::Vector3;

/// `frames |offsets|^2 / (2 sigma^2)` over the offsets of all kinds of bones.
pub(crate) struct BoneLengthPrior {
    /// Standard deviation per axis, m.
    pub sigma: f64,
    /// Number of frames that carry as much information as one independent frame.
    pub correlated_frames: f64,
}

impl BoneLengthPrior {
    /// Second derivative by each number, m^-2.
    pub(crate) fn precision(&self) -> f64 {
        self.correlated_frames / self.sigma.powi(2)
    }
}

impl BorderTerm for BoneLengthPrior {
    fn cost(&self, offsets: &[f64]) -> f64 {
        let squares = offsets.chunks_exact(3).map(|d| Vector3::from_column_slice(d).norm_squared());
        0.5 * self.correlated_frames * squares.sum::<f64>() / self.sigma.powi(2)
    }

    fn add_to(&self, offsets: &[f64], first: usize, corner: &mut Corner) {
        let weight = self.precision();
        for (k, value) in offsets.iter().enumerate() {
            corner.hessian[(first + k, first + k)] += weight;
            corner.gradient[first + k] += weight * value;
        }
    }
}
