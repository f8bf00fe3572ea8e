//! Focal lengths that are only nearly known: `options.intrinsics: refine_focal`.
//!
//! In rounds: cameras and people are found with the lenses as they stand, then adjusted together with a factor on each
//! camera's focal lengths, which a prior of 5 % holds near what was given. A factor that the recording does not tell (its
//! standard deviation stays above half of the prior's) is not taken. All later stages see the refined lenses alone.
//!
//! Known limit: one factor on all cameras at once hardly differs from a larger or smaller distance; only the prior tells.

use super::calibration::{Calibration, roughly_calibrated, with_focal_factors};
use super::config::Options;
use super::stages::bundle_adjustment::{AdjustedCamera, AdjustmentConfig};
use super::{Capture, PipelineError, Shares};
use crate::geometry::Rigid;
use crate::session::reconstruction::{FocalFactor, StageReport};
use crate::session::{Reconstruction, Session};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// What each camera's focal lengths are multiplied by.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FocalLengths {
    /// Per view; `None`: the lens stays as given.
    factors: Vec<Option<FocalFactor>>,
    /// What was done; `None` where nothing was asked for.
    report: Option<StageReport>,
}

/// Rounds: the first brings factors of 10 % to within 1 %.
const ROUNDS: usize = 2;

/// The stage's share of what the synchronisation leaves of the work: the cameras are found once more.
const SHARE: f64 = 0.4;

/// A factor is told by the recording where its standard deviation is below this share of the prior's.
const TOLD: f64 = 0.5;

/// Finds the factors.
///
/// # Errors
/// [`PipelineError::Canceled`].
pub(super) fn refined(session: &Session, options: &Options, progress: &Shares) -> Result<FocalLengths, PipelineError> {
    let mut found = FocalLengths::given(session);
    let mut cameras: Option<Vec<Option<Rigid>>> = None;
    let mut last = None;
    for round in 0..ROUNDS {
        let width = SHARE / ROUNDS as f64;
        let progress = &progress.stage("focal_lengths", 0, round as f64 * width, width);
        let refined = found.applied_to(session);
        let capture = Capture::new(&refined, options);
        let before = roughly_calibrated(&capture, cameras, progress)?;
        let after = with_focal_factors(&capture, &before, progress)?;
        found.multiply(&after);
        last = after.stages.last().cloned();
        cameras = Some(after.cameras);
    }
    found.report = last.map(|adjustment| StageReport {
        stage: "focal_lengths".to_owned(),
        iterations: ROUNDS,
        metrics: BTreeMap::from([("cameras_refined".to_owned(), found.factors.iter().flatten().count() as f64)]),
        ..adjustment
    });
    Ok(found)
}

impl FocalLengths {
    /// The lenses as they are.
    pub fn given(session: &Session) -> Self {
        Self { factors: vec![None; session.views.len()], report: None }
    }

    /// Takes what one more round has found on top of what there was.
    fn multiply(&mut self, after: &Calibration) {
        let Some(adjusted) = &after.adjusted else { return };
        let limit = TOLD * AdjustmentConfig::default().focal_sigma;
        let told = |camera: &AdjustedCamera| {
            let sigma = camera.uncertainty?.sigma_log_focal.filter(|sigma| *sigma < limit)?;
            Some(FocalFactor { value: camera.focal_factor, sigma: sigma * camera.focal_factor })
        };
        for (factor, camera) in self.factors.iter_mut().zip(&adjusted.cameras) {
            let before = factor.map_or(1.0, |factor| factor.value);
            *factor = told(camera).map(|new| FocalFactor { value: before * new.value, ..new }).or(*factor);
        }
    }

    /// How much of what the synchronisation leaves of the work was done here.
    pub fn share_of_work(&self) -> f64 {
        if self.report.is_some() { SHARE } else { 0.0 }
    }

    /// The recording through the refined lenses.
    pub fn applied_to<'s>(&self, session: &'s Session) -> Cow<'s, Session> {
        if self.factors.iter().all(Option::is_none) {
            return Cow::Borrowed(session);
        }
        let mut refined = session.clone();
        for (view, factor) in refined.views.iter_mut().zip(&self.factors) {
            if let Some(factor) = factor {
                view.intrinsics = view.intrinsics.with_focal_factor(factor.value);
            }
        }
        Cow::Owned(refined)
    }

    /// Says in a result which lenses it holds for.
    pub fn tell(&self, reconstruction: &mut Reconstruction) {
        for (camera, factor) in reconstruction.cameras.iter_mut().zip(&self.factors) {
            camera.focal_factor = *factor;
        }
        if let Some(report) = &self.report {
            reconstruction.report.stages.insert(0, report.clone());
        }
    }
}
