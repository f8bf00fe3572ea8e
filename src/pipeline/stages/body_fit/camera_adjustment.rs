//! Cameras adjusted together with the motions of all persons, under errors that are correlated in time.
//!
//! Bundle adjustment takes the detector's errors as independent. They are slow, so that what lies still says little and what
//! moves says much: with the errors whitened the cameras' errors fall by a third on realistic noise.

use super::averaging::averaged;
use super::camera_priors::CameraPriors;
use super::context::FitContext;
use super::focal_prior::{FocalPrior, RefinedFocal};
use super::joint_problem::{CameraSpread, JointProblem, Member, Stopping};
use super::noise_measurement::measured_noise;
use super::observations::Observations;
use super::person_fit::StartedMotion;
use super::terms::border_priors::{BoneLengthPrior, KeypointBiasPrior};
use super::terms::noise_process::PathNoise;
use super::terms::unknowns::MotionState;
use super::thinned_motion::{carry_along, rough_stride};
use crate::geometry::Rigid;
use crate::geometry::free_network::CameraCovariance;
use crate::pipeline::calibration::PosedCamera;
use crate::pipeline::focal_spread::{FocalSpread, FoundFactors};
use crate::progress::Canceled;
use crate::session::reconstruction::FocalFactor;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// The detector's errors, and the cameras after the adjustment.
#[derive(Debug, Clone)]
pub(super) struct AdjustedCameras {
    /// `camera_from_world` of the placed cameras; `None` where they were held.
    pub cameras: Option<Vec<Rigid>>,
    /// Of the adjusted cameras.
    pub covariance: Option<CameraCovariance>,
    /// Focal lengths of the placed cameras; `None` where they were held.
    pub focal: Option<RefinedFocal>,
    /// The detector's errors.
    pub noise: PathNoise,
    /// Those of frames [`rough_stride`] apart that are [`averaged`].
    pub averaged_noise: PathNoise,
}

/// Most frames of all persons together, spread over the take: cameras that are seen this often are known to a third of what constant errors of the
/// detector leave open.
const MAX_FRAMES: usize = 1200;

/// Standard deviation of a person's bones about those of the betas, m per axis: joint centres of another definition, and
/// proportions that the betas do not span.
pub(super) const BONE_SIGMA: f64 = 0.01;

/// A step of less than a tenth of a standard deviation is the last: the next would be a hundredth.
const STOPPING: Stopping = Stopping { max_iterations: 8, min_decrease: 0.5, min_sigmas: 0.1 };

/// In a round that another follows, under errors that are measured anew.
const ROUND_STOPPING: Stopping = Stopping { min_sigmas: 0.3, ..STOPPING };

/// Fewest frames of one person.
const MIN_FRAMES: usize = 60;

/// Longest time between the frames of the adjustment where it could take more of them, s.
///
/// Residuals that lie farther apart tell more of the slow part of the errors than those of successive frames, and what lies
/// between says little of it that is new: with every second or third frame at 30 Hz cameras come 6 to 14 % closer than with all, in a
/// third of the time. Of white errors every frame counts: cameras came 11 to 13 % worse. What is white of slow errors, their outliers
/// and holes are averaged over the frames between ([`averaged`]): angles of cameras are 0.70 to 1.04 times those without,
/// by kind of capture, 0.88 in the mean of 69.
const FRAME_SECS: f64 = 0.1;

/// Least autocorrelation of the errors of successive frames of the adjustment, if it leaves out any that it could take.
const MIN_SHARED: f64 = 0.7;

/// Fewest frames of all persons that are left by thinning, unless each has [`MIN_LEFT_OF_PERSON`].
const MIN_LEFT: usize = 300;

/// Fewest frames of a person, in the mean, that are left by thinning, unless all together have [`MIN_LEFT`]: with 50 or 75 cameras come up
/// to a third worse. With 300 of one or two persons angles are 1.6 and 1.2 times as large at 60 frames a second (8 and 6 captures), 1.1
/// and 1.0 times at 30 (26 and 18): what lies between frames of 0.1 s is counted as if it were new.
const MIN_LEFT_OF_PERSON: usize = 100;

/// Measures the detector's errors on the first fits of all persons. Where `config.camera_rounds` is not 0, cameras and first fits are
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
    let seen_most = |started: &[Option<(Observations, StartedMotion)>]| -> Vec<Member> {
        let member = |(observations, fit): &(Observations, StartedMotion)| {
            Member::of(observations, fit, observations.most_seen(fit.window.clone(), n_frames), 1)
        };
        started.iter().flatten().map(member).collect()
    };
    let rough_stride = rough_stride(context.frame_interval);
    let (mut cameras, mut focal, mut covariance) = (None, None, None);
    let (mut measured, mut measured_averaged) = (None, None);
    if context.config.camera_rounds > 0 {
        let n_tracked: usize = started.iter().flatten().map(|(observations, _)| observations.pixels.len()).sum();
        let informative = informative_stride(context, &seen_most(started), n_tracked / n_people);
        let stride = n_tracked.div_ceil(MAX_FRAMES).max(informative);
        let spread = |(observations, fit): &(Observations, StartedMotion)| {
            let averaged = averaged(context.model, observations, &fit.fitted.state, stride);
            Member::new(averaged, fit, 0..observations.pixels.len(), stride)
        };
        let mut adjusted: Vec<Member> = started.iter().flatten().map(spread).collect();
        let thinned = context.thinned(stride);
        if !stride.is_multiple_of(rough_stride) {
            // Frames between those of the first fits do not show the detector's errors before they have settled.
            settle(&thinned, &mut adjusted)?;
        }
        (covariance, focal) = adjust(&thinned, &mut adjusted)?;
        if stride == rough_stride {
            measured_averaged = Some(measured_noise(&thinned, &adjusted));
        }
        cameras = adjusted.first().map(|member| member.observations.cameras.clone());
        for ((observations, started), member) in started.iter_mut().flatten().zip(&adjusted) {
            take_over(observations, started, member, stride <= informative);
        }
        // With the bones of the adjustment: what the betas do not span would look like slow errors of the detector, and with
        // errors that large and slow joints come up to a fifth worse.
        let with_bones = |(member, adjusted): (Member, Member)| Member {
            state: MotionState { betas: adjusted.state.betas, ..member.state },
            bones: adjusted.bones,
            ..member
        };
        let mut members: Vec<Member> = seen_most(started).into_iter().zip(adjusted).map(with_bones).collect();
        if stride > 1 {
            // The same holds for frames between adjusted ones.
            settle(context, &mut members)?;
        }
        measured = Some(measured_noise(context, &members));
    }
    let noise = measured.unwrap_or_else(|| measured_noise(context, &seen_most(started)));
    let poses = |cameras: Vec<PosedCamera>| cameras.iter().map(|camera| camera.camera_from_world).collect();
    let averaged_noise = measured_averaged.unwrap_or_else(|| noise.thinned(rough_stride));
    Ok(Some(AdjustedCameras { cameras: cameras.map(poses), focal, noise, averaged_noise, covariance }))
}

/// Every how many frames the adjustment takes one, by how much each says that is new; `n_frames`: those of a person, in the mean.
fn informative_stride(context: &FitContext, members: &[Member], n_frames: usize) -> usize {
    let n_seen: usize = members.iter().map(|member| member.run.len()).sum();
    let longest = longest_stride(context.frame_interval, n_seen, n_frames);
    let typical = measured_noise(context, members).typical();
    (2..=longest).rev().find(|&stride| typical.after(stride) >= MIN_SHARED).unwrap_or(1)
}

/// `n_seen`: frames of all persons; `n_frames`: those of one, in the mean.
fn longest_stride(frame_interval: f64, n_seen: usize, n_frames: usize) -> usize {
    let left = (n_seen / MIN_LEFT).max(n_frames / MIN_LEFT_OF_PERSON);
    ((FRAME_SECS / frame_interval).round() as usize).min(left)
}

/// Covariance of the cameras, and focal lengths where they are unknowns.
type Refined = (Option<CameraCovariance>, Option<RefinedFocal>);

/// Adjusts cameras and motions of all members in rounds, each under the errors that the one before left.
fn adjust(context: &FitContext, members: &mut [Member]) -> Result<Refined, Canceled> {
    let known = &context.config.known_cameras;
    let (priors, held) = (CameraPriors::new(known), CameraPriors::of_poses(known));
    let mut noise = measured_noise(context, members);
    for _ in 1..context.config.camera_rounds {
        problem(context, &noise, Some(&held)).minimised(members, Vec::new(), &ROUND_STOPPING)?;
        noise = measured_noise(context, members);
    }
    if priors.focal.is_some() {
        return with_lenses(context, members, noise, priors);
    }
    let last = problem(context, &noise, Some(&held));
    Ok((last.minimised_and_marginalised(members, &STOPPING, slow(&noise))?, None))
}

/// The same with focal lengths among the unknowns, from where cameras and motions have settled without; `noise`: of there.
fn with_lenses(
    context: &FitContext,
    members: &mut [Member],
    noise: PathNoise,
    mut priors: CameraPriors,
) -> Result<Refined, Canceled> {
    let round = problem(context, &noise, Some(&priors));
    round.minimised_over_motions(members, &ROUND_STOPPING)?;
    let spread = round.spread_of_cameras(members, slow(&noise));
    if let Some((_, likeliest)) = spread.and_then(|spread| refined_focal(&round, members, &spread)) {
        priors.overcount = likeliest.overcount;
    }
    // Whether lenses are as given is decided where they are free: held to the given lengths, the noise that is measured there
    // has absorbed their errors.
    let noise = measured_noise(context, members);
    let free = problem(context, &noise, Some(&priors));
    free.minimised_over_motions(members, &STOPPING)?;
    let Some(spread) = free.spread_of_cameras(members, slow(&noise)) else {
        return Ok((None, undetermined_focal(members, &priors)));
    };
    let Some((mut focal, likeliest)) = refined_focal(&free, members, &spread) else {
        return Ok((free.covariance(members, &spread), undetermined_focal(members, &priors)));
    };
    let last = problem(context, &noise, Some(&likeliest));
    if !priors.has_spread_of(&likeliest) {
        last.minimised_over_motions(members, &STOPPING)?;
    }
    let spread = last.spread_of_cameras(members, slow(&noise));
    if let Some((found, _)) = spread.as_ref().and_then(|spread| refined_focal(&last, members, spread)) {
        focal = RefinedFocal { factors: found.factors, ..focal };
    }
    Ok((spread.and_then(|spread| last.covariance(members, &spread)), Some(focal)))
}

/// Autocorrelation of the errors from frame to frame.
fn slow(noise: &PathNoise) -> f64 {
    noise.typical().autocorrelation
}

/// One step of the motions alone.
pub(super) fn settle(context: &FitContext, members: &mut [Member]) -> Result<(), Canceled> {
    let noise = measured_noise(context, members);
    let once = Stopping { max_iterations: 1, ..STOPPING };
    let problem = problem(context, &noise, None);
    // With the cameras held they have nothing in common, and need not be in memory at once.
    members.par_iter_mut().try_for_each(|member| {
        problem.minimised(std::slice::from_mut(member), Vec::new(), &once)?;
        Ok(())
    })
}

/// The joint problem without offsets of the detector: they are in the model; released again, they cost half of the time and
/// change no camera by a tenth of its standard deviation.
fn problem<'a>(
    context: &'a FitContext<'a>,
    noise: &'a PathNoise,
    cameras: Option<&'a CameraPriors>,
) -> JointProblem<'a> {
    JointProblem {
        context,
        table: None,
        noise,
        bone_prior: BoneLengthPrior { sigma: BONE_SIGMA },
        bias_prior: KeypointBiasPrior { sigmas: Vec::new() },
        cameras,
    }
}

/// Focal lengths at a minimum, and the priors with the likeliest spread of their errors; `None` where they are held or the session
/// does not determine them.
fn refined_focal(
    problem: &JointProblem,
    members: &[Member],
    spread: &CameraSpread,
) -> Option<(RefinedFocal, CameraPriors)> {
    let priors = problem.cameras?;
    let prior = priors.focal.as_ref()?;
    let cameras = &members.first()?.observations.cameras;
    let log_factors = prior.log_factors(cameras);
    let columns: Vec<usize> = priors.focal_columns(cameras.len()).collect();
    let (inverse_hessian, covariance) = (spread.inverse_hessian(&columns), spread.covariance(&columns));
    let precision = prior.precision() * priors.overcount;
    let found = FoundFactors::new(&log_factors, &inverse_hessian, &covariance, &precision)?;
    let (likeliest, log_evidence) = prior.likeliest(&found);
    tracing::debug!(?likeliest, log_evidence, "spread of focal lengths");
    tracing::trace!(?found, "focal lengths shown");
    let (_, posterior) = found.under(likeliest)?;
    let factors = focal_factors(&log_factors, &posterior);
    let overcount = match [FocalSpread::WIDE, FocalSpread::UNKNOWN].contains(&prior.spread) {
        // Beside the weights of the normal equations. By the Hessian, a fifth less, cameras of realistic noise came 4 % worse.
        true => found.overcount(&inverse_hessian, &precision) / spread.curvature_per_weight,
        false => priors.overcount,
    };
    let are_as_given = likeliest == FocalSpread::CALIBRATED;
    let focal = Some(FocalPrior { spread: likeliest, ..prior.clone() });
    Some((RefinedFocal { factors, log_evidence, are_as_given }, CameraPriors { focal, overcount, ..priors.clone() }))
}

/// Focal lengths as they stand, which the session does not determine: as uncertain as before it.
fn undetermined_focal(members: &[Member], priors: &CameraPriors) -> Option<RefinedFocal> {
    let prior = priors.focal.as_ref()?;
    let log_factors = prior.log_factors(&members.first()?.observations.cameras);
    let covariance = prior.precision().cholesky()?.inverse();
    let factors = focal_factors(&log_factors, &covariance);
    Some(RefinedFocal { factors, log_evidence: 0.0, are_as_given: false })
}

/// From logarithms and their covariance.
fn focal_factors(log_factors: &DVector<f64>, covariance: &DMatrix<f64>) -> Vec<FocalFactor> {
    let factor = |(k, log_factor): (usize, &f64)| {
        let value = log_factor.exp();
        FocalFactor { value, sigma: value * covariance[(k, k)].max(0.0).sqrt() }
    };
    log_factors.iter().enumerate().map(factor).collect()
}

/// The first fit goes on from where the adjustment ended; frames between adjusted ones are carried along.
///
/// Where adjusted frames lie so far apart that each has errors of its own, poses stay those of the first fit. With them taken
/// over, joints came 6 % worse.
fn take_over(observations: &mut Observations, started: &mut StartedMotion, member: &Member, takes_poses: bool) {
    if takes_poses {
        carry_along(&mut started.fitted.state.poses[member.run.clone()], &member.state.poses, member.stride);
    }
    started.fitted.state.betas = member.betas_alone.unwrap_or(member.state.betas);
    observations.cameras.clone_from(&member.observations.cameras);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One person at 60 Hz was seen every 1/30 s, whose errors were counted as if each were new.
    #[test]
    fn one_person_at_a_high_rate_is_thinned_like_several() {
        assert_eq!(longest_stride(1.0 / 60.0, 600, 600), 6);
        assert_eq!(longest_stride(1.0 / 30.0, 300, 300), 3);
        assert_eq!(longest_stride(1.0 / 25.0, 1100, 275), 3, "all together have enough");
        assert_eq!(longest_stride(1.0 / 30.0, 300, 150), 1, "short takes are not thinned");
        assert_eq!(longest_stride(1.0 / 30.0, 60, 60), 0);
    }
}
