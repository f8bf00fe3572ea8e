//! Refined focal lengths: `options.intrinsics: refine_focal`.
//!
//! Each round estimates cameras and persons with the current focal lengths, then adjusts them together with a factor on
//! each camera's focal lengths. A prior of 5 % holds the factor near the given value. A factor that the recording does not
//! determine (its standard deviation stays above half of the prior's) is discarded. Later passes see the refined focal
//! lengths only.
//!
//! Known limit: one factor on all cameras at once hardly differs from a larger or smaller distance; only the prior
//! separates the two.

use crate::geometry::Rigid;
use crate::pipeline::calibration::{AdjustedCamera, Calibration};
use crate::pipeline::capture::Capture;
use crate::pipeline::config::Options;
use crate::pipeline::passes::adjustment::{ALL_FRAMES, Effort, adjusted};
use crate::pipeline::passes::cameras::{FinalAdjustment, roughly_calibrated};
use crate::pipeline::stages::bundle_adjustment::input::AdjustmentConfig;
use crate::progress::{Canceled, Progress};
use crate::session::reconstruction::{FocalFactor, StageReport};
use crate::session::{Reconstruction, Session};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// Factors on the cameras' focal lengths.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FocalLengths {
    /// Per view; `None`: the given focal length is kept.
    factors: Vec<Option<FocalFactor>>,
    /// Report of the refinement; `None` where nothing was refined.
    report: Option<StageReport>,
}

/// Rounds: the first brings factors of 10 % to within 1 %.
const ROUNDS: usize = 2;

/// Largest standard deviation of an accepted factor, as a share of the prior's.
const MAX_SIGMA_SHARE: f64 = 0.5;

/// Estimates the factors.
pub fn refined_focal_lengths(
    session: &Session,
    options: &Options,
    last: FinalAdjustment,
    progress: &Progress,
) -> Result<FocalLengths, Canceled> {
    let mut lengths = FocalLengths::given(session);
    let mut cameras: Option<Vec<Option<Rigid>>> = None;
    let mut adjustment = None;
    let mut steps = progress.steps([3.0, 1.0].repeat(ROUNDS));
    for _ in 0..ROUNDS {
        let refined = lengths.applied_to(session);
        let capture = Capture::new(&refined, options);
        let step = steps.begin("estimating cameras with the current focal lengths");
        let before = roughly_calibrated(&capture, cameras, last, &step)?;
        let step = steps.begin("adjusting cameras and focal lengths");
        let after = adjusted(&capture, &before, Effort::FOCAL_LENGTHS, ALL_FRAMES, &step)?;
        lengths.multiply(&after);
        adjustment = after.stages.last().cloned();
        cameras = Some(after.cameras);
    }
    lengths.report = adjustment.map(|adjustment| StageReport {
        stage: "focal_lengths".to_owned(),
        iterations: ROUNDS,
        metrics: BTreeMap::from([("cameras_refined".to_owned(), lengths.factors.iter().flatten().count() as f64)]),
        ..adjustment
    });
    Ok(lengths)
}

impl FocalLengths {
    /// The session's own focal lengths.
    pub fn given(session: &Session) -> Self {
        Self { factors: vec![None; session.views.len()], report: None }
    }

    /// Multiplies the factors by those of one more round.
    fn multiply(&mut self, after: &Calibration) {
        let Some(adjusted) = &after.adjusted else { return };
        let limit = MAX_SIGMA_SHARE * AdjustmentConfig::default().focal_sigma;
        let determined = |camera: &AdjustedCamera| {
            let sigma = camera.uncertainty?.sigma_log_focal.filter(|sigma| *sigma < limit)?;
            Some(FocalFactor { value: camera.focal_factor, sigma: sigma * camera.focal_factor })
        };
        for (factor, camera) in self.factors.iter_mut().zip(&adjusted.cameras) {
            let before = factor.map_or(1.0, |factor| factor.value);
            *factor = determined(camera).map(|new| FocalFactor { value: before * new.value, ..new }).or(*factor);
        }
    }

    /// The session with these focal lengths.
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

    /// Adds the factors and the report to a result.
    pub fn add_to(&self, reconstruction: &mut Reconstruction) {
        for (camera, factor) in reconstruction.cameras.iter_mut().zip(&self.factors) {
            camera.focal_factor = *factor;
        }
        if let Some(report) = &self.report {
            reconstruction.report.stages.insert(0, report.clone());
        }
    }
}
