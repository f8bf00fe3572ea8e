//! The Levenberg-Marquardt damping loop for problems that assemble and solve their damped system themselves.

use crate::progress::{Canceled, Progress};

/// A least-squares problem that solves its own damped system.
pub trait LeastSquares {
    /// Values of all unknowns.
    type State: Clone;

    /// Cost of a state: half the (robust) sum of squares.
    fn cost(&self, state: &Self::State) -> f64;

    /// Solves `(J^T W J + damping * diag(J^T W J)) step = -J^T W r` at `state` and applies the step.
    ///
    /// `None` where the damped system cannot be solved; the loop then tries again with more damping.
    fn step(&self, state: &Self::State, damping: f64) -> Option<Trial<Self::State>>;
}

/// The result of a step.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial<S> {
    /// The state after the step.
    pub state: S,
    /// Its cost.
    pub cost: f64,
}

/// Criteria for stopping.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stopping {
    /// Greatest number of steps solved for, including rejected ones.
    pub max_iterations: usize,
    /// The loop has converged when an accepted step lowers the cost by less than this share of it.
    pub relative_decrease: f64,
}

/// Why the loop ended. None of these is an error: the returned state has the lowest cost found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Termination {
    /// The last step lowered the cost by less than the required share.
    Converged,
    /// The limit of iterations was reached.
    MaxIterations,
    /// No step lowers the cost at any damping.
    Stalled,
}

impl Termination {
    /// The name used in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::MaxIterations => "max_iterations",
            Self::Stalled => "stalled",
        }
    }
}

/// The best state found, and statistics of the loop.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome<S> {
    /// The state of lowest cost.
    pub state: S,
    /// Number of steps solved for.
    pub iterations: usize,
    /// Cost of the initial state.
    pub cost_before: f64,
    /// Cost of `state`.
    pub cost_after: f64,
    /// Why the loop ended.
    pub termination: Termination,
}

/// First damping, relative to the diagonal: nearly a Gauss-Newton step, since initial states are rarely far from the minimum.
const INITIAL_DAMPING: f64 = 1e-4;
/// Smaller dampings do not change significant digits of the step; larger ones than `MAX_DAMPING` do not change the state.
const MIN_DAMPING: f64 = 1e-9;
const MAX_DAMPING: f64 = 1e8;
/// Factors of the damping after accepted and rejected steps; rising faster than falling saves rejected steps (as in Nielsen 1999).
const DAMPING_FALL: f64 = 0.2;
const DAMPING_RISE: f64 = 10.0;

/// Minimises the cost from `start` by damped steps, accepted where the cost does not rise (Marquardt 1963).
///
/// # Errors
/// [`Canceled`] when `progress` is canceled; checked before and after every step.
pub fn minimize<P: LeastSquares>(
    problem: &P,
    start: P::State,
    stopping: &Stopping,
    progress: &Progress,
) -> Result<Outcome<P::State>, Canceled> {
    let cost_before = problem.cost(&start);
    let (mut state, mut cost, mut damping) = (start, cost_before, INITIAL_DAMPING);
    let mut iterations = 0;
    let termination = loop {
        if iterations == stopping.max_iterations {
            break Termination::MaxIterations;
        }
        progress.check()?;
        iterations += 1;
        let trial = problem.step(&state, damping);
        // A canceled problem may have returned early with an incomplete step.
        progress.check()?;
        match trial {
            // A cost that is not a number compares false and the step is rejected.
            Some(trial) if trial.cost <= cost => {
                let decrease = cost - trial.cost;
                (state, cost) = (trial.state, trial.cost);
                damping = (damping * DAMPING_FALL).max(MIN_DAMPING);
                if decrease <= stopping.relative_decrease * cost {
                    break Termination::Converged;
                }
            }
            _ if damping >= MAX_DAMPING => break Termination::Stalled,
            _ => damping *= DAMPING_RISE,
        }
    };
    Ok(Outcome { state, iterations, cost_before, cost_after: cost, termination })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use std::sync::atomic::AtomicBool;

    /// Rosenbrock's valley as residuals (10 (y - x^2), 1 - x): the minimum is (1, 1).
    struct Rosenbrock;

    impl LeastSquares for Rosenbrock {
        type State = [f64; 2];

        fn cost(&self, [x, y]: &[f64; 2]) -> f64 {
            0.5 * ((10.0 * (y - x * x)).powi(2) + (1.0 - x).powi(2))
        }

        fn step(&self, &[x, y]: &[f64; 2], damping: f64) -> Option<Trial<[f64; 2]>> {
            let jacobian = nalgebra::Matrix2::new(-20.0 * x, 10.0, -1.0, 0.0);
            let residual = nalgebra::Vector2::new(10.0 * (y - x * x), 1.0 - x);
            let mut hessian = jacobian.transpose() * jacobian;
            hessian[(0, 0)] *= 1.0 + damping;
            hessian[(1, 1)] *= 1.0 + damping;
            let step = hessian.cholesky()?.solve(&(-jacobian.transpose() * residual));
            let state = [x + step.x, y + step.y];
            Some(Trial { state, cost: self.cost(&state) })
        }
    }

    #[test]
    fn finds_the_minimum_of_rosenbrocks_valley() {
        let stopping = Stopping { max_iterations: 100, relative_decrease: 1e-12 };
        let outcome = minimize(&Rosenbrock, [-1.2, 1.0], &stopping, &Progress::silent()).unwrap();
        assert!((outcome.state[0] - 1.0).abs() < 1e-6 && (outcome.state[1] - 1.0).abs() < 1e-6);
        assert!(outcome.cost_after < outcome.cost_before && outcome.iterations < 60);
    }

    #[test]
    fn a_set_flag_cancels_before_the_first_step() {
        let progress = Progress::new(|_| {}, Arc::new(AtomicBool::new(true)));
        let stopping = Stopping { max_iterations: 100, relative_decrease: 0.0 };
        assert_eq!(minimize(&Rosenbrock, [-1.2, 1.0], &stopping, &progress), Err(Canceled));
    }
}
