//! Candidate paths of a take by smoothing; input of the encoder.
//!
//! Each minimises `sum w_t (x_t - y_t)^2 + lambda sum (D^k x)_t^2` for each joint (Whittaker, Proc. Edinburgh Math. Soc.
//! 41, 1923), with weight 1 where a joint is seen and 0 where it is not: with little stiffness, interpolation of the given
//! frames by cubics or straight lines, with more, a smooth path through noise. Zero phase, in linear time.

use super::chart::{LATENT_JOINTS, N_FEATURES};
use super::pentadiagonal::Pentadiagonal;

/// A smoother: order k of the difference and stiffness lambda at 30 Hz.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Smoothing {
    /// 1: constant position, 2: constant velocity.
    pub order: usize,
    /// Weight of the differences relative to one seen frame.
    pub stiffness: f64,
}

/// Stiffness of interpolation: so small that seen frames do not change.
const INTERPOLATION: f64 = 1e-3;

/// The encoder's candidates: cubics through the seen frames, three smoothers of increasing stiffness, straight lines.
pub const CANDIDATES: [Smoothing; 5] = [
    Smoothing { order: 2, stiffness: INTERPOLATION },
    Smoothing { order: 2, stiffness: 1.0 },
    Smoothing { order: 2, stiffness: 10.0 },
    Smoothing { order: 2, stiffness: 100.0 },
    Smoothing { order: 1, stiffness: INTERPOLATION },
];

/// An observed take: features `[T, 57]` and, for every frame and latent joint, whether it is seen.
#[derive(Debug, Clone, PartialEq)]
pub struct Observed {
    /// Features, `[T, 57]`; those of unseen joints are ignored.
    pub features: Vec<f32>,
    /// Whether each joint is seen, `[T, 19]`.
    pub seen: Vec<bool>,
}

impl Observed {
    /// A take whose joints are all seen.
    pub fn complete(features: Vec<f32>) -> Self {
        let n_frames = features.len() / N_FEATURES;
        Self { features, seen: vec![true; n_frames * LATENT_JOINTS.len()] }
    }

    /// Number of frames, T.
    pub fn n_frames(&self) -> usize {
        self.seen.len() / LATENT_JOINTS.len()
    }
}

/// The path of one smoothing, `[T, 57]`. A joint that is never seen is at `rest`.
pub fn smoothed(observed: &Observed, smoothing: Smoothing, rest: &[f32; N_FEATURES]) -> Vec<f32> {
    let differences = match smoothing.order {
        1 => [1.0, -1.0, 0.0],
        _ => [1.0, -2.0, 1.0],
    };
    let models = [[differences; 3]; LATENT_JOINTS.len()];
    penalised(observed, &models, smoothing, rest)
}

/// The path of a second-order autoregression, `[T, 57]`: unseen frames minimise the squared innovations.
pub fn autoregressed(observed: &Observed, coefficients: &[[f32; 2]; N_FEATURES], mean: &[f32; N_FEATURES]) -> Vec<f32> {
    let model = |i: usize| [1.0, -f64::from(coefficients[i][0]), -f64::from(coefficients[i][1])];
    let models = std::array::from_fn(|joint| std::array::from_fn(|axis| model(3 * joint + axis)));
    penalised(observed, &models, Smoothing { order: 2, stiffness: INTERPOLATION }, mean)
}

/// Innovations `e_t = c_0 x_t + c_1 x_(t-1) + c_2 x_(t-2)` of every joint and axis; the first `order` frames have none.
type Models = [[[f64; 3]; 3]; LATENT_JOINTS.len()];

fn penalised(observed: &Observed, models: &Models, smoothing: Smoothing, rest: &[f32; N_FEATURES]) -> Vec<f32> {
    let n_joints = LATENT_JOINTS.len();
    let n_frames = observed.n_frames();
    let mut paths = vec![0.0; observed.features.len()];
    let mut path = Vec::new();
    for (joint, models) in models.iter().enumerate() {
        let seen = |t: usize| observed.seen[t * n_joints + joint];
        for (axis, model) in models.iter().enumerate() {
            let column = 3 * joint + axis;
            let off = f64::from(rest[column]);
            // A tiny weight keeps joints that are never seen at rest.
            let mut system = Pentadiagonal::diagonal((0..n_frames).map(|t| if seen(t) { 1.0 } else { 1e-9 }));
            for t in smoothing.order..n_frames {
                system.add_innovation(t, &model[..=smoothing.order], smoothing.stiffness);
            }
            let value = |t: usize| f64::from(observed.features[t * N_FEATURES + column]) - off;
            path.clear();
            path.extend((0..n_frames).map(|t| if seen(t) { value(t) } else { 0.0 }));
            system.factored().solve(&mut path);
            path.iter().enumerate().for_each(|(t, x)| paths[t * N_FEATURES + column] = (x + off) as f32);
        }
    }
    paths
}

#[cfg(test)]
mod tests {
    use super::*;

    const REST: [f32; N_FEATURES] = [0.5; N_FEATURES];

    fn ramp(n: usize) -> Observed {
        Observed::complete((0..n * N_FEATURES).map(|i| (i / N_FEATURES) as f32 * 0.1).collect())
    }

    #[test]
    fn smoothing_preserves_lines_and_bridges_gaps() {
        let mut observed = ramp(40);
        for t in 10..25 {
            observed.seen[t * LATENT_JOINTS.len() + 3] = false;
            observed.features[t * N_FEATURES + 9..][..3].fill(7.0);
        }
        for smoothing in CANDIDATES {
            let path = smoothed(&observed, smoothing, &REST);
            // The stiffest first-order difference moves the ends of a line by 1e-3 of a step; single precision and the tiny
            // weight of unseen frames add as much.
            let worst = (0..40).map(|t| (path[t * N_FEATURES + 9] - 0.1 * t as f32).abs()).fold(0.0, f32::max);
            assert!(worst < 1e-3, "{smoothing:?}: {worst}");
        }
    }

    #[test]
    fn unseen_joints_rest_and_short_takes_have_paths() {
        for n in [1, 2, 3] {
            let mut observed = ramp(n);
            observed.seen.iter_mut().step_by(LATENT_JOINTS.len()).for_each(|seen| *seen = false);
            for smoothing in CANDIDATES {
                let path = smoothed(&observed, smoothing, &REST);
                assert!((0..n).all(|t| (path[t * N_FEATURES] - 0.5).abs() < 1e-6), "{n} {smoothing:?}");
            }
        }
    }

    #[test]
    fn the_autoregression_continues_its_own_motion() {
        let mut values = vec![1.0_f32, 0.9];
        for t in 2..30 {
            values.push(1.8 * values[t - 1] - 0.85 * values[t - 2]);
        }
        let mut observed = Observed::complete(values.iter().flat_map(|v| [*v; N_FEATURES]).collect());
        (10..16).for_each(|t| observed.seen[t * LATENT_JOINTS.len()..][..LATENT_JOINTS.len()].fill(false));
        let path = autoregressed(&observed, &[[1.8, -0.85]; N_FEATURES], &[0.0; N_FEATURES]);
        assert!((0..30).all(|t| (path[t * N_FEATURES] - values[t]).abs() < 1e-3));
    }
}
