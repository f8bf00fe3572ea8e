//! The fit of one person's motion, whole or window by window.

use super::completed_joints::GapCompletion;
use super::context::FitContext;
use super::depth_sides::on_cheapest_sides;
use super::gap_completion::{Purpose, completed_gaps};
use super::initial_motion::initial_motion;
use super::minimisation::{Budget, DAMPING_FROM_FIT, DAMPING_FROM_ROUGH, FittedMotion, minimised};
use super::objective::Objective;
use super::observations::Observations;
use super::pixel_residuals::{DetectedPixels, median_distance_px};
use super::single_camera::SingleCamera;
use super::terms::data::DataSource;
use super::terms::unknowns::{MotionState, Shape};
use super::thinned_motion::{lead_through, rough_stride};
use super::trunk_sides::with_trunk_on_its_side;
use crate::body::kinematics::Pose;
use crate::optim::block_banded::BlockBanded;
use crate::progress::Canceled;
use rayon::prelude::*;
use std::ops::Range;

/// One person after the first fit.
pub(super) struct StartedMotion {
    /// Of the whole track.
    pub fitted: FittedMotion,
    /// The window with most observations, which determined the shape.
    pub window: Range<usize>,
}

/// Initialises one person and fits the track, its shape by the window with most observations; `None` when the closed form
/// fails.
pub(super) fn start_motion(
    context: &FitContext,
    observations: &Observations,
) -> Result<Option<StartedMotion>, Canceled> {
    let Some(start) = initial_motion(context.model, observations) else { return Ok(None) };
    let windows = windows(start.poses.len(), context.window_frames());
    let n_observed = |w: &Range<usize>| (n_observations(observations, w), std::cmp::Reverse(w.start));
    let Some(window) = windows.into_iter().max_by_key(n_observed) else { return Ok(None) };
    let fitted = fit_windows(
        context,
        observations,
        start,
        &window,
        [&[Pass::Points, Pass::First], &[Pass::Points, Pass::Rough]],
    )?;
    Ok(Some(StartedMotion { fitted, window }))
}

/// Fits the whole track again where the model or the settings have changed since the first fit, or where that left frames out.
pub(super) fn finish_motion(
    context: &FitContext,
    observations: &Observations,
    started: StartedMotion,
    has_model_changed: bool,
) -> Result<FittedMotion, Canceled> {
    let StartedMotion { window, mut fitted } = started;
    let is_rough = window.len() < fitted.state.poses.len() || stride(context, observations) > 1;
    if has_model_changed || context.has_refinement() || is_rough {
        let first_iterations = fitted.iterations;
        fitted = fit_windows(context, observations, fitted.state, &window, [&[Pass::Last]; 2])?;
        fitted.iterations += first_iterations;
    }
    fitted.median_reprojection_px = median_distance_px(context.model, observations, &fitted.state);
    Ok(fitted)
}

/// Fits `first` with its shape free, then all other windows with that shape; each of the two in `passes` of its own.
fn fit_windows(
    context: &FitContext,
    observations: &Observations,
    start: MotionState,
    first: &Range<usize>,
    [of_first, of_others]: [&[Pass]; 2],
) -> Result<FittedMotion, Canceled> {
    let windows = windows(start.poses.len(), context.window_frames());
    let of_first = fit_window(context, observations, &start, first, Shape::Free, of_first)?;
    let shaped = MotionState { betas: of_first.whole.state.betas, ..start };
    let fit = |w: &Range<usize>| match w == first {
        true => Ok(of_first.clone()),
        false => fit_window(context, observations, &shaped, w, Shape::Held, of_others),
    };
    let fitted = windows.par_iter().map(fit).collect::<Result<_, Canceled>>()?;
    Ok(joined(&windows, fitted, context.halo_frames()))
}

/// Fewest frames that are left by thinning; shorter windows are fitted whole.
const MIN_THINNED: usize = 30;

/// A pass of the fit of a window, from a rough start to the end. All but the last take every few frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Pass {
    /// Triangulated points, since a fit from closed form straight to pixels gets stuck.
    Points,
    /// Pixels, with the settings of the first fit ([`FitContext::first_config`]), of windows that only the last pass goes on from.
    Rough,
    /// The same of the window with most observations, which determines the shape, and on which the detector's errors are measured.
    First,
    /// Pixels, with all terms.
    Last,
}

impl Pass {
    /// Later passes start from where the first ones end, and come out the same whether those take 1 to 3 steps or twice as many:
    /// cameras within 0.6 %, joints within 0.3 % on 43 captures. With all frames in place of every third, cameras move by less than
    /// 2 % over 51 captures, and joints come no closer.
    fn budget(self, context: &FitContext, n_cameras: usize, shape: Shape) -> Budget {
        let FitContext { config, noise, .. } = *context;
        let (damping, max_iterations) = (DAMPING_FROM_ROUGH, config.max_iterations);
        match self {
            Self::Points => Budget { max_iterations: 2, min_decrease: 3e-2, damping },
            Self::Rough => Budget { max_iterations, min_decrease: 3e-2, damping },
            Self::First => Budget { max_iterations, min_decrease: 3e-3, damping },
            Self::Last => {
                let is_shape_known = shape == Shape::Held && noise.is_some() && n_cameras > 2;
                let max_iterations = if is_shape_known { STEPS_OF_KNOWN_SHAPE } else { max_iterations };
                Budget { max_iterations, min_decrease: config.min_decrease, damping: DAMPING_FROM_FIT }
            }
        }
    }
}

/// Most steps of the last pass of a window whose shape another one has determined, once three cameras or more have shown the detector's
/// errors. A third lowers the cost by 0.3 to 0.9 % and brings joints no closer: without it they are 0.4 to 1 % nearer to the truth (each of
/// twelve takes of 1,500 and 3,000 frames), and jitter is 0.6 to 1.6 % less. Where the shape is free the third step is worth 0.4 %, with
/// two cameras 0 to 1.6 % on realistic noise.
const STEPS_OF_KNOWN_SHAPE: usize = 2;

/// Most steps of the last pass before gaps are completed again: with four, joints come out the same to 0.1 % on 131 captures, hidden ones
/// as well; with two, single captures differ by 3 %.
const STEPS_FROM_ROUGH: usize = 3;

/// The fit of a window and its halo.
#[derive(Clone)]
pub(super) struct FittedWindow {
    pub whole: FittedMotion,
    /// The frames fitted.
    pub frames: Range<usize>,
}

impl FittedWindow {
    /// At a frame of the track.
    fn pose(&self, t: usize) -> &Pose {
        &self.whole.state.poses[t - self.frames.start]
    }
}

/// Runs of at most `length` frames, their lengths as equal as possible.
pub(super) fn windows(n_frames: usize, length: usize) -> Vec<Range<usize>> {
    let count = n_frames.div_ceil(length);
    (0..count).map(|i| i * n_frames / count..(i + 1) * n_frames / count).collect()
}

fn n_observations(observations: &Observations, window: &Range<usize>) -> usize {
    window.clone().map(|t| observations.pixels[t].len() + observations.points[t].len()).sum()
}

/// One motion of all windows, which fade into each other over their halos: a jump between them would look like fast motion to
/// terms that are scaled by speed.
pub(super) fn joined(windows: &[Range<usize>], fits: Vec<FittedWindow>, halo: usize) -> FittedMotion {
    let mut poses: Vec<Pose> =
        windows.iter().zip(&fits).flat_map(|(window, fit)| window.clone().map(|t| *fit.pose(t))).collect();
    let fade = windows.iter().map(|window| window.len() / 2).min().unwrap_or(0).min(halo);
    for (window, [fit, next]) in windows.iter().zip(fits.array_windows()) {
        for t in window.end - fade..window.end + fade {
            let share = ((t + fade - window.end) as f64 + 0.5) / (2 * fade) as f64;
            poses[t] = fit.pose(t).towards(next.pose(t), share);
        }
    }
    let parts = || fits.iter().map(|fit| &fit.whole);
    FittedMotion {
        cost_before: parts().map(|p| p.cost_before).sum(),
        cost_after: parts().map(|p| p.cost_after).sum(),
        iterations: parts().map(|p| p.iterations).max().unwrap_or(0),
        converged: parts().all(|p| p.converged),
        median_reprojection_px: None,
        state: MotionState { betas: fits[0].whole.state.betas, poses },
    }
}

/// Fits a window and its halo in `passes`; to points alone where there are no pixels.
fn fit_window(
    context: &FitContext,
    observations: &Observations,
    start: &MotionState,
    window: &Range<usize>,
    shape: Shape,
    passes: &[Pass],
) -> Result<FittedWindow, Canceled> {
    let frames = context.with_halo(window, start.poses.len());
    let observations = observations.slice(frames.clone());
    let state = start.of(&frames);
    let has_pixels = observations.pixels.iter().any(|frame| !frame.is_empty());
    let (mut whole, mut system) = (FittedMotion::initial(state), context.systems.take());
    for pass in if has_pixels { passes } else { &[Pass::Points] } {
        let is_rough = has_pixels && *pass != Pass::Last;
        let fitted = match if is_rough { stride(context, &observations) } else { 1 } {
            1 => fit_pass(context, &observations, whole.state, shape, *pass, &mut system)?,
            stride => fit_thinned(context, &observations, whole.state, shape, *pass, stride, &mut system)?,
        };
        whole = FittedMotion { iterations: whole.iterations + fitted.iterations, ..fitted };
    }
    context.systems.put_back([system]);
    Ok(FittedWindow { whole, frames })
}

/// Every how many frames a rough pass takes one. A single camera leaves so much open that its fit wants all of them.
fn stride(context: &FitContext, observations: &Observations) -> usize {
    let stride = rough_stride(context.frame_interval);
    let has_enough = observations.cameras.len() > 1 && observations.pixels.len() >= MIN_THINNED * stride;
    if has_enough { stride } else { 1 }
}

/// A pass over every `stride`-th frame; those between follow.
fn fit_thinned(
    context: &FitContext,
    observations: &Observations,
    start: MotionState,
    shape: Shape,
    pass: Pass,
    stride: usize,
    system: &mut BlockBanded,
) -> Result<FittedMotion, Canceled> {
    let context = FitContext { frame_interval: stride as f64 * context.frame_interval, ..*context };
    let MotionState { betas, mut poses } = start;
    let few = MotionState { betas, poses: poses.iter().step_by(stride).copied().collect() };
    let thinned = observations.thinned(0..observations.pixels.len(), stride);
    let fitted = fit_pass(&context, &thinned, few, shape, pass, system)?;
    lead_through(&mut poses, &fitted.state.poses, stride);
    Ok(FittedMotion { state: MotionState { poses, ..fitted.state }, ..fitted })
}

/// One pass over all frames of `observations`.
fn fit_pass(
    context: &FitContext,
    observations: &Observations,
    start: MotionState,
    shape: Shape,
    pass: Pass,
    system: &mut BlockBanded,
) -> Result<FittedMotion, Canceled> {
    let FitContext { config, first_config, .. } = *context;
    let pixels = match pass {
        Pass::Points => None,
        Pass::Rough | Pass::First => Some(DetectedPixels::independent(context, observations, &start)),
        Pass::Last => Some(DetectedPixels::new(context, observations, &start)),
    };
    let data = pixels.as_ref().map_or(DataSource::Points { sigma: config.point_sigma }, DetectedPixels::source);
    let budget = pass.budget(context, observations.cameras.len(), shape);
    let config = if pass == Pass::Last { config } else { first_config };
    let alone = (pass == Pass::Last).then(|| SingleCamera::new(context.model, observations, context.frame_interval));
    let is_open = alone.as_ref().map_or_else(Vec::new, SingleCamera::open_frames);
    let minimised_within =
        |budget: Budget, completion: Option<&GapCompletion>, start: MotionState, system: &mut BlockBanded| {
            let speeds = (pass != Pass::Points).then_some(&start);
            let objective = Objective {
                speeds,
                completion,
                is_open: &is_open,
                ..Objective::new(context, config, observations, data, shape)
            };
            minimised(context, &objective.problem(), start.clone(), budget, system)
        };
    let completed = |state: &MotionState, purpose: Purpose| {
        let alone = alone.as_ref().filter(|_| config.completes_gaps)?;
        completed_gaps(context, observations, alone, state, purpose)
    };
    // The first fit has no pose prior, so that what it states at the edges of gaps (twists about bones above all) is rough.
    let start = match &alone {
        Some(alone) => with_trunk_on_its_side(context, observations, alone, start),
        None => start,
    };
    let Some(rough) = completed(&start, Purpose::FromRough) else {
        return minimised_within(budget, None, start, system);
    };
    // Which only has to be good enough to start from: with all steps hidden joints come no closer.
    let few = Budget { max_iterations: STEPS_FROM_ROUGH.min(budget.max_iterations), ..budget };
    let fitted = minimised_within(few, Some(&rough), rough.applied_to(start), system)?;
    let good = completed(&fitted.state, Purpose::FromGood);
    let start = match &good {
        Some(gaps) => on_cheapest_sides(context, observations, gaps, gaps.applied_to(fitted.state)),
        None => fitted.state,
    };
    let again = minimised_within(budget, good.as_ref(), start, system)?;
    Ok(FittedMotion { iterations: fitted.iterations + again.iterations, cost_before: fitted.cost_before, ..again })
}

#[cfg(test)]
mod tests {
    use super::super::terms::noise_process::PathNoise;
    use super::super::test_fixtures::Surroundings;
    use super::*;

    /// Two cameras, errors that were not measured, and a window that determines the shape ask for all steps.
    #[test]
    fn windows_of_a_known_shape_take_two_steps() {
        let surroundings = Surroundings::new();
        let noise = PathNoise::white(1, 1.0);
        let unmeasured = surroundings.context();
        let measured = FitContext { noise: Some(&noise), ..unmeasured };
        let steps = |context: &FitContext, n_cameras: usize, shape: Shape| {
            Pass::Last.budget(context, n_cameras, shape).max_iterations
        };
        let all = surroundings.config.max_iterations;
        assert_eq!(steps(&measured, 3, Shape::Held), 2);
        assert_eq!(steps(&measured, 3, Shape::Free), all);
        assert_eq!(steps(&measured, 2, Shape::Held), all);
        assert_eq!(steps(&unmeasured, 3, Shape::Held), all);
    }
}
