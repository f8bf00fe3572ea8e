//! Priors of the unknowns that all frames share: shape, bone offsets, keypoint offsets.

use super::term::BorderTerm;
use crate::body::BodyModel;
use crate::body::anthropometry::N_BETAS;
use crate::body::model::Betas;
use crate::optim::block_banded::Corner;
use nalgebra::{SMatrix, Vector3};

/// Second derivatives of a cost by the betas.
pub(crate) type BetaInformation = SMatrix<f64, N_BETAS, N_BETAS>;

/// `(weight |betas|^2 + girth_weight (girths . betas)^2) / 2`: betas have standard deviation 1 over the population, and girths
/// follow the stature.
pub(crate) struct ShapePrior {
    /// Weight against the data.
    pub weight: f64,
    /// Weight of what changes girths at a constant stature.
    pub girth_weight: f64,
    /// Direction of that change, unit length.
    pub girths: Betas,
}

impl ShapePrior {
    /// `weight`, and `girth_weight` for the girths of `model`.
    pub(crate) fn new([weight, girth_weight]: [f64; 2], model: &BodyModel) -> Self {
        Self { weight, girth_weight, girths: model.girth_direction }
    }

    /// `weight I + girth_weight girths girths^T`.
    pub(crate) fn hessian(&self) -> BetaInformation {
        let girths = self.girths * self.girths.transpose() * self.girth_weight;
        BetaInformation::from_diagonal_element(self.weight) + girths
    }

    fn by_girths(&self, betas: &[f64]) -> f64 {
        self.girths.dot(&Betas::from_column_slice(betas))
    }
}

impl BorderTerm for ShapePrior {
    fn cost(&self, betas: &[f64]) -> f64 {
        let squares = Betas::from_column_slice(betas).norm_squared();
        0.5 * (self.weight * squares + self.girth_weight * self.by_girths(betas).powi(2))
    }

    fn precision(&self, k: usize) -> f64 {
        self.weight + self.girth_weight * self.girths[k].powi(2)
    }

    fn add_to(&self, betas: &[f64], first: usize, corner: &mut Corner) {
        let hessian = self.hessian();
        let mut of_betas = corner.hessian.fixed_view_mut::<N_BETAS, N_BETAS>(first, first);
        of_betas += hessian;
        let mut pull = corner.gradient.fixed_rows_mut::<N_BETAS>(first);
        pull += hessian * Betas::from_column_slice(betas);
    }
}

/// `|offsets|^2 / (2 sigma^2)` over the person's offsets of all bones: bones are nearly as long as the betas say.
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
