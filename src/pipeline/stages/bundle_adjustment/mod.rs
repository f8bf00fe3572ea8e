//! Bundle adjustment: cameras and points together, without a body model.
//!
//! Minimises over camera poses, points and bone lengths
//!
//! `sum rho(|pixel_from_world(X) - pixel| / sigma_px) + sum rho(ln(|Xa - Xb| / L) / sigma_bone)`
//!
//! with the Geman-McClure rho, whose scale falls step by step ([`GraduatedScale`](crate::optim::robust::GraduatedScale)),
//! by Levenberg-Marquardt on the exact Schur complement: every keyframe is a small local system, cameras and bone lengths
//! are the border.
//!
//! Why bone lengths are unknowns of the border and not robust means taken between iterations: on the synthetic scene
//! of the tests the border converges in some 28 iterations, while alternation is a third above that cost after 50.

mod covariance;
mod gauge;
pub mod input;
mod problem;
mod readout;
#[cfg(test)]
mod tests;
mod variables;

use crate::optim::levenberg_marquardt::{self, LeastSquares, Outcome, Stopping};
use crate::optim::robust::median;
use crate::pipeline::calibration::{Adjusted, AdjustedCamera};
use crate::progress::{Canceled, Progress};
use crate::session::reconstruction::StageReport;
use covariance::{Uncertainties, camera_uncertainties};
use input::{AdjustmentConfig, AdjustmentInput};
use problem::Problem;
use variables::State;

/// The first robust scale is at most this many median residuals, so that outliers do not disturb a good start.
const START_MEDIANS: f64 = 4.0;

/// Adjusts cameras, points and bone lengths to the observations.
///
/// Every input is accepted: data that are not finite or whose index is out of range are ignored, unknowns with too few
/// observations keep their start, and a solver that does not converge is reported (`termination`). Work and memory are
/// linear in the number of keyframes; the result does not depend on the number of threads.
///
/// Known limits: one minimum is found, the nearest on the graduated path; groups of cameras that share no point keep
/// the relative pose of the start and have no uncertainty.
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
    let Uncertainties { cameras: uncertainties, focal } = match config.uncertainty_block_frames {
        Some(frames) => camera_uncertainties(&problem, &outcome.state, frames),
        None => Uncertainties { cameras: vec![None; input.cameras.len()], focal: None },
    };
    progress.check()?;

    let report = report(&problem, &outcome, cost_before);
    let observed = problem.observed_views(&outcome.state);
    let cameras = input
        .cameras
        .iter()
        .zip(&outcome.state.cameras)
        .zip(observed.into_iter().zip(uncertainties))
        .map(|((given, solved), (is_observed, uncertainty))| AdjustedCamera {
            camera_from_world: solved.as_ref().map(|c| c.camera_from_world).or(*given),
            focal_factor: solved.as_ref().map_or(1.0, |c| c.log_focal.exp()),
            delay: solved.as_ref().map_or(0.0, |c| c.delay),
            drift: solved.as_ref().map_or(0.0, |c| c.drift),
            radial: solved.as_ref().map_or(0.0, |c| c.radial),
            is_observed,
            uncertainty,
        })
        .collect();
    let points = problem.points_by_keypoint(&input.keyframes, &outcome.state);
    let bone_lengths = problem.bone_lengths(&outcome.state);
    Ok((Adjusted { cameras, points, bone_lengths, focal }, report))
}

/// Minimises at each robust scale in turn.
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
        progress.report(step as f64 / scales.len() as f64, format!("adjusting cameras and points at {scale:.1} sigma"));
        // A thousandth is enough here: the next scale moves the minimum by more.
        let stopping = Stopping { max_iterations: config.iterations_per_scale, relative_decrease: 1e-3 };
        let outcome = levenberg_marquardt::minimize(problem, state, &stopping, progress)?;
        iterations += outcome.iterations;
        state = outcome.state;
    }
    problem.robust_scale = last;
    let stopping = Stopping { max_iterations: config.final_iterations, relative_decrease: config.relative_decrease };
    let outcome = levenberg_marquardt::minimize(problem, state, &stopping, progress)?;
    Ok(Outcome { iterations: iterations + outcome.iterations, ..outcome })
}

fn report(problem: &Problem, outcome: &Outcome<State>, cost_before: f64) -> StageReport {
    let misfits: Vec<_> = problem.misfits(&outcome.state).collect();
    let n_explained = misfits.iter().filter(|m| m.sigmas <= problem.robust_scale).count();
    let median_px = median(&mut misfits.iter().map(|m| m.distance_px).filter(|d| d.is_finite()).collect::<Vec<_>>());
    let metrics = [
        ("observations", misfits.len() as f64),
        ("border_unknowns", problem.layout.n_border as f64),
        ("explained_observations", n_explained as f64),
    ];
    let metrics = metrics.into_iter().chain(median_px.map(|median| ("median_reprojection_px", median)));
    StageReport {
        cost_before: Some(cost_before),
        cost_after: Some(outcome.cost_after),
        ..StageReport::new("bundle_adjustment", outcome.iterations, outcome.termination.name(), metrics)
    }
}
