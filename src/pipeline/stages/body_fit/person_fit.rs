//! The fit of one person's motion, whole or window by window.

use super::context::FitContext;
use super::gap_completion::completed_gaps;
use super::initial_motion::initial_motion;
use super::minimisation::{FittedMotion, minimised};
use super::objective::Objective;
use super::observations::Observations;
use super::pixel_residuals::{DetectedPixels, median_distance_px};
use super::terms::data::DataSource;
use super::terms::unknowns::{MotionState, Shape};
use crate::progress::Canceled;
use rayon::prelude::*;
use std::ops::Range;

/// One person after the first fit, of the window with most observations.
pub(super) struct StartedMotion {
    /// The whole track: that window and its halo as fitted, closed form elsewhere.
    pub start: MotionState,
    /// The window with most observations.
    pub window: Range<usize>,
    /// The fit of that window.
    pub fitted: FittedMotion,
}

/// Initialises one person and fits the window with most observations, shape free; `None` when the closed form fails.
pub(super) fn start_motion(
    context: &FitContext,
    observations: &Observations,
) -> Result<Option<StartedMotion>, Canceled> {
    let Some(mut start) = initial_motion(context.model, observations) else { return Ok(None) };
    let windows = windows(start.poses.len(), context.config.window_frames.max(3));
    let n_observed = |w: &Range<usize>| (n_observations(observations, w), std::cmp::Reverse(w.start));
    let Some(window) = windows.into_iter().max_by_key(n_observed) else { return Ok(None) };
    let fitted = fit_window(context, observations, &start, &window, Shape::Free, &[Pass::Points, Pass::First])?;
    start.betas = fitted.whole.state.betas;
    start.poses[fitted.frames.clone()].copy_from_slice(&fitted.whole.state.poses);
    Ok(Some(StartedMotion { start, fitted: fitted.without_halo(&window), window }))
}

/// Fits the whole track: the window of the first fit again where the model has changed or the motion prior refines, from
/// its present state; then all others with its shape.
pub(super) fn finish_motion(
    context: &FitContext,
    observations: &Observations,
    started: StartedMotion,
    has_model_changed: bool,
) -> Result<FittedMotion, Canceled> {
    let StartedMotion { start, window, mut fitted } = started;
    let mut first_iterations = 0;
    if has_model_changed || context.has_refinement() {
        first_iterations = fitted.iterations;
        fitted = fit_window(context, observations, &start, &window, Shape::Free, &[Pass::Last])?.without_halo(&window);
    }
    let windows = windows(start.poses.len(), context.config.window_frames.max(3));
    if windows.len() > 1 {
        let shaped = MotionState { betas: fitted.state.betas, ..start };
        let passes: &[Pass] = match context.has_refinement() {
            true => &[Pass::Points, Pass::First, Pass::Last],
            false => &[Pass::Points, Pass::Last],
        };
        let fit = |w: &Range<usize>| match *w == window {
            true => Ok(fitted.clone()),
            false => Ok(fit_window(context, observations, &shaped, w, Shape::Held, passes)?.without_halo(w)),
        };
        fitted = joined(windows.par_iter().map(fit).collect::<Result<_, Canceled>>()?);
    }
    fitted.iterations += first_iterations;
    fitted.median_reprojection_px = median_distance_px(context.model, observations, &fitted.state);
    Ok(fitted)
}

/// A pass of the fit of a window, from a rough start to the end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Pass {
    /// Triangulated points, since a fit from closed form straight to pixels gets stuck.
    Points,
    /// Pixels, with the settings of the first fit ([`FitContext::first_config`]).
    First,
    /// Pixels, with all terms.
    Last,
}

/// The fit of a window and its halo.
struct FittedWindow {
    whole: FittedMotion,
    /// The frames fitted.
    frames: Range<usize>,
}

impl FittedWindow {
    fn without_halo(mut self, window: &Range<usize>) -> FittedMotion {
        let own = window.start - self.frames.start..window.end - self.frames.start;
        self.whole.state.poses = self.whole.state.poses[own].to_vec();
        self.whole
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

fn joined(parts: Vec<FittedMotion>) -> FittedMotion {
    let betas = parts[0].state.betas;
    FittedMotion {
        cost_before: parts.iter().map(|p| p.cost_before).sum(),
        cost_after: parts.iter().map(|p| p.cost_after).sum(),
        iterations: parts.iter().map(|p| p.iterations).max().unwrap_or(0),
        converged: parts.iter().all(|p| p.converged),
        median_reprojection_px: None,
        state: MotionState { betas, poses: parts.into_iter().flat_map(|p| p.state.poses).collect() },
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
    let FitContext { config, first_config, .. } = *context;
    let frames =
        window.start.saturating_sub(config.halo_frames)..(window.end + config.halo_frames).min(start.poses.len());
    let observations = observations.slice(frames.clone());
    let state = MotionState { betas: start.betas, poses: start.poses[frames.clone()].to_vec() };
    let has_pixels = observations.pixels.iter().any(|frame| !frame.is_empty());
    let [on_points, on_pixels] = config.max_iterations;
    let mut whole = FittedMotion::initial(state);
    for pass in if has_pixels { passes } else { &[Pass::Points] } {
        let pixels = match pass {
            Pass::Points => None,
            Pass::First => Some(DetectedPixels::independent(context, &observations, &whole.state)),
            Pass::Last => Some(DetectedPixels::new(context, &observations, &whole.state)),
        };
        let (data, max_iterations) = match &pixels {
            Some(pixels) => (pixels.source(), on_pixels),
            None => (DataSource::Points { sigma: config.point_sigma }, on_points),
        };
        let config = if *pass == Pass::Last { config } else { first_config };
        let completion = (*pass == Pass::Last && config.completes_gaps)
            .then(|| completed_gaps(context, &observations, &whole.state))
            .flatten();
        let start = match &completion {
            Some(gaps) => gaps.applied_to(whole.state),
            None => whole.state,
        };
        let speeds = (*pass != Pass::Points).then_some(&start);
        let completion = completion.as_ref();
        let problem =
            Objective { speeds, completion, ..Objective::new(context, config, &observations, data, shape) }.problem();
        let fitted = minimised(context, &problem, start.clone(), max_iterations)?;
        whole = FittedMotion { iterations: whole.iterations + fitted.iterations, ..fitted };
    }
    Ok(FittedWindow { whole, frames })
}
