//! The keypoint bias that the fit applies: the detector's offsets under the likeliest hypothesis.
//!
//! Points of the skin (face, feet) lie where a detector's annotators clicked, and nothing else of the body depends on them:
//! their offsets are always applied. Joints are less free: a body whose joints lie elsewhere looks the same as a detector that
//! places them elsewhere, so that they move only where that is the likelier hypothesis, and by at most the largest offsets
//! reported for detectors.

use super::context::FitContext;
use super::joint_problem::Member;
use super::observations::Observations;
use super::person_fit::StartedMotion;
use super::session_bias::{Hypothesis, SessionBias, session_bias};
use super::thinned_motion::rough_stride;
use crate::body::BodyModel;
use crate::body::detector_offsets::{OffsetKind, OffsetTable};
use crate::body::skeleton::{JOINT_NAMES, KeypointConvention};
use crate::progress::Canceled;
use crate::session::reconstruction::{DetectorOffset, KeypointBias};
use nalgebra::Vector3;

/// The body with its landmarks where the session's detector has them, and the report on it.
pub(super) struct EstimatedBias {
    pub model: BodyModel,
    pub report: KeypointBias,
}

/// Fewest frames of all persons that are left by thinning: 80 numbers are estimated.
const MIN_LEFT: usize = 100;

/// Estimates the keypoint bias from the first fits of all persons; `None` for a convention that no detector uses.
pub(super) fn estimated_bias(
    context: &FitContext,
    convention: KeypointConvention,
    started: &[&(Observations, StartedMotion)],
) -> Result<Option<EstimatedBias>, Canceled> {
    let table = OffsetTable::new(context.model, convention);
    if table.kinds.is_empty() || started.is_empty() {
        return Ok(None);
    }
    let [per_person, in_all] = context.config.bias_frames;
    let n_frames = (in_all / started.len()).min(per_person);
    // What an error that lasts some frames says of offsets is said by every third of them.
    let n_seen: usize = started.iter().map(|(_, started)| started.window.len().min(n_frames)).sum();
    let stride = rough_stride(context.frame_interval).min(n_seen / MIN_LEFT).max(1);
    let member = |(observations, started): &&(Observations, StartedMotion)| {
        let run = observations.most_seen(started.window.clone(), n_frames);
        Member::of(context, observations, started, run, stride)
    };
    let thinned = FitContext { frame_interval: stride as f64 * context.frame_interval, ..*context };
    let found = likeliest(&table, started.iter().map(member).collect(), &thinned)?;
    let (moves_joints, reason) = decision(&table, &found);
    let is_applied = |kind: &OffsetKind| moves_joints || !kind.is_joint;
    let rows = || table.kinds.iter().zip(&found.offsets);
    let applied: Vec<Vector3<f64>> =
        rows().map(|(kind, offset)| if is_applied(kind) { *offset } else { Vector3::zeros() }).collect();
    let reported = |((kind, offset), sigma): ((&OffsetKind, &Vector3<f64>), &Vector3<f64>)| DetectorOffset {
        keypoint: kind.name.clone(),
        bone: JOINT_NAMES[kind.joint].to_owned(),
        offset_mm: (offset * 1e3).into(),
        sigma_mm: (sigma * 1e3).into(),
        applied: is_applied(kind),
    };
    let offsets = rows().zip(&found.sigmas).map(reported).collect();
    let report = KeypointBias { applied: moves_joints, reason, offsets };
    Ok(Some(EstimatedBias { model: table.applied(context.model, &applied), report }))
}

/// The session's offsets under the hypothesis of the largest evidence, which charges each for what it leaves open: with clean
/// detections of ordinary bodies 80 free numbers fit some of the noise, and the bones of every person fit more of it than offsets that all
/// persons share.
fn likeliest(table: &OffsetTable, mut members: Vec<Member>, context: &FitContext) -> Result<SessionBias, Canceled> {
    let none = vec![Vector3::zeros(); table.kinds.len()];
    let no_bias = session_bias(table, Hypothesis::NoBias, none, &mut members, context)?;
    // The others start from the solution of the simplest.
    let under = |hypothesis| session_bias(table, hypothesis, no_bias.offsets.clone(), &mut members.clone(), context);
    let (proportions, detector) = (under(Hypothesis::BodyProportions)?, under(Hypothesis::DetectorBias)?);
    let mut likeliest = no_bias;
    for found in [proportions, detector] {
        if found.negative_log_evidence() < likeliest.negative_log_evidence() {
            likeliest = found;
        }
    }
    Ok(likeliest)
}

/// Whether the offsets of joints are applied, and the reason.
fn decision(table: &OffsetTable, found: &SessionBias) -> (bool, String) {
    match (found.hypothesis, table.implausible(&found.offsets)) {
        (Hypothesis::NoBias, _) => (false, "the unchanged body model explains the session".to_owned()),
        (Hypothesis::BodyProportions, _) => {
            (false, "the persons' own body proportions explain the session better".to_owned())
        }
        (Hypothesis::DetectorBias, Some(kind)) => (
            false,
            format!("the offset of {} is larger than any known detector bias; the body does not fit there", kind.name),
        ),
        (Hypothesis::DetectorBias, None) => {
            (true, "a bias of the detector explains the session better than unusual body proportions".to_owned())
        }
    }
}
