//! Focal lengths of which nothing is known: `options.intrinsics: estimate`, and cameras without K.
//!
//! A focal length that is wrong by a third still finds the cameras that see the same people, but not where they stand: bones then
//! differ in length from place to place. So candidates of one factor on all focal lengths are compared by the first arrangement
//! of the cameras that each leads to; the best of them are adjusted with a factor per camera, and the one under which people are
//! seen most alike by all cameras is refined in rounds, as focal lengths that are nearly right are.

use crate::geometry::Rigid;
use crate::pipeline::capture::Capture;
use crate::pipeline::config::Options;
use crate::pipeline::focal_lengths::FocalLengths;
use crate::pipeline::passes::adjustment::{ALL_FRAMES, Effort, adjusted};
use crate::pipeline::passes::cameras::{FinalAdjustment, first_arrangement, roughly_calibrated};
use crate::pipeline::stages::camera_init::first_quality;
use crate::progress::{Canceled, Progress};
use crate::session::Session;
use crate::session::reconstruction::StageReport;

/// Candidates of the common factor, in steps that a refinement bridges: with the longer image side as the given length, angles of
/// view from 90 to 23 degrees.
const FACTORS: [f64; 8] = [0.5, 0.63, 0.79, 1.0, 1.26, 1.58, 2.0, 2.5];

/// Candidates that are adjusted, best first.
const N_ADJUSTED: usize = 3;

/// Rounds of refinement at most, and the change of a focal length, as a share, below which the next changes nothing.
const ROUNDS: usize = 4;
const SETTLED: f64 = 0.01;

/// A common factor, and what was found under it.
struct Candidate {
    lengths: FocalLengths,
    cameras: Vec<Option<Rigid>>,
    /// Share of the keypoints of all cameras that people explain, times the number of placed cameras.
    score: f64,
}

/// Estimates the factors on the focal lengths of `session`, which may be guesses.
pub fn estimated_focal_lengths(
    session: &Session,
    options: &Options,
    last: FinalAdjustment,
    progress: &Progress,
) -> Result<FocalLengths, Canceled> {
    let mut steps = progress.steps([2.0, 3.0, 3.0]);
    let promising = promising(session, options, &steps.begin("comparing angles of view"))?;
    let adjusting = steps.begin("adjusting the best angles of view");
    let mut best: Option<Candidate> = None;
    for lengths in promising {
        let candidate = adjusted_candidate(session, options, lengths, &adjusting)?;
        if candidate.score > best.as_ref().map_or(0.0, |best| best.score) {
            best = Some(candidate);
        }
    }
    let refining = steps.begin("refining focal lengths");
    match best {
        Some(best) => refined(session, options, best, last, &refining),
        None => Ok(FocalLengths::given(session)),
    }
}

/// The candidates whose best arrangement of the cameras scores highest, best first.
fn promising(session: &Session, options: &Options, progress: &Progress) -> Result<Vec<FocalLengths>, Canceled> {
    let mut found = Vec::with_capacity(FACTORS.len());
    for factor in FACTORS {
        let lengths = FocalLengths::all(session, factor);
        let scaled = lengths.applied_to(session);
        let capture = Capture::new(&scaled, options);
        found.push((first_quality(&capture, progress)?, lengths));
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    Ok(found.into_iter().filter(|(quality, _)| *quality > 0.0).map(|(_, lengths)| lengths).take(N_ADJUSTED).collect())
}

/// A first calibration under the candidate's focal lengths, adjusted with one factor per camera.
fn adjusted_candidate(
    session: &Session,
    options: &Options,
    mut lengths: FocalLengths,
    progress: &Progress,
) -> Result<Candidate, Canceled> {
    let scaled = lengths.applied_to(session);
    let capture = Capture::new(&scaled, options);
    let first = first_arrangement(&capture, progress)?;
    let after = adjusted(&capture, &first, Effort::UNKNOWN_FOCAL, ALL_FRAMES, progress)?;
    lengths.take_over(&after);
    let scaled = lengths.applied_to(session);
    let capture = Capture::new(&scaled, options);
    let again = roughly_calibrated(&capture, Some(after.cameras.clone()), FinalAdjustment::Elsewhere, progress)?;
    let score = again.association.explained * again.n_placed() as f64;
    Ok(Candidate { lengths, cameras: after.cameras, score })
}

/// Rounds of association and adjustment until focal lengths stay.
fn refined(
    session: &Session,
    options: &Options,
    start: Candidate,
    last: FinalAdjustment,
    progress: &Progress,
) -> Result<FocalLengths, Canceled> {
    let Candidate { mut lengths, mut cameras, .. } = start;
    for round in 1..=ROUNDS {
        let scaled = lengths.applied_to(session);
        let capture = Capture::new(&scaled, options);
        let before = roughly_calibrated(&capture, Some(cameras), last, progress)?;
        let after = adjusted(&capture, &before, Effort::LAST_UNKNOWN_FOCAL, ALL_FRAMES, progress)?;
        let change = lengths.take_over(&after);
        tracing::debug!(round, change, factors = ?lengths.factors, "focal lengths of the bundle adjustment");
        lengths.report = after.stages.last().map(|adjustment| report(adjustment, round));
        cameras = after.cameras;
        if change < SETTLED {
            break;
        }
    }
    Ok(lengths)
}

/// The report of an adjustment as that of this pass.
fn report(adjustment: &StageReport, rounds: usize) -> StageReport {
    StageReport { stage: "focal_lengths".to_owned(), iterations: rounds, ..adjustment.clone() }
}
