//! Cameras adjusted together with the motions of all persons, under errors that are correlated in time.
//!
//! Bundle adjustment takes the detector's errors as independent. They are slow, so that what lies still says little and what
//! moves says much: with the errors whitened the cameras' errors fall by a third on realistic noise.

use super::context::FitContext;
use super::joint_problem::{Errors, JointProblem, Member, Stopping};
use super::noise_measurement::measured_noise;
use super::observations::Observations;
use super::person_fit::StartedMotion;
use super::terms::border_priors::{BoneLengthPrior, KeypointBiasPrior};
use super::terms::noise_process::PathNoise;
use crate::body::detector_offsets::OffsetTable;
use crate::geometry::Rigid;
use crate::progress::Canceled;

/// The detector's errors, and the cameras after the adjustment.
#[derive(Debug, Clone)]
pub(super) struct AdjustedCameras {
    /// `camera_from_world` of the placed cameras; `None` where they were held.
    pub cameras: Option<Vec<Rigid>>,
    /// The detector's errors.
    pub noise: PathNoise,
}

/// Most frames of all persons together: cameras that are seen this often are known to a third of what constant errors of the
/// detector leave open.
const MAX_FRAMES: usize = 1200;

/// Standard deviation of a person's bones about those of the betas, m per axis: joint centres of another definition, and
/// proportions that the betas do not span.
const BONE_SIGMA: f64 = 0.01;

/// The noise is measured on the first fit, then on the adjusted one; a third round changes the cameras by a tenth of their
/// standard deviation.
const N_ROUNDS: usize = 2;

/// A step of less than a tenth of a standard deviation is the last: the next would be a hundredth.
const STOPPING: Stopping = Stopping { max_iterations: 8, min_decrease: 0.5, min_sigmas: 0.1 };

/// Fewest frames of one person.
const MIN_FRAMES: usize = 60;

/// Measures the detector's errors on the first fits of all persons. Where `config.adjust_cameras`, cameras and first fits are
/// adjusted together under these errors, and replaced. `None` with fewer than two cameras, or without persons.
pub(super) fn correlated_errors(
    context: &FitContext,
    started: &mut [Option<(Observations, StartedMotion)>],
) -> Result<Option<AdjustedCameras>, Canceled> {
    let n_people = started.iter().flatten().count();
    let n_cameras = started.iter().flatten().next().map_or(0, |(observations, _)| observations.cameras.len());
    if n_cameras < 2 {
        return Ok(None);
    }
    let n_frames = (MAX_FRAMES / n_people).max(MIN_FRAMES);
    let member =
        |(observations, started): &(Observations, StartedMotion)| Member::of(context, observations, started, n_frames);
    let mut members: Vec<Member> = started.iter().flatten().map(member).collect();
    let mut noise = measured_noise(context, &members);
    if !context.config.adjust_cameras {
        return Ok(Some(AdjustedCameras { cameras: None, noise }));
    }
    // The detector's offsets are in the model; released again, they cost half of the time and change no camera by a tenth.
    let table = OffsetTable::empty(context.model);
    for _ in 0..N_ROUNDS {
        let problem = JointProblem {
            context,
            table: &table,
            errors: Errors::Correlated(&noise),
            shape_prior: context.config.shape_prior,
            bone_prior: BoneLengthPrior { sigma: BONE_SIGMA, correlated_frames: 1.0 },
            bias_prior: KeypointBiasPrior { sigmas: Vec::new(), correlated_frames: 1.0 },
            moves_cameras: true,
        };
        problem.minimised(&mut members, Vec::new(), &STOPPING)?;
        noise = measured_noise(context, &members);
    }
    let cameras = members.first().map_or_else(Vec::new, |member| member.observations.cameras.clone());
    for ((observations, started), member) in started.iter_mut().flatten().zip(members) {
        take_over(observations, started, member);
    }
    let cameras = cameras.iter().map(|camera| camera.camera_from_world).collect();
    Ok(Some(AdjustedCameras { cameras: Some(cameras), noise }))
}

/// The first fit goes on from where the adjustment ended.
fn take_over(observations: &mut Observations, started: &mut StartedMotion, member: Member) {
    let Member { run, observations: adjusted, state, .. } = member;
    let own = run.start - started.window.start..run.end - started.window.start;
    observations.cameras = adjusted.cameras;
    started.start.betas = state.betas;
    started.fitted.state.betas = state.betas;
    started.fitted.state.poses[own].clone_from_slice(&state.poses);
    started.start.poses[run].clone_from_slice(&state.poses);
}
