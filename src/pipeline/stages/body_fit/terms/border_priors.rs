//! Priors of the unknowns that all frames share: shape, bone offsets, keypoint offsets.

use super::term::BorderTerm;
use crate::body::model::Betas;
use nalgebra::Vector3;

/// `weight |betas|^2 / 2`: betas have standard deviation 1 over the population.
pub(crate) struct ShapePrior {
    /// Weight against the data of one frame.
    pub weight: f64,
}

impl BorderTerm for ShapePrior {
    fn cost(&self, betas: &[f64]) -> f64 {
        0.5 * self.weight * Betas::from_column_slice(betas).norm_squared()
    }

    fn precision(&self, _: usize) -> f64 {
        self.weight
    }
}

/// `|offsets|^2 / (2 sigma^2)` over the person's offsets of all kinds of bones: bones are nearly as long as the betas
/// say.
pub(crate) struct BoneLengthPrior {
    /// Standard deviation per axis, m.
    pub sigma: f64,
}

impl BorderTerm for BoneLengthPrior {
    fn cost(&self, offsets: &[f64]) -> f64 {
        let squares = offsets.chunks_exact(3).map(|d| Vector3::from_column_slice(d).norm_squared());
        0.5 * squares.sum::<f64>() / self.sigma.powi(2)
    }

    fn precision(&self, _: usize) -> f64 {
        self.sigma.powi(-2)
    }
}

/// `|offset / sigma|^2 / 2` over the offsets of all kinds of keypoints, which all persons of a session share.
pub(crate) struct KeypointBiasPrior {
    /// Standard deviations by kind, per axis of the bone's frame, m.
    pub sigmas: Vec<Vector3<f64>>,
}

impl BorderTerm for KeypointBiasPrior {
    fn cost(&self, offsets: &[f64]) -> f64 {
        let in_sigmas = |(offset, sigma): (&[f64], _)| Vector3::from_column_slice(offset).component_div(sigma);
        let standardised = offsets.chunks_exact(3).zip(&self.sigmas).map(in_sigmas);
        standardised.map(|o| 0.5 * o.norm_squared()).sum()
    }

    fn precision(&self, k: usize) -> f64 {
        self.sigmas[k / 3][k % 3].powi(-2)
    }
}
