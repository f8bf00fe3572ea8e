//! The keypoint bias that the fit applies: the detector's offsets as the session shows them.
//!
//! Points of the skin (face, feet) lie where a detector's annotators clicked, and nothing else of the body depends on them:
//! their offsets are always applied. Joints are less free: a body whose joints lie elsewhere looks nearly the same, so that they
//! move only where a bias is much the likelier ([`likeliest_bias`]).

use super::context::FitContext;
use super::joint_problem::{JointProblem, Member, Minimum, ProportionEvidence, Stopping};
use super::noise_measurement::measured_noise;
use super::observations::Observations;
use super::person_fit::StartedMotion;
use super::session_bias::{PROPORTION_SIGMA, SessionBias, likeliest_bias};
use super::terms::border_priors::{BoneLengthPrior, KeypointBiasPrior};
use super::thinned_motion::rough_stride;
use crate::body::BodyModel;
use crate::body::detector_offsets::OffsetTable;
use crate::body::skeleton::{JOINT_NAMES, KeypointConvention};
use crate::progress::Canceled;
use crate::session::reconstruction::{DetectorOffset, KeypointBias};
use nalgebra::Vector3;

/// The body with its landmarks where the session's detector has them, and the report on it.
pub(super) struct EstimatedBias {
    pub model: BodyModel,
    pub report: KeypointBias,
}

/// A step that lowers the cost by less than half a unit, which is negligible, or of less than a third of a standard deviation is the
/// last: the evidence is taken from one linearisation, which holds over such distances.
const STOPPING: Stopping = Stopping { max_iterations: 7, min_decrease: 0.5, min_sigmas: 0.3 };

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
        Member::of(observations, started, run, stride)
    };
    let thinned = context.thinned(stride);
    let members = started.iter().map(member).collect();
    let Some(evidence) = evidence_of(&table, members, &thinned)? else { return Ok(None) };
    let Some(found) = likeliest_bias(&evidence, &table) else { return Ok(None) };
    let is_applied = |k: usize| !table.kinds[k].is_joint || found.biased.contains(&k);
    let applied: Vec<Vector3<f64>> =
        (0..table.kinds.len()).map(|k| if is_applied(k) { found.offsets[k] } else { Vector3::zeros() }).collect();
    let reported = |k: usize| DetectorOffset {
        keypoint: table.kinds[k].name.clone(),
        bone: JOINT_NAMES[table.kinds[k].joint].to_owned(),
        offset_mm: (found.offsets[k] * 1e3).into(),
        sigma_mm: (found.sigmas[k] * 1e3).into(),
        applied: is_applied(k),
    };
    let offsets = (0..table.kinds.len()).map(reported).collect();
    let report = KeypointBias { applied: !found.biased.is_empty(), reason: reason(&table, &found), offsets };
    Ok(Some(EstimatedBias { model: table.applied(context.model, &applied), report }))
}

/// What the session says of bones and offsets, about a fit in which both are free.
///
/// The errors are measured twice: what the body does not explain yet looks like slow errors of the detector.
fn evidence_of(
    table: &OffsetTable,
    mut members: Vec<Member>,
    context: &FitContext,
) -> Result<Option<ProportionEvidence>, Canceled> {
    let noise = measured_noise(context, &members);
    let sigmas = table.kinds.iter().map(|kind| kind.prior_sigma).collect();
    let problem = JointProblem {
        context,
        table: Some(table),
        noise: &noise,
        bone_prior: BoneLengthPrior { sigma: PROPORTION_SIGMA },
        bias_prior: KeypointBiasPrior { sigmas },
        cameras: None,
    };
    let none = vec![Vector3::zeros(); table.kinds.len()];
    let Minimum { session, .. } = problem.minimised(&mut members, none, &STOPPING)?;
    let model = table.applied(context.model, &session.offsets);
    let noise = measured_noise(&FitContext { model: &model, ..*context }, &members);
    Ok(JointProblem { noise: &noise, ..problem }.proportion_evidence(&members, &session.offsets))
}

/// Why offsets of joints are applied, or not.
fn reason(table: &OffsetTable, found: &SessionBias) -> String {
    let names: Vec<&str> = found.biased.iter().map(|&kind| table.kinds[kind].name.as_str()).collect();
    match names.is_empty() {
        true => "the bodies' own proportions explain the session without a bias of the detector's joints".to_owned(),
        false => format!(
            "a bias of the detector explains the session better than the bodies' proportions: {}",
            names.join(", ")
        ),
    }
}
