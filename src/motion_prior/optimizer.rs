//! Adam with decoupled weight decay, a cosine schedule, clipped gradients, and a running mean of the parameters.

/// Moments and running mean of every parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct AdamState {
    /// Mean gradient.
    pub first: Vec<f32>,
    /// Mean squared gradient.
    pub second: Vec<f32>,
    /// Mean of the parameters over the latest steps, which has less noise than each step (Polyak and Juditsky 1992).
    pub average: Vec<f32>,
}

impl AdamState {
    /// The state before the first step; `n` parameters.
    pub fn new(n: usize) -> Self {
        Self { first: vec![0.0; n], second: vec![0.0; n], average: vec![0.0; n] }
    }
}

/// The schedule of a run.
pub(crate) struct Adam {
    steps: usize,
}

/// Highest step size; GRUs of this width diverge at four times it.
const RATE: f64 = 1.5e-3;
/// Step size at the end, as a share of the highest.
const LAST_RATE: f64 = 0.01;
/// Steps over which the step size grows to the highest.
const WARM_UP: f64 = 50.0;
const MOMENTUM: f64 = 0.9;
/// A memory of a hundred steps. With a thousand, a gradient that is zero for long and then is not (the joint limits) makes
/// several steps of three times the rate: two of five runs diverged.
const SECOND_MOMENTUM: f64 = 0.99;
const WEIGHT_DECAY: f64 = 1e-4;
/// Decay factor of the running mean; smaller at the beginning, where steps are long.
const AVERAGE_MEMORY: f64 = 0.998;
/// Norm above which the gradient is clipped.
const MAX_NORM: f64 = 1.0;

impl Adam {
    pub(crate) fn new(steps: usize) -> Self {
        Self { steps }
    }

    fn rate(&self, step: usize) -> f64 {
        let done = step as f64 / self.steps.max(1) as f64;
        let cosine = 0.5 * (1.0 + (std::f64::consts::PI * done).cos());
        RATE * ((step + 1) as f64 / WARM_UP).min(1.0) * (LAST_RATE + (1.0 - LAST_RATE) * cosine)
    }

    /// One step (Loshchilov and Hutter, ICLR 2019, Algorithm 2).
    pub(crate) fn update(&self, parameters: &mut [f32], gradient: &[f32], state: &mut AdamState, step: usize) {
        let norm = gradient.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
        let scale = (MAX_NORM / norm.max(1e-12)).min(1.0);
        let rate = self.rate(step);
        let n = (step + 1).min(1_000_000) as i32;
        let (first_share, second_share) = (1.0 - MOMENTUM.powi(n), 1.0 - SECOND_MOMENTUM.powi(n));
        let share = 1.0 - AVERAGE_MEMORY.min((step + 1) as f64 / (step + 10) as f64);
        let moments = state.first.iter_mut().zip(&mut state.second).zip(&mut state.average);
        for ((parameter, gradient), ((first, second), average)) in parameters.iter_mut().zip(gradient).zip(moments) {
            let g = f64::from(*gradient) * scale;
            let m = MOMENTUM * f64::from(*first) + (1.0 - MOMENTUM) * g;
            let v = SECOND_MOMENTUM * f64::from(*second) + (1.0 - SECOND_MOMENTUM) * g * g;
            (*first, *second) = (m as f32, v as f32);
            let p = f64::from(*parameter);
            let step = (m / first_share) / ((v / second_share).sqrt() + 1e-8) + WEIGHT_DECAY * p;
            *parameter = (p - rate * step) as f32;
            *average += (share * (f64::from(*parameter) - f64::from(*average))) as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_finds_the_minimum_of_a_stretched_bowl() {
        let adam = Adam::new(3000);
        let mut x = vec![1.0_f32, -1.0];
        let mut state = AdamState::new(2);
        for step in 0..3000 {
            let gradient = [2.0 * (x[0] - 0.3), 200.0 * (x[1] - 0.1)];
            adam.update(&mut x, &gradient, &mut state, step);
        }
        assert!((x[0] - 0.3).abs() < 1e-2 && (x[1] - 0.1).abs() < 1e-2, "{x:?}");
        assert!(x.iter().zip(&state.average).all(|(x, mean)| (x - mean).abs() < 1e-3), "{:?}", state.average);
    }
}
