//! Refined focal lengths: `options.intrinsics: refine_focal`.
//!
//! Each round estimates cameras and persons with the current focal lengths, then adjusts them together with a factor on each
//! camera's focal lengths. Only where this shows clearly that focal lengths are not as given, the next round and all later passes
//! have the factors; the body fit refines them further, together with cameras and motions, whatever is decided here.
//!
//! Known limit: one factor on all cameras at once hardly differs from a larger or smaller distance; only the prior separates the
//! two.

use crate::geometry::Rigid;
use crate::pipeline::capture::Capture;
use crate::pipeline::config::Options;
use crate::pipeline::focal_lengths::FocalLengths;
use crate::pipeline::focal_spread::{FocalSpread, FoundFactors, MIN_LOG_EVIDENCE};
use crate::pipeline::passes::adjustment::{ALL_FRAMES, Effort, GUESSED_ANGLE, adjusted};
use crate::pipeline::passes::cameras::{FinalAdjustment, roughly_calibrated};
use crate::progress::{Canceled, Progress};
use crate::session::Session;
use crate::session::reconstruction::{FocalFactor, StageReport};
use std::collections::BTreeMap;

/// Rounds at most: the first brings factors of 10 % to within 1 %.
const ROUNDS: usize = 2;

/// Estimates the factors.
pub fn refined_focal_lengths(
    session: &Session,
    options: &Options,
    last: FinalAdjustment,
    progress: &Progress,
) -> Result<FocalLengths, Canceled> {
    let mut lengths = FocalLengths::given(session);
    let mut cameras: Option<Vec<Option<Rigid>>> = None;
    let mut steps = progress.steps([3.0, 1.0].repeat(ROUNDS));
    for _ in 0..ROUNDS {
        let refined = lengths.applied_to(session);
        let capture = Capture::new(&refined, options);
        let step = steps.begin("estimating cameras with the current focal lengths");
        let before = roughly_calibrated(&capture, cameras, last, &step)?;
        let step = steps.begin("adjusting cameras and focal lengths");
        let after = adjusted(&capture, &before, Effort::FOCAL_LENGTHS, ALL_FRAMES, &step)?;
        let Some(estimate) = after.adjusted.as_ref().and_then(|adjusted| adjusted.focal.as_ref()) else { break };
        let current = |view: usize| lengths.factor(view).ln();
        let Some(shown) = FoundFactors::of_adjustment(estimate, current, GUESSED_ANGLE) else { break };
        let (spread, log_evidence) = FocalSpread::likeliest(&shown);
        lengths.report = after.stages.last().map(|adjustment| report(adjustment, log_evidence));
        if log_evidence < MIN_LOG_EVIDENCE {
            lengths.factors.fill(None);
            break;
        }
        let Some((log_factors, covariance)) = shown.under(spread) else { break };
        for (k, &view) in estimate.views.iter().enumerate() {
            let value = log_factors[k].exp();
            let sigma = value * covariance[(k, k)].max(0.0).sqrt();
            lengths.factors[view] = Some(FocalFactor { value, sigma });
        }
        cameras = Some(after.cameras);
    }
    Ok(lengths)
}

/// The report of an adjustment as that of this pass.
fn report(adjustment: &StageReport, log_evidence: f64) -> StageReport {
    StageReport {
        stage: "focal_lengths".to_owned(),
        iterations: ROUNDS,
        metrics: BTreeMap::from([("log_evidence".to_owned(), log_evidence)]),
        ..adjustment.clone()
    }
}
