//! Damped Gauss-Newton over one person's motion, whole or window by window.

use super::BodyFitConfig;
use super::evidence::Evidence;
use super::initial_motion::initial_motion;
use super::motion_problem::{DataTerm, MotionProblem, MotionState, Shape};
use crate::body::BodyModel;
use crate::body::kinematics::{landmark_position, posed};
use crate::optim::robust::{MEDIAN_LENGTH_IN_PLANE, median};
use crate::progress::{Canceled, Progress};
use rayon::prelude::*;
use std::ops::Range;

/// One person's fit and how it went.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FittedMotion {
    pub state: MotionState,
    /// Of the last stage, summed over windows.
    pub cost_before: f64,
    pub cost_after: f64,
    /// The most that one window took.
    pub iterations: usize,
    pub converged: bool,
    pub median_reprojection_px: Option<f64>,
}

impl FittedMotion {
    pub(super) fn unmoved(state: MotionState) -> Self {
        let (cost_before, cost_after, iterations, converged, median_reprojection_px) = (0.0, 0.0, 0, true, None);
        Self { state, cost_before, cost_after, iterations, converged, median_reprojection_px }
    }
}

/// One person after the first fit of the window that tells most about the shape.
pub(super) struct StartedMotion {
    /// The whole track: that window and its halo as fitted, closed form elsewhere.
    pub start: MotionState,
    /// The most telling window.
    pub window: Range<usize>,
    /// The fit over that window.
    pub fitted: FittedMotion,
}

/// Starts one person and fits the window with most evidence, shape free; `None` when closed form finds no start.
pub(super) fn start_motion(stages: &Stages, evidence: &Evidence) -> Result<Option<StartedMotion>, Canceled> {
    let Some(mut start) = initial_motion(stages.model, evidence) else { return Ok(None) };
    let windows = windows(start.poses.len(), stages.config.window_frames.max(3));
    let Some(window) = windows.into_iter().max_by_key(|w| (n_pixels(evidence, w), std::cmp::Reverse(w.start))) else {
        return Ok(None);
    };
    let fitted = stages.fit_window(evidence, &start, &window, Shape::Free, &[Pass::Points, Pass::Seen])?;
    start.betas = fitted.whole.state.betas;
    start.poses[fitted.seen.clone()].copy_from_slice(&fitted.whole.state.poses);
    Ok(Some(StartedMotion { start, fitted: fitted.own(&window), window }))
}

/// Fits the whole track: the most telling window anew where the model has changed or the motion prior is yet to come, from
/// where it stands; then all others with its shape.
pub(super) fn finish_motion(
    stages: &Stages,
    evidence: &Evidence,
    started: StartedMotion,
    has_changed: bool,
) -> Result<FittedMotion, Canceled> {
    let StartedMotion { start, window, mut fitted } = started;
    let mut first_iterations = 0;
    if has_changed || stages.has_prior_to_come() {
        first_iterations = fitted.iterations;
        fitted = stages.fit_window(evidence, &start, &window, Shape::Free, &[Pass::All])?.own(&window);
    }
    let windows = windows(start.poses.len(), stages.config.window_frames.max(3));
    if windows.len() > 1 {
        let shaped = MotionState { betas: fitted.state.betas, ..start };
        let passes: &[Pass] = match stages.has_prior_to_come() {
            true => &[Pass::Points, Pass::Seen, Pass::All],
            false => &[Pass::Points, Pass::All],
        };
        let fit = |w: &Range<usize>| match *w == window {
            true => Ok(fitted.clone()),
            false => Ok(stages.fit_window(evidence, &shaped, w, Shape::Held, passes)?.own(w)),
        };
        fitted = joined(windows.par_iter().map(fit).collect::<Result<_, Canceled>>()?);
    }
    fitted.iterations += first_iterations;
    let share_and_px = residuals(stages.model, evidence, &fitted.state);
    fitted.median_reprojection_px = median(&mut share_and_px.into_iter().map(|r| r.distance_px).collect::<Vec<_>>());
    Ok(fitted)
}

/// What a fit goes by, from a rough start to the end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Pass {
    /// Triangulated points, since a fit from closed form straight to pixels gets stuck.
    Points,
    /// Pixels, and no more than the first fit is to know ([`Stages::as_seen`]).
    Seen,
    /// Pixels and all that is known.
    All,
}

/// The fit of a window and its halo.
struct FittedWindow {
    whole: FittedMotion,
    /// The frames fitted.
    seen: Range<usize>,
}

impl FittedWindow {
    /// The window without its halo.
    fn own(mut self, window: &Range<usize>) -> FittedMotion {
        let own = window.start - self.seen.start..window.end - self.seen.start;
        self.whole.state.poses = self.whole.state.poses[own].to_vec();
        self.whole
    }
}

/// Runs of at most `length` frames, as equal as can be.
fn windows(n_frames: usize, length: usize) -> Vec<Range<usize>> {
    let count = n_frames.div_ceil(length);
    (0..count).map(|i| i * n_frames / count..(i + 1) * n_frames / count).collect()
}

fn n_pixels(evidence: &Evidence, window: &Range<usize>) -> usize {
    window.clone().map(|t| evidence.pixels[t].len() + evidence.points[t].len()).sum()
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

/// What all windows share.
pub(super) struct Stages<'a> {
    pub model: &'a BodyModel,
    pub config: &'a BodyFitConfig,
    /// Of fits from a rough start.
    pub as_seen: &'a BodyFitConfig,
    /// s.
    pub frame_interval: f64,
    pub progress: &'a Progress,
}

impl Stages<'_> {
    fn has_prior_to_come(&self) -> bool {
        self.config.motion_prior && !self.as_seen.motion_prior
    }

    /// Pass after pass over a window and its halo; points alone where there are no pixels.
    fn fit_window(
        &self,
        evidence: &Evidence,
        start: &MotionState,
        window: &Range<usize>,
        shape: Shape,
        passes: &[Pass],
    ) -> Result<FittedWindow, Canceled> {
        let halo = self.config.halo_frames;
        let seen = window.start.saturating_sub(halo)..(window.end + halo).min(start.poses.len());
        let evidence = evidence.slice(seen.clone());
        let state = MotionState { betas: start.betas, poses: start.poses[seen.clone()].to_vec() };
        let has_pixels = evidence.pixels.iter().any(|frame| !frame.is_empty());
        let [on_points, on_pixels] = self.config.max_iterations;
        let mut whole = FittedMotion::unmoved(state);
        for pass in if has_pixels { passes } else { &[Pass::Points] } {
            let (data, most) = match pass {
                Pass::Points => (DataTerm::Points { sigma: self.config.point_sigma }, on_points),
                _ => (DataTerm::Pixels { share: self.pixel_share(&evidence, &whole.state) }, on_pixels),
            };
            let config = if *pass == Pass::All { self.config } else { self.as_seen };
            let problem = MotionProblem::new(self.model, &evidence, config, data, shape, self.frame_interval);
            let problem = if *pass == Pass::Points { problem } else { problem.paced_by(&whole.state) };
            let iterations = whole.iterations;
            whole = self.minimised(&problem, whole.state, most)?;
            whole.iterations += iterations;
        }
        Ok(FittedWindow { whole, seen })
    }

    /// The detector's standard deviation per axis as a share of apparent size, from the median residual (that of a normal
    /// distribution in the plane has a known multiple of sigma), enlarged by sqrt(n / (n - p)) since n equations that settle p
    /// unknowns leave less than their errors.
    pub(super) fn pixel_share(&self, evidence: &Evidence, state: &MotionState) -> f64 {
        let mut shares: Vec<f64> = residuals(self.model, evidence, state).into_iter().map(|r| r.share).collect();
        let [low, high] = self.config.pixel_share;
        let n = 2.0 * shares.len() as f64 / state.poses.len().max(1) as f64;
        let freedom = (n / (n - self.config.unknowns_per_frame).max(MIN_FREEDOM * n)).sqrt();
        median(&mut shares).map_or(high, |m| (freedom * m / MEDIAN_LENGTH_IN_PLANE).clamp(low, high))
    }

    pub(super) fn minimised(
        &self,
        problem: &MotionProblem,
        start: MotionState,
        max_iterations: usize,
    ) -> Result<FittedMotion, Canceled> {
        let mut state = start;
        let cost_before = problem.cost(&state);
        let (mut cost, mut damping, mut iterations, mut converged) = (cost_before, 1e-4, 0, false);
        while iterations < max_iterations && !converged {
            self.progress.check()?;
            iterations += 1;
            let (_, system) = problem.linearised(&state);
            let mut is_better = false;
            for _ in 0..MAX_TRIALS {
                if let Some(step) = system.solve(damping) {
                    let moved = problem.moved(&state, &step);
                    let moved_cost = problem.cost(&moved);
                    if moved_cost < cost {
                        converged = cost - moved_cost < self.config.min_decrease * cost;
                        (state, cost, damping, is_better) = (moved, moved_cost, damping * 0.1, true);
                        break;
                    }
                }
                damping = (damping * 20.0).max(1e-6);
            }
            converged |= !is_better;
        }
        let (cost_after, median_reprojection_px) = (cost, None);
        Ok(FittedMotion { state, cost_before, cost_after, iterations, converged, median_reprojection_px })
    }
}

/// Share of the equations that is left to tell errors from, at least.
const MIN_FREEDOM: f64 = 0.25;

/// Dampings tried before a state counts as the best that can be had: 1e-4 to 1e3 and beyond.
const MAX_TRIALS: usize = 6;

/// Distance of one detected pixel from its landmark's projection.
struct PixelResidual {
    distance_px: f64,
    /// In units of [`super::evidence::PixelEvidence::scale_px`].
    share: f64,
}

fn residuals(model: &BodyModel, evidence: &Evidence, state: &MotionState) -> Vec<PixelResidual> {
    let body = model.shaped(&state.betas);
    let mut residuals = Vec::new();
    for (pixels, pose) in evidence.pixels.iter().zip(&state.poses) {
        let skeleton = posed(&body, pose);
        for pixel in pixels {
            let camera = &evidence.cameras[pixel.camera];
            let position = landmark_position(model, &body, &skeleton, pixel.landmark);
            let in_camera = camera.camera_from_world.transform(&position);
            if let Some(projected) = camera.intrinsics.pixel_from_camera(&in_camera) {
                let distance_px = (projected - pixel.pixel).norm();
                residuals.push(PixelResidual { distance_px, share: distance_px / pixel.scale_px });
            }
        }
    }
    residuals
}
