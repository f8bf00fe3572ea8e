//! The Levenberg-Marquardt damping loop, written once. What is solved in a step is the problem's own affair.

use crate::progress::{Canceled, Progress};

/// A least-squares problem that can be stepped.
pub trait LeastSquares {
    /// All unknowns.
    type State: Clone;

    /// Cost of a state: half the (robust) sum of squares.
    fn cost(&self, state: &Self::State) -> f64;

    /// Solves `(J^T W J + damping * diag(J^T W J)) step = -J^T W r` at `state` and applies the step.
    ///
    /// `None` where the damped system cannot be solved; it is then tried again with more damping.
    fn step(&self, state: &Self::State, damping: f64) -> Option<Trial<Self::State>>;
}

/// Where a step leads.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial<S> {
    /// The state after the step.
    pub state: S,
    /// Its cost.
    pub cost: f64,
}

/// When to stop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stopping {
    /// Steps solved for, rejected ones included.
    pub max_iterations: usize,
    /// Converged once an accepted step lowers the cost by less than this share of it.
    pub relative_decrease: f64,
}

/// Why the loop ended. None of these is an error: the state returned is the best one seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Termination {
    /// The last step hardly lowered the cost.
    Converged,
    /// The limit of iterations was reached.
    MaxIterations,
    /// No step lowers the cost, however strongly damped.
    Stalled,
}

impl Termination {
    /// One word for reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::MaxIterations => "max_iterations",
            Self::Stalled => "stalled",
        }
    }
}

/// The best state found and how it was reached.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome<S> {
    /// The state of lowest cost.
    pub state: S,
    /// Steps solved for.
    pub iterations: usize,
    /// Cost of the start.
    pub cost_before: f64,
    /// Cost of `state`.
    pub cost_after: f64,
    /// Why the loop ended.
    pub termination: Termination,
}

/// First damping, relative to the diagonal: nearly a Gauss-Newton step, as our starts are seldom far off.
const INITIAL_DAMPING: f64 = 1e-4;
/// Below this the damping changes no digit of the step that matters; above `MAX_DAMPING` steps change no digit of the state.
const MIN_DAMPING: f64 = 1e-9;
const MAX_DAMPING: f64 = 1e8;
/// Damping falls and rises by these factors; rising faster than falling saves rejected steps (Nielsen 1999 does alike).
const DAMPING_FALL: f64 = 0.2;
const DAMPING_RISE: f64 = 10.0;

/// Lowers the cost from `start`: damped steps, accepted when the cost falls (Marquardt 1963).
///
/// # Errors
/// [`Canceled`] once `progress` says so; asked before and after every step.
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
        // A canceled problem may have cut its step short: its answer must not be looked at.
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
    fn finds_the_end_of_rosenbrocks_valley() {
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
