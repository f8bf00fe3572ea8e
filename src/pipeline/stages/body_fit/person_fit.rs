//! The fit of one person's motion, whole or window by window.

use super::completed_joints::GapCompletion;
use super::config::BodyFitConfig;
use super::context::FitContext;
use super::depth_sides::on_cheapest_sides;
use super::gap_completion::{Purpose, completed_gaps};
use super::initial_motion::initial_motion;
use super::minimisation::{Budget, DAMPING_FROM_FIT, DAMPING_FROM_ROUGH, FittedMotion, minimised};
use super::objective::Objective;
use super::observations::Observations;
use super::pixel_residuals::{DetectedPixels, median_distance_px};
use super::single_camera::SingleCamera;
use super::terms::border_priors::ShapePrior;
use super::terms::data::DataSource;
use super::terms::unknowns::{MotionState, Shape};
use super::thinned_motion::{lead_through, rough_stride};
use super::trunk_sides::with_trunk_on_its_side;
use crate::body::kinematics::Pose;
use crate::body::model::Betas;
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
    let fitted = fit_first(context, observations, start, &window)?;
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
        fitted = fit_last(context, observations, fitted.state)?;
        fitted.iterations += first_iterations;
    }
    fitted.median_reprojection_px = median_distance_px(context.model, observations, &fitted.state);
    Ok(fitted)
}

/// Fits `first` with its shape free, then all other windows, roughly, with that shape.
fn fit_first(
    context: &FitContext,
    observations: &Observations,
    start: MotionState,
    first: &Range<usize>,
) -> Result<FittedMotion, Canceled> {
    let windows = windows(start.poses.len(), context.window_frames());
    let of_first = fit_window(context, observations, &start, first, Shape::Free, &[Pass::Points, Pass::First])?;
    let shaped = MotionState { betas: of_first.whole.state.betas, ..start };
    let fit = |w: &Range<usize>| match w == first {
        true => Ok(of_first.clone()),
        false => fit_window(context, observations, &shaped, w, Shape::Held, &[Pass::Points, Pass::Rough]),
    };
    let fitted = windows.par_iter().map(fit).collect::<Result<_, Canceled>>()?;
    Ok(joined(&windows, fitted, context.halo_frames()))
}

/// Fits all windows at once: a step in which each has a shape of its own, then with the shape that all of them say together. From the
/// observations of one window alone, the best one, joints of 30 to 50 s of realistic noise came 2 to 9 % farther from the truth.
fn fit_last(context: &FitContext, observations: &Observations, start: MotionState) -> Result<FittedMotion, Canceled> {
    let windows = windows(start.poses.len(), context.window_frames());
    let fit_all = |start: &MotionState, shape: Shape, pass: Pass| -> Result<Vec<FittedWindow>, Canceled> {
        windows.par_iter().map(|window| fit_window(context, observations, start, window, shape, &[pass])).collect()
    };
    if windows.len() == 1 {
        return Ok(joined(&windows, fit_all(&start, Shape::Free, Pass::Last)?, context.halo_frames()));
    }
    let own_shapes = fit_all(&start, Shape::Free, Pass::Shape)?;
    let betas = common_betas(context, &own_shapes).unwrap_or(start.betas);
    let moved = joined(&windows, own_shapes, context.halo_frames());
    let start = MotionState { betas, ..moved.state };
    let fitted = joined(&windows, fit_all(&start, Shape::Held, Pass::Last)?, context.halo_frames());
    Ok(FittedMotion { iterations: moved.iterations + fitted.iterations, cost_before: moved.cost_before, ..fitted })
}

/// The betas at which all windows together cost least, each of which costs least at its own `b` and has the prior `P` in its information
/// `H`, but all of them only once: `(sum H - (n - 1) P)^-1 sum H b`. Windows that took no step, such as those that the person is absent
/// from, say nothing; `None` where none took one.
fn common_betas(context: &FitContext, windows: &[FittedWindow]) -> Option<Betas> {
    let prior = ShapePrior::new(context.config.shape_priors(), context.model).hessian();
    let says = |FittedWindow { whole, .. }: &FittedWindow| Some((whole.beta_information?, whole.state.betas));
    let said: Vec<_> = windows.iter().filter_map(says).collect();
    let information = said.iter().fold(prior, |sum, (of_window, _)| sum + (of_window - prior));
    let pull: Betas = said.iter().map(|(of_window, betas)| of_window * betas).sum();
    if said.is_empty() { None } else { Some(information.cholesky()?.solve(&pull)) }
}

/// Fewest frames that are left by thinning; shorter windows are fitted whole.
const MIN_THINNED: usize = 30;

/// A pass of the fit of a window, from a rough start to the end. All but the last two take every few frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Pass {
    /// Triangulated points, since a fit from closed form straight to pixels gets stuck.
    Points,
    /// Pixels, with the settings of the first fit ([`FitContext::first_config`]), of windows that only the last pass goes on from.
    Rough,
    /// The same of the window with most observations, which determines the shape, and on which the detector's errors are measured.
    First,
    /// Pixels, with all terms, as far as the shape wants it.
    Shape,
    /// The same to the end.
    Last,
}

impl Pass {
    /// Later passes start from where the first ones end, and come out the same whether those take 1 to 3 steps or twice as many:
    /// cameras within 0.6 %, joints within 0.3 % on 43 captures. With all frames in place of every third, cameras move by less than
    /// 2 % over 51 captures, and joints come no closer.
    fn budget(self, config: &BodyFitConfig) -> Budget {
        let BodyFitConfig { max_iterations, min_decrease, .. } = *config;
        let (from_rough, from_fit) = (DAMPING_FROM_ROUGH, DAMPING_FROM_FIT);
        match self {
            Self::Points => Budget { max_iterations: 2, min_decrease: 3e-2, damping: from_rough },
            Self::Rough => Budget { max_iterations, min_decrease: 3e-2, damping: from_rough },
            Self::First => Budget { max_iterations, min_decrease: 3e-3, damping: from_rough },
            Self::Shape => Budget { max_iterations: 1, min_decrease, damping: from_fit },
            Self::Last => Budget { max_iterations, min_decrease, damping: from_fit },
        }
    }

    /// Whether it takes all frames, and what other passes leave for the end.
    fn is_full(self) -> bool {
        matches!(self, Self::Shape | Self::Last)
    }
}

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
        beta_information: None,
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
        let is_rough = has_pixels && !pass.is_full();
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
        Pass::Shape | Pass::Last => Some(DetectedPixels::new(context, observations, &start)),
    };
    let data = pixels.as_ref().map_or(DataSource::Points { sigma: config.point_sigma }, DetectedPixels::source);
    let budget = pass.budget(context.config);
    let config = if pass.is_full() { config } else { first_config };
    let alone = pass.is_full().then(|| SingleCamera::new(context.model, observations, context.frame_interval));
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
    if pass == Pass::Shape {
        return Ok(fitted);
    }
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
    use super::super::terms::border_priors::BetaInformation;
    use super::super::test_fixtures::Surroundings;
    use super::*;
    use nalgebra::SMatrix;

    /// The shape of a long take came from its best window alone. Two quadratic costs, each of which has the prior in it: the betas of least
    /// cost together, with the prior counted once.
    #[test]
    fn the_shape_comes_from_all_windows() {
        let surroundings = Surroundings::new();
        let context = surroundings.context();
        let prior = ShapePrior::new(context.config.shape_priors(), context.model).hessian();
        let data = |k: usize| {
            let root = SMatrix::<f64, 12, 10>::from_fn(|i, j| ((7 * i + 3 * j * j + 5 * k) % 11) as f64 - 5.0);
            (root.tr_mul(&root), Betas::from_fn(|i, _| 40.0 - (9 * i + 3 * k) as f64))
        };
        let least = |hessian: BetaInformation, pull: Betas| hessian.cholesky().unwrap().solve(&pull);
        let window = |k: usize| {
            let (hessian, pull) = data(k);
            let state = MotionState { betas: least(hessian + prior, pull), poses: Vec::new() };
            let whole = FittedMotion { beta_information: Some(hessian + prior), ..FittedMotion::initial(state) };
            FittedWindow { whole, frames: 0..0 }
        };
        let ((first, of_first), (second, of_second)) = (data(0), data(1));
        let expected = least(first + second + prior, of_first + of_second);
        let absent = || {
            let state = MotionState { betas: Betas::repeat(9.0), poses: Vec::new() };
            FittedWindow { whole: FittedMotion::initial(state), frames: 0..0 }
        };
        let found = common_betas(&context, &[window(0), absent(), window(1)]).unwrap();
        assert!((found - expected).norm() < 1e-9, "{found} {expected}");
        assert_eq!(
            common_betas(&context, &[absent()]),
            None,
            "where the person is absent nothing is said of the shape"
        );
    }
}
