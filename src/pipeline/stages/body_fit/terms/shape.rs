//! The prior of the shape.

use super::term::BorderTerm;
use crate::body::model::Betas;
use crate::optim::block_banded::Corner;

/// `weight |betas|^2 / 2`: betas have standard deviation 1 over the population.
pub(crate) struct ShapePrior {
    /// Weight against the data of one frame.
    pub weight: f64,
}

impl BorderTerm for ShapePrior {
    fn cost(&self, betas: &[f64]) -> f64 {
        0.5 * self.weight * Betas::from_column_slice(betas).norm_squared()
    }

    fn add_to(&self, betas: &[f64], first: usize, corner: &mut Corner) {
        for (k, beta) in betas.iter().enumerate() {
            corner.hessian[(first + k, first + k)] += self.weight;
            corner.gradient[first + k] += self.weight * beta;
        }
    }
}
