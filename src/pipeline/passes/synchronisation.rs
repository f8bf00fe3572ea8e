//! Time offsets of the cameras: given by the session, or estimated from the motion of people (`options.sync`).
//!
//! Frame `n` of a camera is taken at `n + offset` frames on the common time line; where clocks drift, offsets change linearly over
//! the take ([`CameraClock`]). Where offsets would move many frames off the time line, it begins where the camera in the middle does:
//! a part that all offsets have in common says nothing. The estimate runs in this order:
//!
//! - `whole_frames`: offsets to whole frames, per pair of cameras the one with the best agreement on a relative pose,
//!   reconciled over all pairs
//! - rounds of bundle adjustment with delays: cameras, points and the remaining offsets are adjusted together, and the
//!   recording is shifted by the result; where the last round shows that clocks drift against each other, rounds with drifts follow
//!
//! `retiming` shifts the recording to what synchronous cameras would have seen; later passes see only that.

mod clock_rounds;
mod time_line;

use crate::body::hand::Side;
use crate::pipeline::camera_clock::{CameraClock, drift_of_rate};
use crate::pipeline::capture::Capture;
use crate::pipeline::config::Options;
use crate::pipeline::error::PipelineError;
use crate::pipeline::passes::cameras::FinalAdjustment;
use crate::pipeline::stages::time_offsets::{retiming, whole_frames};
use crate::progress::{Canceled, Progress};
use crate::session::reconstruction::{Quality, StageReport, TimeOffset, Verdict};
use crate::session::{FrameIndex, Reconstruction, Session};
use clock_rounds::Rounds;
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
    let start = given.applied_to(session);
    let comparing = steps.begin("comparing cameras at all time offsets");
    let whole = whole_frames::whole_offsets(&Capture::new(&start, options), &[], &comparing)?;
    let mut clocks = given.clocks(session);
    clocks.iter_mut().zip(&whole.offsets).for_each(|(clock, whole)| clock.offset += *whole as f64);

    let refining = steps.begin("refining time offsets");
    let mut rounds = Rounds::new(session, options, clocks);
    rounds.run(last, &refining)?;
    let metrics = [
        ("pairs", whole.n_pairs() as f64),
        ("pair_agreement", whole.agreement()),
        ("last_step_frames", rounds.largest_step),
    ];
    let termination = if rounds.is_converged() { "converged" } else { "rounds_exhausted" };
    let report = StageReport {
        cost_before: rounds.cost[0],
        cost_after: rounds.cost[1],
        ..StageReport::new("synchronisation", rounds.count, termination, metrics)
    };
    let offsets = rounds.time_offsets(given.common_part(session));
    Ok(Timing { offsets, report: Some(report) })
}

impl Timing {
    /// The offsets that the session gives.
    pub fn given(session: &Session) -> Self {
        let given =
            session.views.iter().map(|view| TimeOffset { secs: view.time_offset, sigma_secs: None, drift: None });
        Self { offsets: given.collect(), report: None }
    }

    /// The recording as synchronous cameras would have made it.
    pub fn applied_to<'s>(&self, session: &'s Session) -> Cow<'s, Session> {
        let clocks = self.clocks(session);
        if clocks.iter().all(|clock| *clock == CameraClock::default()) {
            return Cow::Borrowed(session);
        }
        Cow::Owned(retiming::retimed(session, &clocks))
    }

    /// Moves a result of the synchronous recording to the frames of `session`, and adds offsets and report to it.
    pub fn add_to(&self, session: &Session, reconstruction: &mut Reconstruction) {
        let clocks = self.clocks(session);
        for (v, (view, clock)) in session.views.iter().zip(&clocks).enumerate() {
            let no_person = |_| None;
            let identities = &mut reconstruction.identities[v];
            *identities = retiming::as_recorded(view, identities, clock, no_person);
            if let Some(repairs) = &mut reconstruction.repairs {
                let before = &mut repairs.identities_before[v];
                *before = retiming::as_recorded(view, before, clock, no_person);
            }
            if let Some(sources) = &mut reconstruction.hand_sources {
                let own_hands = |detection| Side::BOTH.map(|side| (detection, side));
                sources[v] = retiming::as_recorded(view, &sources[v], clock, own_hands);
            }
        }
        for repair in reconstruction.repairs.iter_mut().flat_map(|repairs| &mut repairs.repaired) {
            let recorded = clocks[repair.view].recorded_frame(repair.frame.0, session.n_frames);
            repair.frame = FrameIndex(recorded.unwrap_or(repair.frame.0));
        }
        let is_reported = self.report.is_some() || self.offsets.iter().any(|offset| offset.secs != 0.0);
        if is_reported {
            for (v, offset) in self.offsets.iter().enumerate() {
                reconstruction.cameras[v].time_offset = Some(*offset);
                reconstruction.report.cameras[v].time_offset = Some(*offset);
            }
        }
        if let Some(report) = &self.report {
            reconstruction.report.stages.insert(0, report.clone());
            let solved: Vec<bool> = reconstruction.cameras.iter().map(|c| c.camera_from_world.is_some()).collect();
            self.warn_of_uncertainty(session, &solved, &mut reconstruction.report.quality);
        }
        self.warn_of_lost_frames(session, &mut reconstruction.report.quality);
    }

    /// Refuses clocks by which a camera recorded at another time than the others.
    ///
    /// # Errors
    /// [`PipelineError::Unsolvable`] naming the camera, its offset and the remedy.
    pub fn require_common_time(&self, session: &Session) -> Result<(), PipelineError> {
        let losses = time_line::losses(session, &self.clocks(session), &self.offsets);
        losses.iter().find(|loss| loss.is_of_all_frames()).map_or(Ok(()), |loss| Err(loss.error()))
    }

    /// Adds a warning for every camera of whose frames many are lost.
    fn warn_of_lost_frames(&self, session: &Session, quality: &mut Quality) {
        for loss in time_line::losses(session, &self.clocks(session), &self.offsets) {
            quality.verdict = quality.verdict.max(Verdict::Warn);
            quality.reasons.push(loss.sentence());
        }
    }

    /// Adds a warning where offsets of cameras that were placed are too uncertain; of the others none was estimated.
    fn warn_of_uncertainty(&self, session: &Session, solved: &[bool], quality: &mut Quality) {
        let limit = SIGMA_WARN / session.fps;
        let is_uncertain = |offset: &TimeOffset| offset.sigma_secs.is_some_and(|sigma| sigma > limit);
        let estimated = session.views.iter().zip(&self.offsets).zip(solved).filter(|(_, solved)| **solved);
        let uncertain = estimated.filter(|((_, offset), _)| is_uncertain(offset));
        let ids: Vec<&str> = uncertain.map(|((view, _), _)| view.id.as_str()).collect();
        if !ids.is_empty() {
            quality.verdict = quality.verdict.max(Verdict::Warn);
            quality.reasons.push(format!(
                "the time offsets of {} are uncertain by more than {SIGMA_WARN} frames; record people who move more, or \
                 synchronise the cameras",
                ids.join(", ")
            ));
        }
    }

    /// Clocks against the common time line.
    fn clocks(&self, session: &Session) -> Vec<CameraClock> {
        let common = self.common_part(session);
        let mut clocks = self.clocks_as_reported(session);
        clocks.iter_mut().for_each(|clock| clock.offset -= common);
        clocks
    }

    /// The part of the offsets that is not applied, frames.
    fn common_part(&self, session: &Session) -> f64 {
        time_line::common_part(session, &self.clocks_as_reported(session))
    }

    fn clocks_as_reported(&self, session: &Session) -> Vec<CameraClock> {
        let clock = |offset: &TimeOffset| {
            let rate = offset.drift.map_or(0.0, |drift| drift.rate);
            CameraClock { offset: offset.secs * session.fps, drift: drift_of_rate(rate, session.n_frames) }
        };
        self.offsets.iter().map(clock).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::{Preset, SimulationConfig, simulate};

    /// A camera that could not be placed was said to have an uncertain offset.
    #[test]
    fn a_missing_estimate_counted_as_an_uncertain_one() {
        let config = SimulationConfig { frames: 10, views: 3, ..SimulationConfig::preset(Preset::Easy) };
        let session = simulate(&config).unwrap().session;
        let offsets = [Some(0.001), None, Some(0.5)];
        let offsets = offsets.map(|sigma_secs| TimeOffset { secs: 0.1, sigma_secs, drift: None }).to_vec();
        let timing = Timing { offsets, report: None };
        let mut quality = Quality { verdict: Verdict::Pass, reasons: Vec::new() };
        timing.warn_of_uncertainty(&session, &[true, false, true], &mut quality);
        let expected = format!("the time offsets of {} are uncertain", session.views[2].id);
        assert!(quality.reasons.len() == 1 && quality.reasons[0].starts_with(&expected), "{:?}", quality.reasons);
    }
}
