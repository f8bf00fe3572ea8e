//! Stage 4: cameras and points together, no body yet.
//!
//! Minimises over camera poses, points and bone lengths
//!
//! `sum rho(|pixel_from_world(X) - pixel| / sigma_px) + sum rho(ln(|Xa - Xb| / L) / sigma_bone)`
//!
//! with the Geman-McClure rho, whose scale falls step by step ([`GraduatedScale`]), by Levenberg-Marquardt on the
//! exact Schur complement: every instant is a small local system, cameras and bone lengths are the border.
//!
//! Why bone lengths are unknowns of the border and not robust means taken between iterations: on the synthetic scene
//! of the tests the border converges in some 28 iterations, while alternation stands a third above that cost after 50.

mod covariance;
mod gauge;
mod problem;
mod readout;
#[cfg(test)]
mod tests;
mod variables;

use crate::geometry::{Intrinsics, Rigid};
use crate::optim::levenberg_marquardt::{self, LeastSquares, Outcome, Stopping};
use crate::optim::robust::{GraduatedScale, median};
use crate::progress::{Canceled, Progress};
use crate::session::reconstruction::{ErrorSummary, StageReport};
use nalgebra::{Matrix6, Vector2, Vector3};
use problem::{Problem, State};
use std::collections::BTreeMap;

/// One skeleton at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct Instant {
    /// Whose; instants of one person share their bone lengths.
    pub person: usize,
    /// When, in frames; only its distance to other frames matters.
    pub frame: usize,
    /// A start for every keypoint, world; `None` where there is none (such a point is not adjusted).
    pub points: Vec<Option<Vector3<f64>>>,
    /// Where the keypoints were seen. Those of unplaced views and unknown points are passed over.
    pub observations: Vec<Observation>,
}

/// One keypoint as one view saw it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Index into [`Instant::points`].
    pub keypoint: usize,
    /// Index of the view.
    pub view: usize,
    /// As detected, distorted.
    pub pixel: Vector2<f64>,
    /// Standard deviation per axis, from confidence, keypoint class and apparent size.
    pub sigma_px: f64,
    /// How the keypoint moves in the image, px per frame; zero where that is unknown, or of no interest.
    pub velocity: Vector2<f64>,
}

impl Observation {
    /// Where the keypoint was when the frame's number says, if the view's frames are `delay` frames late.
    pub(crate) fn pixel_without(&self, delay: f64) -> Vector2<f64> {
        self.pixel - self.velocity * delay
    }
}

/// Two keypoints whose distance hardly changes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bone {
    /// One end, a keypoint.
    pub a: usize,
    /// The other end.
    pub b: usize,
    /// Relative standard deviation of the length over time: detector noise and soft tissue.
    pub sigma: f64,
}

/// What may happen to the cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraFreedom {
    /// They stay; only points and bone lengths are adjusted.
    Held,
    /// All move, but for the seven freedoms that no image can tell: the best connected camera keeps its pose, and
    /// its best partner's centre keeps its distance.
    Adjusted,
}

/// The problem.
#[derive(Debug, Clone, PartialEq)]
pub struct AdjustmentInput<'a> {
    /// Per view.
    pub intrinsics: &'a [Intrinsics],
    /// `camera_from_world` per view; `None` for an unplaced one, which stays so.
    pub cameras: Vec<Option<Rigid>>,
    /// In any order; the result's is the same.
    pub instants: Vec<Instant>,
    /// The same for everybody; empty for independent points.
    pub bones: &'a [Bone],
    /// Whether poses move.
    pub camera_freedom: CameraFreedom,
    /// Whether each moving camera gets a factor on its focal lengths.
    pub refine_focal: bool,
    /// Whether each moving camera gets a delay; only differences between cameras mean anything.
    pub refine_delays: bool,
}

/// Settings of [`adjust`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdjustmentConfig {
    /// Robust scales in standard deviations.
    pub scale: GraduatedScale,
    /// Steps at every scale but the last; half-solved is enough, the next scale moves the minimum anyway.
    pub iterations_per_scale: usize,
    /// Steps at the last scale.
    pub final_iterations: usize,
    /// Share of the cost below which a gain ends the work.
    pub relative_decrease: f64,
    /// Standard deviation of the logarithm of a focal factor; where focal lengths are refined.
    pub focal_sigma: f64,
    /// Standard deviation of a delay, frames; where delays are refined.
    pub delay_sigma: f64,
    /// Length of a block of one person's frames, the unit whose errors count as independent in the cameras' uncertainty;
    /// `None`: no uncertainty is computed, which saves as much time as some ten iterations.
    pub uncertainty_block_frames: Option<usize>,
}

impl Default for AdjustmentConfig {
    fn default() -> Self {
        Self {
            // 30 sigma: a camera 5 degrees off, at 1000 px focal length and 3 px noise. 4 sigma: keeps 95 % of the
            // efficiency on Gaussian noise, and an outlier of 10 sigma has 2 % of its weight.
            scale: GraduatedScale { start: 30.0, end: 4.0, steps: 5 },
            iterations_per_scale: 5,
            final_iterations: 30,
            // 1e-6 of the cost is below 0.1 sigma of any parameter with more than 100 observations.
            relative_decrease: 1e-6,
            // Focal lengths from a lens's own data are seldom more than 5 % off.
            focal_sigma: 0.05,
            // A keypoint's path is straight for some two frames.
            delay_sigma: 2.0,
            // 2 s at 25 Hz: detector errors are correlated over some 10 frames (AR(0.9)); a block must span several.
            uncertainty_block_frames: Some(50),
        }
    }
}

/// The result.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Adjusted {
    /// Per view.
    pub cameras: Vec<AdjustedCamera>,
    /// Per instant and keypoint; a point without enough evidence keeps its start.
    pub points: Vec<Vec<Option<Vector3<f64>>>>,
    /// Per person and bone, in the unit of the world; `None` where a bone was never seen whole.
    pub bone_lengths: BTreeMap<usize, Vec<Option<f64>>>,
}

/// One camera of the result.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct AdjustedCamera {
    /// As given where the view is unplaced, held, or has too few observations to move.
    pub camera_from_world: Option<Rigid>,
    /// Factor on both focal lengths; 1 unless refined.
    pub focal_factor: f64,
    /// Frames by which its frames were taken later than their numbers say; 0 unless refined.
    pub delay: f64,
    /// How well its observations are met.
    pub fit: ViewFit,
    /// How well the pose is known; `None` where it did not move or the data do not determine it.
    pub uncertainty: Option<CameraUncertainty>,
}

/// Reprojection of one view.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct ViewFit {
    /// Observations that took part.
    pub n_observations: usize,
    /// Those nearer to their reprojection than the last robust scale.
    pub n_explained: usize,
    /// Distance of the explained ones, px.
    pub reprojection_px: Option<ErrorSummary>,
}

/// Uncertainty of a camera after a similarity alignment of all cameras (free-network gauge), scale apart.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct CameraUncertainty {
    /// Of the left increment (rho, phi), camera frame: unit of the world, rad.
    pub covariance: Matrix6<f64>,
    /// Root mean square distance of the centre from the truth, unit of the world: three axes together.
    pub sigma_position: f64,
    /// Root mean square angle of the orientation from the truth, rad.
    pub sigma_angle: f64,
    /// Standard deviation of the delay against that of the first moving camera, frames; where delays are refined.
    pub sigma_delay: Option<f64>,
    /// Standard deviation of the focal factor's logarithm; where focal lengths are refined.
    pub sigma_log_focal: Option<f64>,
}

/// The first robust scale is at most this many median residuals: a good start is not shaken by outliers.
const START_MEDIANS: f64 = 4.0;

/// Adjusts cameras, points and bone lengths to what was seen.
///
/// Every input is accepted: data that are not finite or point outside their tables are passed over, what has too
/// little evidence stays where it is, and not converging is said in the report (`termination`). Work and memory are
/// linear in the number of instants; the result does not depend on the number of threads.
///
/// Known limits: one minimum is found, the nearest on the graduated path; groups of cameras that share no point keep
/// the relative pose of the start and get no uncertainty.
///
/// # Errors
/// [`Canceled`] once `progress` says so.
pub fn adjust(
    input: &AdjustmentInput,
    config: &AdjustmentConfig,
    progress: &Progress,
) -> Result<(Adjusted, StageReport), Canceled> {
    let (mut problem, start) = problem::formulate(input, config, progress);
    let start_median = median(&mut problem.misfits(&start).map(|misfit| misfit.sigmas).collect::<Vec<_>>());
    let schedule = config.scale.starting_within(START_MEDIANS * start_median.unwrap_or(0.0));

    problem.robust_scale = config.scale.end;
    let cost_before = problem.cost(&start);
    let outcome = descend(&mut problem, start, &schedule.scales(), config, progress)?;
    let uncertainties = match config.uncertainty_block_frames {
        Some(frames) => covariance::camera_uncertainties(&problem, &outcome.state, frames),
        None => vec![None; input.cameras.len()],
    };
    progress.check()?;

    let report = report(&problem, &outcome, cost_before);
    let fits = problem.view_fits(&outcome.state);
    let cameras = input
        .cameras
        .iter()
        .zip(&outcome.state.cameras)
        .zip(fits.into_iter().zip(uncertainties))
        .map(|((given, solved), (fit, uncertainty))| AdjustedCamera {
            camera_from_world: solved.as_ref().map(|c| c.camera_from_world).or(*given),
            focal_factor: solved.as_ref().map_or(1.0, |c| c.log_focal.exp()),
            delay: solved.as_ref().map_or(0.0, |c| c.delay),
            fit,
            uncertainty,
        })
        .collect();
    let points = problem.points_by_keypoint(&input.instants, &outcome.state);
    let bone_lengths = problem.bone_lengths(&outcome.state);
    Ok((Adjusted { cameras, points, bone_lengths }, report))
}

/// Minimises at one robust scale after the other.
fn descend(
    problem: &mut Problem,
    start: State,
    scales: &[f64],
    config: &AdjustmentConfig,
    progress: &Progress,
) -> Result<Outcome<State>, Canceled> {
    let mut iterations = 0;
    let mut state = start;
    let (last, graduated) = scales.split_last().map_or((config.scale.end, &[][..]), |(l, g)| (*l, g));
    for (step, &scale) in graduated.iter().enumerate() {
        problem.robust_scale = scale;
        // A thousandth is enough here: the next scale moves the minimum by more.
        let stopping = Stopping { max_iterations: config.iterations_per_scale, relative_decrease: 1e-3 };
        let outcome = levenberg_marquardt::minimize(problem, state, &stopping, progress)?;
        iterations += outcome.iterations;
        state = outcome.state;
        progress.report(step as f64 / scales.len() as f64, format!("adjusted at {scale:.1} sigma"));
    }
    problem.robust_scale = last;
    let stopping = Stopping { max_iterations: config.final_iterations, relative_decrease: config.relative_decrease };
    let outcome = levenberg_marquardt::minimize(problem, state, &stopping, progress)?;
    Ok(Outcome { iterations: iterations + outcome.iterations, ..outcome })
}

fn report(problem: &Problem, outcome: &Outcome<State>, cost_before: f64) -> StageReport {
    let mut metrics = BTreeMap::new();
    let misfits: Vec<_> = problem.misfits(&outcome.state).collect();
    metrics.insert("observations".to_owned(), misfits.len() as f64);
    metrics.insert("border_unknowns".to_owned(), problem.layout.n_border as f64);
    let n_explained = misfits.iter().filter(|m| m.sigmas <= problem.robust_scale).count();
    metrics.insert("explained_observations".to_owned(), n_explained as f64);
    if let Some(median_px) =
        median(&mut misfits.iter().map(|m| m.distance_px).filter(|d| d.is_finite()).collect::<Vec<_>>())
    {
        metrics.insert("median_reprojection_px".to_owned(), median_px);
    }
    StageReport {
        stage: "bundle_adjustment".to_owned(),
        iterations: outcome.iterations,
        cost_before: Some(cost_before),
        cost_after: Some(outcome.cost_after),
        termination: outcome.termination.name().to_owned(),
        metrics,
    }
}
