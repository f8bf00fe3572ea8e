//! Points of two views to which a relative pose is fitted, with the size of their errors.

use super::normalized::NormalizedDetection;
use super::pair_score::error_scale;
use crate::estimation::essential::{EssentialEstimate, estimate_essential};
use nalgebra::Vector2;

/// Points of two views that a pose is fitted to.
#[derive(Default)]
pub(super) struct PointPairs {
    /// Normalised, of the first and the second view.
    pub(super) pairs: Vec<(Vector2<f64>, Vector2<f64>)>,
    /// Sum over the pairs of how much larger their errors are than 4 m away.
    error_scales: f64,
}

impl PointPairs {
    /// Adds the points of two detections whose confidences in both views are above the least.
    pub(super) fn add(&mut self, first: &NormalizedDetection, second: &NormalizedDetection, least_confidence: f64) {
        let n_before = self.pairs.len();
        let seen = (0..first.normalized.len())
            .filter(|&k| first.confidence[k] > least_confidence && second.confidence[k] > least_confidence);
        self.pairs.extend(seen.map(|k| (first.normalized[k], second.normalized[k])));
        self.error_scales += (self.pairs.len() - n_before) as f64 * error_scale(first, second);
    }

    /// Keeps only some of the pairs; the mean of their errors is taken for that of all.
    pub(super) fn reduced(self, reduce: impl FnOnce(&mut Vec<(Vector2<f64>, Vector2<f64>)>)) -> Self {
        let mean = self.mean_error_scale();
        let mut pairs = self.pairs;
        reduce(&mut pairs);
        Self { error_scales: mean * pairs.len() as f64, pairs }
    }

    pub(super) fn joined(&self, other: &Self) -> Self {
        let pairs = self.pairs.iter().chain(&other.pairs).copied().collect();
        Self { pairs, error_scales: self.error_scales + other.error_scales }
    }

    /// How much larger the errors are than on people 4 m away.
    pub(super) fn mean_error_scale(&self) -> f64 {
        self.error_scales / self.pairs.len().max(1) as f64
    }

    /// A robust fit with this tolerance 4 m away; `None` where no pose has any support.
    pub(super) fn fit(&self, tolerance: f64, iterations: usize, seed: u64) -> Option<EssentialEstimate> {
        estimate_essential(&self.pairs, None, tolerance * self.mean_error_scale(), iterations, seed)
    }
}
