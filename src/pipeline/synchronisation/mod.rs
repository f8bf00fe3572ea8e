//! When each camera's frames were taken: as the session says, or found from the motion itself.
//!
//! Frame `n` of a camera is taken at `n + offset` frames on the common time line. In order:
//!
//! - `whole_frames`: offsets to a frame, pair by pair: the one under which the two cameras' people agree on a relative
//!   pose, reconciled over all pairs
//! - [`calibration`](super::calibration) with delays: in rounds, cameras and points are adjusted together with what is
//!   left of the offsets, and the recording is moved by it
//! - `retiming`: the recording as synchronous cameras would have made it, which is all that later stages see

mod retiming;
mod whole_frames;

use super::calibration::{Calibration, roughly_calibrated, with_delays};
use super::config::{Options, Sync};
use super::{Capture, N_STAGES, PipelineError};
use crate::geometry::Rigid;
use crate::progress::Progress;
use crate::session::reconstruction::{Quality, StageReport, TimeOffset, Verdict};
use crate::session::{FrameIndex, Reconstruction, Session};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// When every camera's frames were taken.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// Per view.
    offsets: Vec<TimeOffset>,
    /// What was done to find them; `None` where they were given.
    report: Option<StageReport>,
}

/// The stage's share of the whole work: it places the cameras, as the stage after it does, and searches before.
const SHARE: f64 = 0.6;

/// Rounds of moving the recording and asking what is left: each leaves a tenth of the error, from a frame or two.
const MAX_ROUNDS: usize = 6;

/// Delays below this are noise, frames.
const SETTLED: f64 = 0.01;

/// A keypoint's path is not straight for longer than this, frames.
const MAX_STEP: f64 = 2.5;

/// An offset that is known no better than this makes poses worse than the detector's noise does, frames.
const SIGMA_WARN: f64 = 0.25;

/// Finds out when the frames were taken.
///
/// # Errors
/// [`PipelineError::Canceled`].
pub fn timing(session: &Session, options: &Options, progress: &Progress) -> Result<Timing, PipelineError> {
    let given = session.views.iter().map(|view| TimeOffset { secs: view.time_offset, sigma_secs: None }).collect();
    let given = Timing { offsets: given, report: None };
    match options.sync {
        Sync::Given => Ok(given),
        Sync::Estimate => estimated(session, options, &given, progress),
    }
}

fn estimated(
    session: &Session,
    options: &Options,
    given: &Timing,
    progress: &Progress,
) -> Result<Timing, PipelineError> {
    let stage = |start: f64, width: f64| progress.stage("synchronisation", 0, N_STAGES, SHARE * start, SHARE * width);
    let mut offsets = given.frames(session);
    let start = given.applied_to(session);
    let found = whole_frames::whole_offsets(&Capture::new(&start, options), &stage(0.0, 0.4))?;
    offsets.iter_mut().zip(&found.offsets).for_each(|(offset, whole)| *offset += *whole as f64);

    let (mut cameras, mut sigmas): (Option<Vec<Option<Rigid>>>, _) = (None, vec![None; offsets.len()]);
    let (mut rounds, mut left, mut cost) = (0, f64::INFINITY, [None; 2]);
    while rounds < MAX_ROUNDS && left > SETTLED {
        let stage = stage(0.4 + 0.6 * rounds as f64 / MAX_ROUNDS as f64, 0.6 / MAX_ROUNDS as f64);
        let moved = retiming::retimed(session, &offsets);
        let capture = Capture::new(&moved, options);
        let before = roughly_calibrated(&capture, cameras, &stage)?;
        let after = with_delays(&capture, &before, &stage)?;
        let delays = delays(&after);
        sigmas = delays.iter().map(|d| d.and_then(|d| d.sigma)).collect();
        let steps = delays.iter().map(|d| d.map_or(0.0, |d| d.frames.clamp(-MAX_STEP, MAX_STEP)));
        tracing::debug!(round = rounds, ?offsets, ?delays, "offsets and what is left of them");
        left = steps.clone().map(f64::abs).fold(0.0, f64::max);
        offsets.iter_mut().zip(steps).for_each(|(offset, step)| *offset += step);
        if let Some(report) = after.stages.last() {
            cost = [cost[0].or(report.cost_before), report.cost_after];
        }
        cameras = Some(after.cameras);
        rounds += 1;
    }
    let metrics = BTreeMap::from([
        ("pairs".to_owned(), found.n_pairs as f64),
        ("pair_agreement".to_owned(), found.agreement),
        ("last_step_frames".to_owned(), left),
    ]);
    let report = StageReport {
        stage: "synchronisation".to_owned(),
        iterations: rounds,
        cost_before: cost[0],
        cost_after: cost[1],
        termination: if left > SETTLED { "rounds_exhausted" } else { "converged" }.to_owned(),
        metrics,
    };
    let secs = |frames: f64| frames / session.fps;
    let of_view =
        |(frames, sigma): (&f64, &Option<f64>)| TimeOffset { secs: secs(*frames), sigma_secs: sigma.map(secs) };
    Ok(Timing { offsets: offsets.iter().zip(&sigmas).map(of_view).collect(), report: Some(report) })
}

#[derive(Debug, Clone, Copy)]
struct Delay {
    frames: f64,
    sigma: Option<f64>,
}

/// Delays against the first view that has one; `None` for views that were not adjusted.
fn delays(calibration: &Calibration) -> Vec<Option<Delay>> {
    let Some(adjusted) = &calibration.adjusted else { return vec![None; calibration.cameras.len()] };
    let moved = adjusted.cameras.iter().map(|c| c.fit.reprojection_px.map(|_| c));
    let reference = moved.clone().flatten().next().map_or(0.0, |c| c.delay);
    let sigma = |c: &super::stages::bundle_adjustment::AdjustedCamera| c.uncertainty.and_then(|u| u.sigma_delay);
    moved.map(|c| c.map(|c| Delay { frames: c.delay - reference, sigma: sigma(c) })).collect()
}

impl Timing {
    /// How much of the work was done here.
    pub fn share_of_work(&self) -> f64 {
        if self.report.is_some() { SHARE } else { 0.0 }
    }

    /// The recording as synchronous cameras would have made it.
    pub fn applied_to<'s>(&self, session: &'s Session) -> Cow<'s, Session> {
        let offsets = self.frames(session);
        if offsets.iter().all(|offset| *offset == 0.0) {
            return Cow::Borrowed(session);
        }
        Cow::Owned(retiming::retimed(session, &offsets))
    }

    /// Says in a result of the synchronous recording when the frames were taken, and whom the detections were given to as
    /// they stand in `session`.
    pub fn tell(&self, session: &Session, reconstruction: &mut Reconstruction) {
        let offsets = self.frames(session);
        for (v, (view, offset)) in session.views.iter().zip(&offsets).enumerate() {
            let synchronous = std::mem::take(&mut reconstruction.identities[v]);
            reconstruction.identities[v] = retiming::as_recorded(view, synchronous, *offset);
            if let Some(cleaning) = &mut reconstruction.repairs {
                let before = std::mem::take(&mut cleaning.identities_before[v]);
                cleaning.identities_before[v] = retiming::as_recorded(view, before, *offset);
            }
        }
        if let Some(cleaning) = &mut reconstruction.repairs {
            let n_frames = session.n_frames;
            cleaning.repaired.iter_mut().for_each(|repaired| {
                let recorded = retiming::recorded_frame(repaired.frame.0, offsets[repaired.view], n_frames);
                repaired.frame = FrameIndex(recorded.unwrap_or(repaired.frame.0));
            });
        }
        let is_told = self.report.is_some() || offsets.iter().any(|offset| *offset != 0.0);
        if is_told {
            for (v, offset) in self.offsets.iter().enumerate() {
                reconstruction.cameras[v].time_offset = Some(*offset);
                reconstruction.report.cameras[v].time_offset = Some(*offset);
            }
        }
        if let Some(report) = &self.report {
            reconstruction.report.stages.insert(0, report.clone());
            self.doubt(session, &mut reconstruction.report.quality);
        }
    }

    /// Offsets that are not known well enough are worth a look.
    fn doubt(&self, session: &Session, quality: &mut Quality) {
        let limit = SIGMA_WARN / session.fps;
        let is_doubtful = |offset: &TimeOffset| offset.sigma_secs.is_none_or(|sigma| sigma > limit);
        let doubtful = session.views.iter().zip(&self.offsets).filter(|(_, offset)| is_doubtful(offset));
        let ids: Vec<&str> = doubtful.map(|(view, _)| view.id.as_str()).collect();
        if !ids.is_empty() {
            quality.verdict = quality.verdict.max(Verdict::Warn);
            quality.reasons.push(format!(
                "the time offsets of {} are known to no better than {SIGMA_WARN} frames; let people move more, or \
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
