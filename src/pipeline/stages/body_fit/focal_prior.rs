//! The prior of the cameras' focal lengths in the joint problem, and what became of it.

use crate::pipeline::calibration::PosedCamera;
use crate::pipeline::focal_spread::{FocalSpread, FoundFactors};
use crate::session::reconstruction::FocalFactor;
use nalgebra::{DMatrix, DVector};

/// Normal prior of the logarithms of the cameras' focal factors.
#[derive(Debug, Clone)]
pub(super) struct FocalPrior {
    /// By camera, px.
    pub given: Vec<f64>,
    pub spread: FocalSpread,
    /// Whether the given lengths are guesses, about which the real ones spread widely together.
    pub is_guessed: bool,
}

impl FocalPrior {
    /// Logarithms of the factors that `cameras` have.
    pub(super) fn log_factors(&self, cameras: &[PosedCamera]) -> DVector<f64> {
        let of = |(camera, given): (&PosedCamera, &f64)| (camera.intrinsics.focal() / given).ln();
        DVector::from_iterator(cameras.len(), cameras.iter().zip(&self.given).map(of))
    }

    /// Before the recording shows anything.
    pub(super) fn wide(given: Vec<f64>, is_guessed: bool) -> Self {
        let spread = if is_guessed { FocalSpread::UNKNOWN } else { FocalSpread::WIDE };
        Self { given, spread, is_guessed }
    }

    /// The likeliest spread, and the logarithm of its likelihood over that of focal lengths as given.
    pub(super) fn likeliest(&self, found: &FoundFactors) -> (FocalSpread, f64) {
        if self.is_guessed { FocalSpread::likeliest_of_unknown(found) } else { FocalSpread::likeliest(found) }
    }

    pub(super) fn precision(&self) -> DMatrix<f64> {
        self.spread.precision(self.given.len())
    }

    pub(super) fn cost(&self, log_factors: &DVector<f64>) -> f64 {
        0.5 * log_factors.dot(&(self.precision() * log_factors))
    }
}

/// Focal lengths after the adjustment.
#[derive(Debug, Clone, PartialEq)]
pub struct RefinedFocal {
    /// By placed camera, against the given ones.
    pub factors: Vec<FocalFactor>,
    /// Logarithm of the session's likelihood with focal lengths that differ from the given ones, over that with those as given.
    pub log_evidence: f64,
    /// Whether they were taken as given, since that is not enough for others.
    pub are_as_given: bool,
}
