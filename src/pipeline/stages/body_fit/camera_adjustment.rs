//! Cameras adjusted together with the motions of all persons, under errors that are correlated in time.
//!
//! Bundle adjustment takes the detector's errors as independent. They are slow, so that what lies still says little and what
//! moves says much: with the errors whitened the cameras' errors fall by a third on realistic noise.

use super::context::FitContext;
use super::joint_problem::{Errors, JointProblem, Member, Minimum, Stopping};
use super::noise_measurement::measured_noise;
use super::observations::{Observations, PosedCamera};
use super::person_fit::StartedMotion;
use super::terms::border_priors::{BoneLengthPrior, KeypointBiasPrior};
use super::terms::noise_process::PathNoise;
use crate::body::detector_offsets::OffsetTable;
use crate::body::skeleton::KeypointConvention;
use crate::geometry::{Rigid, free_network};
use crate::pipeline::calibration::CameraUncertainty;
use crate::progress::Canceled;
use nalgebra::{DMatrix, Vector3};

/// Cameras after the adjustment.
#[derive(Debug, Clone)]
pub struct AdjustedCameras {
    /// `camera_from_world` of the placed cameras.
    pub cameras: Vec<Rigid>,
    /// Of the same, in the free-network gauge, m and rad; empty where they could not be determined.
    pub uncertainties: Vec<CameraUncertainty>,
    /// The detector's errors.
    pub(super) noise: PathNoise,
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

/// Adjusts the cameras together with the first fits of all persons, both of which are replaced; `None` with fewer than two
/// cameras, or without persons.
pub(super) fn adjusted_cameras(
    context: &FitContext,
    convention: KeypointConvention,
    started: &mut [Option<(Observations, StartedMotion)>],
) -> Result<Option<AdjustedCameras>, Canceled> {
    let n_people = started.iter().flatten().count();
    let n_cameras = started.iter().flatten().next().map_or(0, |(observations, _)| observations.cameras.len());
    if n_cameras < 2 {
        return Ok(None);
    }
    let member = |(observations, started): &(Observations, StartedMotion)| {
        Member::of(context, observations, started, MAX_FRAMES / n_people)
    };
    let mut members: Vec<Member> = started.iter().flatten().map(member).collect();
    let table = OffsetTable::new(context.model, convention);
    let bias_sigmas: Vec<Vector3<f64>> = table.kinds.iter().map(|kind| kind.prior_sigma).collect();
    let mut offsets = vec![Vector3::zeros(); table.kinds.len()];
    let mut uncertainties = Vec::new();
    for _ in 0..N_ROUNDS {
        let noise = measured_noise(context, &table.applied(context.model, &offsets), &members);
        let problem = JointProblem {
            context,
            table: &table,
            errors: Errors::Correlated(&noise),
            shape_prior: context.config.shape_prior,
            bone_prior: BoneLengthPrior { sigma: BONE_SIGMA, correlated_frames: 1.0 },
            bias_prior: KeypointBiasPrior { sigmas: bias_sigmas.clone(), correlated_frames: 1.0 },
            moves_cameras: true,
        };
        let minimum = problem.minimised(&mut members, offsets, &STOPPING)?;
        uncertainties = camera_uncertainties(&minimum);
        offsets = minimum.offsets;
    }
    let noise = measured_noise(context, &table.applied(context.model, &offsets), &members);
    let cameras = members.first().map_or_else(Vec::new, |member| member.observations.cameras.clone());
    for ((observations, started), member) in started.iter_mut().flatten().zip(members) {
        take_over(observations, started, member);
    }
    Ok(Some(AdjustedCameras { cameras: poses(&cameras), uncertainties, noise }))
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

fn poses(cameras: &[PosedCamera]) -> Vec<Rigid> {
    cameras.iter().map(|camera| camera.camera_from_world).collect()
}

/// From the inverse of the reduced system, in the gauge in which cameras are compared after a similarity.
fn camera_uncertainties(minimum: &Minimum) -> Vec<CameraUncertainty> {
    let Minimum { cameras, offsets, reduced: Some(reduced), .. } = minimum else { return Vec::new() };
    let Some(projection) = free_network::projection(&poses(cameras)) else { return Vec::new() };
    let (first, n) = (3 * offsets.len(), 6 * cameras.len());
    let of_cameras: DMatrix<f64> = reduced.covariance().view((first, first), (n, n)).into_owned();
    let free = &projection * of_cameras * projection.transpose();
    let sigma = |first: usize| free.fixed_view::<3, 3>(first, first).trace().max(0.0).sqrt();
    let uncertainty = |k: usize| CameraUncertainty {
        sigma_position: sigma(6 * k),
        sigma_angle: sigma(6 * k + 3),
        sigma_delay: None,
        sigma_log_focal: None,
    };
    (0..cameras.len()).map(uncertainty).collect()
}
