//! Time offsets of the cameras: given by the session, or estimated from the motion of people (`options.sync`).
//!
//! Frame `n` of a camera is taken at `n + offset` frames on the common time line. The estimate runs in this order:
//!
//! - `whole_frames`: offsets to whole frames, per pair of cameras the one with the best agreement on a relative pose,
//!   reconciled over all pairs
//! - rounds of bundle adjustment with delays: cameras, points and the remaining offsets are adjusted together, and the
//!   recording is shifted by the result
//!
//! `retiming` shifts the recording to what synchronous cameras would have seen; later passes see only that.

use crate::geometry::Rigid;
use crate::pipeline::calibration::{AdjustedCamera, Calibration};
use crate::pipeline::capture::Capture;
use crate::pipeline::config::{IntrinsicsMode, Options};
use crate::pipeline::focal_lengths::FocalLengths;
use crate::pipeline::passes::adjustment::{ALL_FRAMES, Effort, adjusted};
use crate::pipeline::passes::cameras::{FinalAdjustment, roughly_calibrated};
use crate::pipeline::stages::time_offsets::{retiming, whole_frames};
use crate::progress::{Canceled, Progress};
use crate::session::reconstruction::{Quality, StageReport, TimeOffset, Verdict};
use crate::session::{FrameIndex, Reconstruction, Session};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Time offsets of all cameras.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// Per view.
    offsets: Vec<TimeOffset>,
    /// Report of the estimate; `None` where the offsets are given.
    report: Option<StageReport>,
}

/// Largest number of rounds: each leaves a tenth of the error, from a frame or two.
const MAX_ROUNDS: usize = 6;

/// Remaining delays below this are noise, frames.
const CONVERGED: f64 = 0.01;

/// Largest correction of one round, frames: the path of a keypoint is not straight for longer.
const MAX_STEP: f64 = 2.5;

/// Standard deviation of an offset above which it harms poses more than detector noise does, frames.
const SIGMA_WARN: f64 = 0.25;

/// Estimates the offsets, starting from those that the session gives.
pub fn estimated_timing(
    session: &Session,
    options: &Options,
    last: FinalAdjustment,
    progress: &Progress,
) -> Result<Timing, Canceled> {
    let mut steps = progress.steps([0.4, 0.6]);
    let given = Timing::given(session);
    let mut offsets = given.frames(session);
    let start = given.applied_to(session);
    let comparing = steps.begin("comparing cameras at all time offsets");
    let whole = whole_frames::whole_offsets(&Capture::new(&start, options), &comparing)?;
    offsets.iter_mut().zip(&whole.offsets).for_each(|(offset, whole)| *offset += *whole as f64);

    let refining = steps.begin("refining time offsets");
    let intrinsics = options.intrinsics_of(session);
    let (effort, has_open_lenses) = (Effort::delays(intrinsics), intrinsics != IntrinsicsMode::Fixed);
    let mut lengths = FocalLengths::given(session);
    let mut steps = refining.steps([3.0, 1.0].repeat(MAX_ROUNDS));
    let (mut cameras, mut sigmas): (Option<Vec<Option<Rigid>>>, _) = (None, vec![None; offsets.len()]);
    let (mut rounds, mut largest_step, mut cost) = (0, f64::INFINITY, [None; 2]);
    while rounds < MAX_ROUNDS && largest_step > CONVERGED {
        let retimed = retiming::retimed(session, &offsets);
        let scaled = lengths.applied_to(&retimed);
        let capture = Capture::new(&scaled, options);
        let step = steps.begin("estimating cameras at the current time offsets");
        let before = roughly_calibrated(&capture, cameras, last, &step)?;
        let step = steps.begin("adjusting cameras and time offsets");
        let after = adjusted(&capture, &before, effort, ALL_FRAMES, &step)?;
        if has_open_lenses {
            lengths.take_over(&after);
        }
        let delays = delays(&after);
        sigmas = delays.iter().map(|d| d.and_then(|d| d.sigma)).collect();
        let corrections = delays.iter().map(|d| d.map_or(0.0, |d| d.frames.clamp(-MAX_STEP, MAX_STEP)));
        tracing::debug!(round = rounds, ?offsets, ?delays, "time offsets and remaining delays");
        largest_step = corrections.clone().map(f64::abs).fold(0.0, f64::max);
        offsets.iter_mut().zip(corrections).for_each(|(offset, correction)| *offset += correction);
        if let Some(report) = after.stages.last() {
            cost = [cost[0].or(report.cost_before), report.cost_after];
        }
        cameras = Some(after.cameras);
        rounds += 1;
    }
    let metrics =
        [("pairs", whole.n_pairs as f64), ("pair_agreement", whole.agreement), ("last_step_frames", largest_step)];
    let termination = if largest_step > CONVERGED { "rounds_exhausted" } else { "converged" };
    let report = StageReport {
        cost_before: cost[0],
        cost_after: cost[1],
        ..StageReport::new("synchronisation", rounds, termination, metrics)
    };
    let secs = |frames: f64| frames / session.fps;
    let of_view =
        |(frames, sigma): (&f64, &Option<f64>)| TimeOffset { secs: secs(*frames), sigma_secs: sigma.map(secs) };
    Ok(Timing { offsets: offsets.iter().zip(&sigmas).map(of_view).collect(), report: Some(report) })
}

/// An estimated delay of one camera.
#[derive(Debug, Clone, Copy)]
struct Delay {
    frames: f64,
    sigma: Option<f64>,
}

/// Delays against the first adjusted view; `None` for views that were not adjusted.
fn delays(calibration: &Calibration) -> Vec<Option<Delay>> {
    let Some(adjusted) = &calibration.adjusted else { return vec![None; calibration.cameras.len()] };
    let moved = adjusted.cameras.iter().map(|c| c.is_observed.then_some(c));
    let reference = moved.clone().flatten().next().map_or(0.0, |c| c.delay);
    let sigma = |c: &AdjustedCamera| c.uncertainty.and_then(|u| u.sigma_delay);
    moved.map(|c| c.map(|c| Delay { frames: c.delay - reference, sigma: sigma(c) })).collect()
}

impl Timing {
    /// The offsets that the session gives.
    pub fn given(session: &Session) -> Self {
        let given = session.views.iter().map(|view| TimeOffset { secs: view.time_offset, sigma_secs: None });
        Self { offsets: given.collect(), report: None }
    }

    /// The recording as synchronous cameras would have made it.
    pub fn applied_to<'s>(&self, session: &'s Session) -> Cow<'s, Session> {
        let offsets = self.frames(session);
        if offsets.iter().all(|offset| *offset == 0.0) {
            return Cow::Borrowed(session);
        }
        Cow::Owned(retiming::retimed(session, &offsets))
    }

    /// Moves a result of the synchronous recording to the frames of `session`, and adds offsets and report to it.
    pub fn add_to(&self, session: &Session, reconstruction: &mut Reconstruction) {
        let offsets = self.frames(session);
        for (v, (view, offset)) in session.views.iter().zip(&offsets).enumerate() {
            let synchronous = std::mem::take(&mut reconstruction.identities[v]);
            reconstruction.identities[v] = retiming::as_recorded(view, synchronous, *offset);
            if let Some(repairs) = &mut reconstruction.repairs {
                let before = std::mem::take(&mut repairs.identities_before[v]);
                repairs.identities_before[v] = retiming::as_recorded(view, before, *offset);
            }
        }
        for repair in reconstruction.repairs.iter_mut().flat_map(|repairs| &mut repairs.repaired) {
            let recorded = retiming::recorded_frame(repair.frame.0, offsets[repair.view], session.n_frames);
            repair.frame = FrameIndex(recorded.unwrap_or(repair.frame.0));
        }
        let is_reported = self.report.is_some() || offsets.iter().any(|offset| *offset != 0.0);
        if is_reported {
            for (v, offset) in self.offsets.iter().enumerate() {
                reconstruction.cameras[v].time_offset = Some(*offset);
                reconstruction.report.cameras[v].time_offset = Some(*offset);
            }
        }
        if let Some(report) = &self.report {
            reconstruction.report.stages.insert(0, report.clone());
            self.warn_of_uncertainty(session, &mut reconstruction.report.quality);
        }
    }

    /// Adds a warning where offsets are too uncertain.
    fn warn_of_uncertainty(&self, session: &Session, quality: &mut Quality) {
        let limit = SIGMA_WARN / session.fps;
        let is_uncertain = |offset: &TimeOffset| offset.sigma_secs.is_none_or(|sigma| sigma > limit);
        let uncertain = session.views.iter().zip(&self.offsets).filter(|(_, offset)| is_uncertain(offset));
        let ids: Vec<&str> = uncertain.map(|(view, _)| view.id.as_str()).collect();
        if !ids.is_empty() {
            quality.verdict = quality.verdict.max(Verdict::Warn);
            quality.reasons.push(format!(
                "the time offsets of {} are uncertain by more than {SIGMA_WARN} frames; record people who move more, or \
                 synchronise the cameras",
                ids.join(", ")
            ));
        }
    }

    /// In frames.
    fn frames(&self, session: &Session) -> Vec<f64> {
        self.offsets.iter().map(|offset| offset.secs * session.fps).collect()
    }
}
