//! Damped Gauss-Newton over one person's motion.

use super::context::FitContext;
use super::motion_problem::MotionProblem;
use super::terms::border_priors::BetaInformation;
use super::terms::unknowns::MotionState;
use crate::body::anthropometry::N_BETAS;
use crate::optim::block_banded::BlockBanded;
use crate::progress::Canceled;

/// A person's motion after a minimisation, with statistics.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FittedMotion {
    pub state: MotionState,
    /// Before and after the last pass, summed over windows.
    pub cost_before: f64,
    pub cost_after: f64,
    /// Largest number of iterations of a window.
    pub iterations: usize,
    pub converged: bool,
    pub median_reprojection_px: Option<f64>,
    /// Second derivatives of the cost by the betas where these were unknowns, the poses following; as of the last step.
    pub beta_information: Option<BetaInformation>,
}

impl FittedMotion {
    /// A state before any minimisation.
    pub(super) fn initial(state: MotionState) -> Self {
        let (cost_before, cost_after, iterations, converged) = (0.0, 0.0, 0, true);
        let (median_reprojection_px, beta_information) = (None, None);
        Self { state, cost_before, cost_after, iterations, converged, median_reprojection_px, beta_information }
    }
}

/// Dampings tried before a state counts as the minimum: up to 1e3 and beyond.
const MAX_TRIALS: usize = 8;

/// When a minimisation ends.
#[derive(Debug, Clone, Copy)]
pub(super) struct Budget {
    /// Most accepted steps.
    pub max_iterations: usize,
    /// A step that lowers the cost by less than this share is the last.
    pub min_decrease: f64,
    /// First damping of the diagonal.
    pub damping: f64,
}

/// First damping of a fit that starts from a rough motion.
pub(super) const DAMPING_FROM_ROUGH: f64 = 1e-4;

/// First damping of a fit that starts from a fitted motion. What damping holds back are the directions that keypoints hardly show,
/// such as how a bend of the trunk is shared among the joints of the spine: with 1e-4 of the diagonal these were still 1 to 3
/// degrees a step from the minimum after four steps, with this 0.3 after three.
pub(super) const DAMPING_FROM_FIT: f64 = 1e-6;

/// Lowers the cost of `problem` from `start`, in the memory of `system`.
pub(super) fn minimised(
    context: &FitContext,
    problem: &MotionProblem,
    start: MotionState,
    Budget { max_iterations, min_decrease, damping }: Budget,
    system: &mut BlockBanded,
) -> Result<FittedMotion, Canceled> {
    let mut state = start;
    let cost_before = problem.cost(&state);
    let (mut cost, mut damping, mut iterations, mut converged) = (cost_before, damping, 0, false);
    let mut beta_information = None;
    while iterations < max_iterations && !converged {
        context.progress.check()?;
        iterations += 1;
        let mut is_better = false;
        for _ in 0..MAX_TRIALS {
            // The solution takes the system's place.
            let eliminated = problem.eliminate(&state, damping, system);
            if let Some(step) = eliminated.and_then(|()| system.solved(damping)) {
                let moved = problem.moved(&state, &step);
                let moved_cost = problem.cost(&moved);
                if moved_cost < cost {
                    converged = cost - moved_cost < min_decrease * cost;
                    (state, cost, damping, is_better) = (moved, moved_cost, damping * 0.1, true);
                    beta_information = information(problem, system);
                    break;
                }
            }
            damping = (damping * 20.0).max(1e-6);
        }
        converged |= !is_better;
    }
    let (cost_after, median_reprojection_px) = (cost, None);
    Ok(FittedMotion { state, cost_before, cost_after, iterations, converged, median_reprojection_px, beta_information })
}

/// What an eliminated system says of the betas, if these are all of its border.
fn information(problem: &MotionProblem, system: &BlockBanded) -> Option<BetaInformation> {
    let border = system.border_information();
    let has_betas_alone = problem.unknowns.border.betas() == (0..border.nrows()) && border.nrows() == N_BETAS;
    has_betas_alone.then(|| border.fixed_view::<N_BETAS, N_BETAS>(0, 0).into_owned())
}
