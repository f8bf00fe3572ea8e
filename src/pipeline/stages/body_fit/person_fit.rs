//! The fit of one person's motion, whole or window by window.

use super::common_shape::with_common_shape;
use super::context::FitContext;
use super::initial_motion::initial_motion;
use super::minimisation::FittedMotion;
use super::observations::Observations;
use super::pixel_residuals::median_distance_px;
use super::terms::unknowns::{MotionState, Shape};
use super::window_fit::{FittedWindow, Pass, fit_window, stride};
use crate::body::kinematics::Pose;
use crate::pipeline::time_windows::windows;
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
///
/// A single camera leaves depth open, and steps that lower the cost spend it on the detector's errors: after the last fit joints of takes
/// of realistic noise were 7 to 11 % farther off than after the first (30 of 30 s, 32 of 10 s).
pub(super) fn finish_motion(
    context: &FitContext,
    observations: &Observations,
    started: StartedMotion,
    has_model_changed: bool,
) -> Result<FittedMotion, Canceled> {
    let StartedMotion { window, mut fitted } = started;
    let is_rough = window.len() < fitted.state.poses.len() || stride(context, observations) > 1;
    let has_several_cameras = observations.cameras.len() > 1;
    if has_several_cameras && (has_model_changed || context.has_refinement() || is_rough) {
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
    let (free, held) = (|pass| (pass, Shape::Free), |pass| (pass, Shape::Held));
    let of_first = fit_window(context, observations, &start, first, &[Pass::Points, Pass::First].map(free))?;
    let shaped = MotionState { betas: of_first.whole.state.betas, ..start };
    let fit = |w: &Range<usize>| {
        let fitted = match w == first {
            true => of_first.clone(),
            false => fit_window(context, observations, &shaped, w, &[Pass::Points, Pass::Rough].map(held))?,
        };
        context.progress.part_done();
        Ok(fitted)
    };
    let fitted = windows.par_iter().map(fit).collect::<Result<_, Canceled>>()?;
    Ok(joined(&windows, fitted, context.halo_frames()))
}

/// Fits all windows, each with a shape of its own, which then makes way for the one that all of them say together.
fn fit_last(context: &FitContext, observations: &Observations, start: MotionState) -> Result<FittedMotion, Canceled> {
    let windows = windows(start.poses.len(), context.window_frames());
    let fit = |window: &Range<usize>| {
        let with_halo = observations.slice(context.with_halo(window, start.poses.len()));
        let passes = last_passes(context, &with_halo, windows.len() == 1);
        let fitted = fit_window(context, observations, &start, window, &passes)?;
        context.progress.part_done();
        Ok(fitted)
    };
    let fits = windows.par_iter().map(fit).collect::<Result<_, Canceled>>()?;
    let fits = with_common_shape(context, observations, fits)?;
    Ok(joined(&windows, fits, context.halo_frames()))
}

/// The passes of the last fit of a window and its halo, whose `observations` these are: averaged frames, where the errors of several
/// cameras have been measured, then what is left for all. With `own_shape` these determine the betas as well; of several windows
/// those of the best one are held until all frames count: averaged ones say half as much of the bones.
fn last_passes(context: &FitContext, observations: &Observations, own_shape: bool) -> Vec<(Pass, Shape)> {
    let averaged = (Pass::Averaged, if own_shape { Shape::Free } else { Shape::Held });
    let finish = (Pass::Finish, Shape::Free);
    match context.averaged_noise.filter(|_| stride(context, observations) > 1) {
        Some(noise) if noise.typical().autocorrelation < SLOW => vec![averaged, finish, finish],
        Some(_) => vec![averaged, finish],
        None => vec![(Pass::Last, Shape::Free)],
    }
}

/// Least autocorrelation of the errors of averaged frames with which one step leads from there to the end: real and realistic errors have
/// 0.7 to 0.9. Of white errors (0.3) a frame says much that averages do not; after one step their joints are 0.6 to 1.4 % farther off.
const SLOW: f64 = 0.5;

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
    use super::super::test_fixtures::{Surroundings, detected};
    use super::*;
    use crate::body::model::Betas;
    use nalgebra::Vector3;

    /// The last fit of long takes led joints that one camera alone shows farther from where they are.
    #[test]
    fn the_first_fit_of_a_single_view_is_the_last() {
        let surroundings = Surroundings::new();
        let of_two = detected(&surroundings.model, &[Pose::rest(); 40]);
        let mut of_one = of_two.clone();
        of_one.cameras.truncate(1);
        of_one.pixels.iter_mut().for_each(|frame| frame.retain(|pixel| pixel.camera == 0));
        let moved = Pose { translation: Vector3::new(0.01, 0.0, 0.0), ..Pose::rest() };
        let first = MotionState { betas: Betas::zeros(), poses: vec![moved; 40] };
        let finished = |observations: &Observations| {
            let started = StartedMotion { fitted: FittedMotion::initial(first.clone()), window: 0..20 };
            finish_motion(&surroundings.context(), observations, started, true).unwrap().state
        };
        assert_eq!(finished(&of_one), first);
        assert_ne!(finished(&of_two), first);
    }
}
