//! Levenberg-Marquardt for a handful of unknowns, all on the stack: the damping loop of the robust estimators.

use nalgebra::{SMatrix, SVector};

/// A robust cost and its Gauss-Newton model about one state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QuadraticModel<const N: usize> {
    /// Robust cost of the state: the sum of `rho`.
    pub cost: f64,
    /// Gradient of half the cost: `sum w J^T r`.
    pub gradient: SVector<f64, N>,
    /// `sum w J^T J`, positive semi-definite.
    pub hessian: SMatrix<f64, N, N>,
}

impl<const N: usize> QuadraticModel<N> {
    /// The model without residuals.
    pub fn zeros() -> Self {
        Self { cost: 0.0, gradient: SVector::zeros(), hessian: SMatrix::zeros() }
    }

    /// Adds one residual with its derivative, its weight and its cost.
    pub fn add(&mut self, residual: f64, jacobian: &SVector<f64, N>, weight: f64, cost: f64) {
        self.cost += cost;
        self.gradient += jacobian * (weight * residual);
        self.hessian += jacobian * jacobian.transpose() * weight;
    }
}

/// The descent ends with a step whose predicted decrease is below this share of the cost. With n observations that is some
/// `sqrt(n) * 1e-4` standard deviations of the unknowns: far below the noise, in any unit.
const MIN_PREDICTED_DECREASE: f64 = 1e-8;

/// First damping, as a share of the diagonal: nearly Gauss-Newton, since all initial states are close to the minimum.
const FIRST_DAMPING: f64 = 1e-4;

/// Minimises the cost from `start` with at most `iterations` linearisations; the cost never rises.
///
/// `linearize` returns `None` for inadmissible states; `retract` moves a state by a tangent step.
pub fn descend<State: Copy, const N: usize>(
    start: State,
    iterations: usize,
    linearize: impl Fn(&State) -> Option<QuadraticModel<N>>,
    retract: impl Fn(&State, &SVector<f64, N>) -> State,
) -> State {
    let mut state = start;
    let Some(mut model) = linearize(&state) else {
        return start;
    };
    let mut damping = FIRST_DAMPING;
    for _ in 0..iterations {
        let mut damped = model.hessian;
        // The floor keeps unobserved directions solvable: their gradient is zero and they do not move.
        (0..N).for_each(|i| damped[(i, i)] += damping * damped[(i, i)] + f64::MIN_POSITIVE);
        let Some(factor) = damped.cholesky() else {
            damping = (damping * 10.0).max(FIRST_DAMPING);
            continue;
        };
        let step = -factor.solve(&model.gradient);
        let predicted_decrease = -step.dot(&model.gradient);
        let candidate = retract(&state, &step);
        match linearize(&candidate) {
            Some(better) if better.cost < model.cost => {
                (state, model) = (candidate, better);
                damping *= 0.1;
            }
            _ => damping *= 10.0,
        }
        if predicted_decrease <= MIN_PREDICTED_DECREASE * model.cost {
            break;
        }
    }
    state
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    /// Rosenbrock's valley, whose minimum is (1, 1).
    fn valley(x: &Vector2<f64>) -> Option<QuadraticModel<2>> {
        let mut model = QuadraticModel::zeros();
        let (first, second) = (1.0 - x.x, 10.0 * (x.y - x.x * x.x));
        model.add(first, &Vector2::new(-1.0, 0.0), 1.0, first * first);
        model.add(second, &Vector2::new(-20.0 * x.x, 10.0), 1.0, second * second);
        Some(model)
    }

    #[test]
    fn reaches_the_minimum_of_a_curved_valley() {
        let end = descend(Vector2::new(-1.2, 1.0), 100, valley, |x, step| x + step);
        assert!((end - Vector2::new(1.0, 1.0)).norm() < 1e-8, "{end}");
    }

    #[test]
    fn returns_an_inadmissible_or_unobserved_start() {
        let start = Vector2::new(3.0, 4.0);
        assert_eq!(descend(start, 10, |_: &Vector2<f64>| None::<QuadraticModel<2>>, |x, s| x + s), start);
        assert_eq!(descend(start, 10, |_: &Vector2<f64>| Some(QuadraticModel::<2>::zeros()), |x, s| x + s), start);
    }
}
