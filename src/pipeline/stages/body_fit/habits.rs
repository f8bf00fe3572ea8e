//! What the fit takes over from what the session tells of its detector.
//!
//! Points of the skin (face, feet) are where a detector's annotators clicked, and nothing else of the body depends on them:
//! they are taken where the session has them. Joints are not so free: a body whose joints lie elsewhere looks the same as a
//! detector that places them elsewhere, so that they move only where that is the likelier cause, and none by more than
//! detectors are known to.

use super::evidence::Evidence;
use super::motion_problem::MotionState;
use super::session_offsets::{Cause, OffsetWitness, SessionOffsets, session_offsets};
use super::solve::{Stages, StartedMotion};
use crate::body::BodyModel;
use crate::body::bone_offsets::BoneOffsets;
use crate::body::detector_offsets::{OffsetKind, OffsetTable};
use crate::body::skeleton::{JOINT_NAMES, KeypointConvention};
use crate::progress::Canceled;
use crate::session::reconstruction::{DetectorOffset, KeypointBias};
use nalgebra::Vector3;
use std::ops::Range;

/// The body with its landmarks where the session's detector has them, and what is told of that.
pub(super) struct Habits {
    pub model: BodyModel,
    pub told: KeypointBias,
}

/// What everybody's first fits tell together; `None` for a convention whose points are no detector's.
///
/// # Errors
/// [`Canceled`].
pub(super) fn habits(
    stages: &Stages,
    convention: KeypointConvention,
    started: &[&(Evidence, StartedMotion)],
) -> Result<Option<Habits>, Canceled> {
    let table = OffsetTable::new(stages.model, convention);
    if table.kinds.is_empty() || started.is_empty() {
        return Ok(None);
    }
    let [most, in_all] = stages.config.offset_frames;
    let n_frames = (in_all / started.len()).min(most);
    let witnesses = started.iter().map(|(evidence, started)| witness(stages, evidence, started, n_frames)).collect();
    let found = likeliest(&table, witnesses, stages)?;
    let (moves_joints, reason) = verdict(&table, &found);
    let is_applied = |kind: &OffsetKind| moves_joints || !kind.is_joint;
    let rows = || table.kinds.iter().zip(&found.offsets);
    let applied: Vec<Vector3<f64>> =
        rows().map(|(kind, offset)| if is_applied(kind) { *offset } else { Vector3::zeros() }).collect();
    let told = |((kind, offset), sigma): ((&OffsetKind, &Vector3<f64>), &Vector3<f64>)| DetectorOffset {
        keypoint: kind.name.clone(),
        bone: JOINT_NAMES[kind.joint].to_owned(),
        offset_mm: (offset * 1e3).into(),
        sigma_mm: (sigma * 1e3).into(),
        applied: is_applied(kind),
    };
    let offsets = rows().zip(&found.sigmas).map(told).collect();
    let told = KeypointBias { applied: moves_joints, reason, offsets };
    Ok(Some(Habits { model: table.applied(stages.model, &applied), told }))
}

/// What one person can tell of the detector: the run of frames with most pixels in the window that was fitted.
fn witness(stages: &Stages, evidence: &Evidence, started: &StartedMotion, n_frames: usize) -> OffsetWitness {
    let run = most_seen(evidence, started.window.clone(), n_frames);
    let own = run.start - started.window.start..run.end - started.window.start;
    let evidence = evidence.slice(run);
    let fitted = &started.fitted.state;
    let state = MotionState { betas: fitted.betas, poses: fitted.poses[own].to_vec() };
    let share = stages.pixel_share(&evidence, &state);
    OffsetWitness { evidence, state, bones: BoneOffsets::default(), share }
}

/// The run of `n_frames` (or of the whole window) with most pixels in a window of frames.
pub(super) fn most_seen(evidence: &Evidence, window: Range<usize>, n_frames: usize) -> Range<usize> {
    let length = window.len().min(n_frames.max(1));
    let seen = |first: usize| evidence.pixels[first..first + length].iter().map(Vec::len).sum::<usize>();
    let runs = window.start..=window.end - length;
    let first = runs.max_by_key(|&first| (seen(first), std::cmp::Reverse(first))).unwrap_or(window.start);
    first..first + length
}

/// The session's offsets under the likeliest cause.
///
/// Habits and skeletons leave about as much open, and how much exactly rests on how unusual people are taken to be: the
/// lower cost decides between them. That there is anything to explain must show in the evidence, which charges for what a
/// cause leaves open: among clean detections of ordinary bodies, 80 free numbers fit some of the noise.
fn likeliest(
    table: &OffsetTable,
    mut witnesses: Vec<OffsetWitness>,
    stages: &Stages,
) -> Result<SessionOffsets, Canceled> {
    let none = vec![Vector3::zeros(); table.kinds.len()];
    let neither = session_offsets(table, Cause::Neither, none, &mut witnesses, stages)?;
    // The others start from what was found for the simplest.
    let by = |cause| session_offsets(table, cause, neither.offsets.clone(), &mut witnesses.clone(), stages);
    let (by_skeletons, by_detector) = (by(Cause::Skeletons)?, by(Cause::Detector)?);
    let some = if by_detector.cost < by_skeletons.cost { by_detector } else { by_skeletons };
    Ok(if some.surprise() < neither.surprise() { some } else { neither })
}

/// Whether the joints are where the detector has them, and why.
fn verdict(table: &OffsetTable, found: &SessionOffsets) -> (bool, String) {
    match (found.cause, table.implausible(&found.offsets)) {
        (Cause::Neither, _) => (false, "the body explains the session as it is".to_owned()),
        (Cause::Skeletons, _) => (false, "people's own proportions explain the session better".to_owned()),
        (Cause::Detector, Some(kind)) => (
            false,
            format!("the offset of {} is larger than a detector's habit; the body does not fit there", kind.name),
        ),
        (Cause::Detector, None) => {
            (true, "a habit of the detector explains the session better than unusual people".to_owned())
        }
    }
}
