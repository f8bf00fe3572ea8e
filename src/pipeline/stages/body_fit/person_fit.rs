//! The fit of one person's motion, whole or window by window.

use super::context::FitContext;
use super::initial_motion::initial_motion;
use super::minimisation::FittedMotion;
use super::observations::Observations;
use super::pixel_residuals::median_distance_px;
use super::single_camera::SingleCamera;
use super::terms::border_priors::ShapePrior;
use super::terms::unknowns::{MotionState, Shape};
use super::window_fit::{FittedWindow, Pass, fit_window, stride};
use crate::body::kinematics::Pose;
use crate::body::model::Betas;
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

/// Fits all windows at once: averaged frames, where the errors of several cameras have been measured; then a step in which each window
/// has a shape of its own, and to the end with the shape that all of them say together. From the observations of one window alone, the
/// best one, joints of 30 to 50 s of realistic noise came 2 to 9 % farther from the truth; from averaged frames, of which the prior
/// decides more, 8 to 20 %.
fn fit_last(context: &FitContext, observations: &Observations, start: MotionState) -> Result<FittedMotion, Canceled> {
    let windows = windows(start.poses.len(), context.window_frames());
    let fit_all = |start: &MotionState, shape: Shape, pass: Pass| -> Result<Vec<FittedWindow>, Canceled> {
        windows.par_iter().map(|window| fit_window(context, observations, start, window, shape, &[pass])).collect()
    };
    let join = |fits: Vec<FittedWindow>| joined(&windows, fits, context.halo_frames());
    let averaged_noise = context.averaged_noise.filter(|_| averages(context, observations));
    // With the shape of a single window held until the end, one step would leave it short of its minimum.
    let shape = if windows.len() == 1 { Shape::Free } else { Shape::Held };
    let (started, last) = match averaged_noise {
        Some(_) => (join(fit_all(&start, shape, Pass::Averaged)?), Pass::Finish),
        None => (FittedMotion::initial(start), Pass::Last),
    };
    let is_near = averaged_noise.is_none_or(|noise| noise.typical().autocorrelation >= SLOW);
    if windows.len() == 1 && is_near {
        return Ok(join(fit_all(&started.state, Shape::Free, last)?).after(&started));
    }
    let own_shapes = fit_all(&started.state, Shape::Free, Pass::Shape)?;
    let betas = common_betas(context, &own_shapes).unwrap_or(started.state.betas);
    let moved = join(own_shapes).after(&started);
    let shaped = MotionState { betas, ..moved.state.clone() };
    let fitted = join(fit_all(&shaped, Shape::Held, last)?).after(&moved);
    Ok(FittedMotion { cost_before: moved.cost_before, ..fitted })
}

/// Whether the last fit of a track begins with averaged frames. Where one camera alone shows the person, what guides the fit comes with all
/// frames, and steps of averaged ones lead limbs to the wrong side in depth: joints of runners who come into sight and leave it were up
/// to a third farther off.
fn averages(context: &FitContext, observations: &Observations) -> bool {
    let is_open = || SingleCamera::new(context.model, observations, context.frame_interval).open_frames();
    stride(context, observations) > 1 && !is_open().contains(&true)
}

/// Least autocorrelation of the errors of averaged frames with which one step leads from there to the end: real and realistic errors have
/// 0.7 to 0.9. Of white errors (0.3) a frame says much that averages do not; after one step their joints are 0.6 to 1.4 % farther off.
const SLOW: f64 = 0.5;

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

#[cfg(test)]
mod tests {
    use super::super::terms::border_priors::BetaInformation;
    use super::super::test_fixtures::{Surroundings, camera_in_front, seen};
    use super::*;
    use nalgebra::SMatrix;

    /// Averaged frames led limbs of runners who come into sight of one camera to the wrong side in depth.
    #[test]
    fn tracks_with_a_single_camera_are_not_averaged() {
        let surroundings = Surroundings::new();
        let shown = |alone: Range<usize>| {
            let frame = |t: usize| (0..if alone.contains(&t) { 1 } else { 2 }).map(|camera| seen(4, camera)).collect();
            let cameras = vec![camera_in_front(0.0), camera_in_front(1.2)];
            Observations { cameras, points: vec![Vec::new(); 120], pixels: (0..120).map(frame).collect() }
        };
        let averages = |alone| averages(&surroundings.context(), &shown(alone));
        assert!(averages(0..0) && averages(50..55) && !averages(0..30));
    }

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
