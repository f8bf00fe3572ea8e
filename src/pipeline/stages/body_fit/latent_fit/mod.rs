//! The paper's fit: motions as latent codes, optimised with betas, roots and cameras in one objective (docs/method.md 12).
//!
//! It starts from the encoder's mean of the first fit. People of long takes share the cameras and shapes of a stretch of each;
//! then their takes are fitted window by window with both held.
//!
//! | file | content |
//! |---|---|
//! | `decoder` | a motion from its codes, with derivatives |
//! | `frame_system` | the data term in one frame |
//! | `problem` | the objective, its gradient and steps |

mod decoder;
mod frame_system;
mod problem;
#[cfg(test)]
mod tests;

use super::camera_priors::CameraPriors;
use super::context::FitContext;
use super::minimisation::FittedMotion;
use super::observations::Observations;
use super::person_fit::{StartedMotion, joined};
use super::pixel_residuals::{median_distance_px, pixel_share};
use super::terms::unknowns::MotionState;
use super::window_fit::FittedWindow;
use crate::geometry::Rigid;
use crate::motion_prior::LatentPrior;
use crate::pipeline::calibration::PosedCamera;
use crate::pipeline::time_windows::windows;
use crate::progress::Canceled;
use decoder::MotionDecoder;
use problem::{LatentProblem, Member};
use std::ops::Range;

/// Most frames of all persons that are fitted together with the cameras.
const MAX_JOINT_FRAMES: usize = 1200;

/// Fits the motions of all persons, by track, and the cameras where these are adjusted; both replace those of the first fit.
/// Returns `camera_from_world` of adjusted cameras.
pub(super) fn latent_motions(
    context: &FitContext,
    started: &mut [Option<(Observations, StartedMotion)>],
) -> Result<Option<Vec<Rigid>>, Canceled> {
    let Some((observations, _)) = started.iter().flatten().next() else { return Ok(None) };
    let mut cameras = observations.cameras.clone();
    let priors = CameraPriors::of_poses(&context.config.known_cameras);
    let priors = (context.config.camera_rounds > 0 && cameras.len() > 1).then_some(&priors);
    let shares: Vec<f64> = started
        .iter()
        .flatten()
        .map(|(observations, started)| pixel_share(context, observations, &started.fitted.state))
        .collect();
    let n_people = shares.len();
    let n_frames = |started: &StartedMotion| started.fitted.state.poses.len();
    let is_short = started.iter().flatten().map(|(_, fit)| n_frames(fit)).sum::<usize>() <= MAX_JOINT_FRAMES;
    let run = |observations: &Observations, fit: &StartedMotion| match is_short {
        true => 0..n_frames(fit),
        false => observations.most_seen(fit.window.clone(), MAX_JOINT_FRAMES / n_people),
    };
    let joint = problem(context, true, priors);
    let people = started.iter().flatten().zip(&shares);
    let mut members: Vec<Member> = people
        .map(|((observations, fit), share)| {
            member(&joint, observations, &fit.fitted.state, run(observations, fit), *share)
        })
        .collect();
    let before: Vec<f64> = members.iter().map(|member| joint.cost(member, &cameras)).collect();
    let iterations = joint.minimised(&mut members, &mut cameras)?;
    let found: Vec<(MotionState, f64)> = members.into_iter().map(|member| (member.motion.state, member.cost)).collect();
    for (((observations, fit), (state, cost_after)), cost_before) in started.iter_mut().flatten().zip(found).zip(before)
    {
        observations.cameras.clone_from(&cameras);
        fit.fitted = match is_short {
            true => FittedMotion { cost_before, cost_after, iterations, ..FittedMotion::initial(state) },
            false => {
                let start = MotionState { betas: state.betas, ..fit.fitted.state.clone() };
                let share = pixel_share(context, observations, &start);
                in_windows(&problem(context, false, None), observations, &start, share, &cameras)?
            }
        };
        fit.fitted.median_reprojection_px = median_distance_px(context.model, observations, &fit.fitted.state);
    }
    Ok(priors.map(|_| cameras.iter().map(|camera| camera.camera_from_world).collect()))
}

fn problem<'a>(context: &'a FitContext, has_shape: bool, cameras: Option<&'a CameraPriors>) -> LatentProblem<'a> {
    let decoder = MotionDecoder::new(LatentPrior::embedded(), context.model, context.frame_interval);
    LatentProblem { context, decoder, has_shape, cameras }
}

/// A run of a track, at the encoder's mean.
fn member<'a>(
    problem: &LatentProblem,
    observations: &'a Observations,
    state: &MotionState,
    run: Range<usize>,
    share: f64,
) -> Member<'a> {
    let part = state.of(&run);
    Member { observations, first: run.start, share, motion: problem.decoder.encoded(&part), cost: 0.0 }
}

/// Fits a track window by window, with betas and cameras held.
fn in_windows(
    problem: &LatentProblem,
    observations: &Observations,
    start: &MotionState,
    share: f64,
    cameras: &[PosedCamera],
) -> Result<FittedMotion, Canceled> {
    let context = problem.context;
    let windows = windows(start.poses.len(), context.window_frames());
    let fit = |window: &Range<usize>| {
        let frames = context.with_halo(window, start.poses.len());
        let mut members = vec![member(problem, observations, start, frames.clone(), share)];
        let cost_before = problem.cost(&members[0], cameras);
        let iterations = problem.minimised(&mut members, &mut cameras.to_vec())?;
        let Member { motion, cost: cost_after, .. } = members.remove(0);
        let whole = FittedMotion { cost_before, cost_after, iterations, ..FittedMotion::initial(motion.state) };
        Ok(FittedWindow { whole, frames })
    };
    let fits = windows.iter().map(fit).collect::<Result<_, Canceled>>()?;
    Ok(joined(&windows, fits, context.halo_frames()))
}
