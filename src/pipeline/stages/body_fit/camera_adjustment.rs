//! Cameras adjusted together with the motions of all persons, under errors that are correlated in time.
//!
//! Bundle adjustment takes the detector's errors as independent. They are slow, so that what lies still says little and what
//! moves says much: with the errors whitened the cameras' errors fall by a third on realistic noise.

use super::camera_priors::{CameraPriors, OVERCOUNT};
use super::context::FitContext;
use super::focal_prior::{FocalPrior, RefinedFocal};
use super::joint_problem::{Errors, JointProblem, Member, Minimum, Stopping};
use super::noise_measurement::measured_noise;
use super::observations::{Observations, PosedCamera};
use super::person_fit::StartedMotion;
use super::terms::border_priors::{BoneLengthPrior, KeypointBiasPrior};
use super::terms::camera_unknowns::{CameraUnknowns, FOCAL};
use super::terms::noise_process::PathNoise;
use crate::body::bone_offsets::BoneOffsets;
use crate::body::detector_offsets::OffsetTable;
use crate::body::kinematics::Pose;
use crate::geometry::{Rigid, rotation};
use crate::pipeline::focal_spread::{FocalSpread, FoundFactors};
use crate::progress::Canceled;
use crate::session::reconstruction::FocalFactor;

/// The detector's errors, and the cameras after the adjustment.
#[derive(Debug, Clone)]
pub(super) struct AdjustedCameras {
    /// `camera_from_world` of the placed cameras; `None` where they were held.
    pub cameras: Option<Vec<Rigid>>,
    /// Focal lengths of the placed cameras; `None` where they were held.
    pub focal: Option<RefinedFocal>,
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

/// Longest time between the frames of the adjustment, s.
///
/// Residuals that lie farther apart tell more of the slow part of the errors than those of successive frames, and what lies
/// between says little that is new: with every second or third frame at 30 Hz cameras come 6 to 14 % closer than with all, in a
/// third of the time. Of white errors every frame counts: cameras came 11 to 13 % worse.
const FRAME_SECS: f64 = 0.1;

/// Least autocorrelation of the errors of successive frames of the adjustment, if it leaves out any.
const MIN_SHARED: f64 = 0.7;

/// Fewest frames of all persons that are left by thinning: with 150 instead of 300 cameras come a fifth worse.
const MIN_LEFT: usize = 300;

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
    let members = |started: &[Option<(Observations, StartedMotion)>], stride: usize| -> Vec<Member> {
        let people = started.iter().flatten();
        people.map(|(observations, fit)| Member::of(context, observations, fit, n_frames, stride)).collect()
    };
    let (mut cameras, mut focal, mut bones) = (None, None, vec![BoneOffsets::default(); n_people]);
    if context.config.adjust_cameras {
        let all = members(started, 1);
        let stride = stride(context, &all);
        let mut adjusted = if stride == 1 { all } else { members(started, stride) };
        focal =
            adjust(&FitContext { frame_interval: stride as f64 * context.frame_interval, ..*context }, &mut adjusted)?;
        cameras = adjusted.first().map(|member| member.observations.cameras.clone());
        for ((observations, started), member) in started.iter_mut().flatten().zip(&adjusted) {
            take_over(observations, started, member, stride);
        }
        bones = adjusted.into_iter().map(|member| member.bones).collect();
    }
    // With the bones of the adjustment: what the betas do not span would look like slow errors of the detector, and with errors
    // that large and slow joints come up to a fifth worse.
    let with_bones = |(member, bones)| Member { bones, ..member };
    let noise =
        measured_noise(context, &members(started, 1).into_iter().zip(bones).map(with_bones).collect::<Vec<_>>());
    let poses = |cameras: Vec<PosedCamera>| cameras.iter().map(|camera| camera.camera_from_world).collect();
    Ok(Some(AdjustedCameras { cameras: cameras.map(poses), focal, noise }))
}

/// Every how many frames the adjustment takes one.
fn stride(context: &FitContext, members: &[Member]) -> usize {
    let n_seen: usize = members.iter().map(|member| member.run.len()).sum();
    let longest = ((FRAME_SECS / context.frame_interval).round() as usize).min(n_seen / MIN_LEFT);
    let typical = measured_noise(context, members).typical();
    (2..=longest).rev().find(|&stride| typical.after(stride) >= MIN_SHARED).unwrap_or(1)
}

/// Adjusts cameras and motions of all members in rounds.
fn adjust(context: &FitContext, members: &mut [Member]) -> Result<Option<RefinedFocal>, Canceled> {
    // The detector's offsets are in the model; released again, they cost half of the time and change no camera by a tenth.
    let table = OffsetTable::empty(context.model);
    let mut priors = CameraPriors::new(&context.config.known_cameras);
    let mut refined = None;
    for _ in 0..N_ROUNDS {
        let noise = measured_noise(context, members);
        let problem = JointProblem {
            context,
            table: &table,
            errors: Errors::Correlated(&noise),
            shape_prior: context.config.shape_prior,
            bone_prior: BoneLengthPrior { sigma: BONE_SIGMA, correlated_frames: 1.0 },
            bias_prior: KeypointBiasPrior { sigmas: Vec::new(), correlated_frames: 1.0 },
            cameras: Some(&priors),
        };
        let minimum = problem.minimised(members, Vec::new(), &STOPPING)?;
        if let Some(prior) = &mut priors.focal {
            if let Some((found, spread)) = refined_focal(&minimum, prior) {
                prior.spread = spread;
                refined = Some(found);
            }
        }
    }
    Ok(refined)
}

/// Focal lengths at a minimum under `prior`, and the likeliest spread of their errors.
fn refined_focal(minimum: &Minimum, prior: &FocalPrior) -> Option<(RefinedFocal, FocalSpread)> {
    let log_factors = prior.log_factors(&minimum.session.cameras);
    let covariance = minimum.reduced.as_ref()?.covariance();
    let n_camera = CameraUnknowns { focal: true }.len();
    let first = covariance.nrows() - n_camera * log_factors.len();
    let columns: Vec<usize> = (0..log_factors.len()).map(|camera| first + n_camera * camera + FOCAL).collect();
    let covariance = covariance.select_rows(&columns).select_columns(&columns) * OVERCOUNT;
    let factor = |k: usize| {
        let value = log_factors[k].exp();
        FocalFactor { value, sigma: value * covariance[(k, k)].max(0.0).sqrt() }
    };
    let factors = (0..log_factors.len()).map(factor).collect();
    let (spread, log_evidence) =
        FocalSpread::likeliest(&FoundFactors::new(&log_factors, covariance.clone(), prior.spread)?);
    Some((RefinedFocal { factors, log_evidence }, spread))
}

/// The first fit goes on from where the adjustment of every `stride`-th frame ended; frames between them are carried along.
fn take_over(observations: &mut Observations, started: &mut StartedMotion, member: &Member, stride: usize) {
    let first = member.run.start - started.window.start;
    let own = &mut started.fitted.state.poses[first..first + member.run.len()];
    carry_along(own, &member.state.poses, stride);
    observations.cameras.clone_from(&member.observations.cameras);
    started.start.betas = member.state.betas;
    started.fitted.state.betas = member.state.betas;
    started.start.poses[member.run.clone()].clone_from_slice(own);
}

/// Moves every `stride`-th pose to `adjusted`, and those between by what their neighbours moved, weighted linearly.
fn carry_along(poses: &mut [Pose], adjusted: &[Pose], stride: usize) {
    let before: Vec<Pose> = poses.iter().step_by(stride).copied().collect();
    for (t, pose) in poses.iter_mut().enumerate() {
        let (k, part) = (t / stride, (t % stride) as f64 / stride as f64);
        let moved = [(k, 1.0 - part), ((k + 1).min(before.len() - 1), part)];
        for (k, weight) in moved {
            pose.translation += (adjusted[k].translation - before[k].translation) * weight;
        }
        for (joint, turned) in pose.rotations.iter_mut().enumerate() {
            let turn =
                |k: usize| rotation::log(&(before[k].rotations[joint].transpose() * adjusted[k].rotations[joint]));
            *turned *= rotation::exp(&moved.iter().map(|(k, weight)| turn(*k) * *weight).sum());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    /// A motion that is turned and moved as a whole stays one: frames between adjusted ones follow.
    #[test]
    fn frames_between_adjusted_ones_are_carried_along() {
        let pose = |t: usize, turn: f64, shift: f64| {
            let mut pose = Pose::rest();
            pose.rotations[4] = rotation::exp(&Vector3::new(0.1 * t as f64, 0.0, 0.0));
            pose.rotations[4] *= rotation::exp(&Vector3::new(0.0, turn, 0.0));
            pose.translation = Vector3::new(0.02 * t as f64 + shift, 0.9, 0.0);
            pose
        };
        let mut poses: Vec<Pose> = (0..8).map(|t| pose(t, 0.0, 0.0)).collect();
        let adjusted: Vec<Pose> = (0..8).step_by(3).map(|t| pose(t, 0.2, 0.05)).collect();
        carry_along(&mut poses, &adjusted, 3);
        for (t, found) in poses.iter().enumerate() {
            let wanted = pose(t, 0.2, 0.05);
            assert!((found.rotations[4] - wanted.rotations[4]).norm() < 1e-12, "frame {t}");
            assert!((found.translation - wanted.translation).norm() < 1e-12, "frame {t}");
        }
    }
}
