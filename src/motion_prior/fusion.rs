//! Fusion of observed features with the network's guess: a smoother with learned confidence weights.
//!
//! For each joint `x = argmin sum w_t (x_t - y_t)^2 + v_t (x_t - p_t)^2 + |x_t - 2 x_(t-1) + x_(t-2)|^2`, y: the observed
//! features, p: the network's guess, a correction to straight lines; the network outputs both confidence weights, w (zero
//! where the joint is unseen) and v, for every frame. A large w leaves a clean take unchanged, a small w smooths, v alone
//! completes; where both are small a cubic interpolates.

use super::chart::{LATENT_JOINTS, N_FEATURES};
use super::pentadiagonal::{Factored, Pentadiagonal};

/// Network outputs of a frame: log w, log v, guess.
pub(crate) const N_FUSION: usize = 2 * N_LATENT_JOINTS + N_FEATURES;

const N_LATENT_JOINTS: usize = LATENT_JOINTS.len();
const SECOND_DIFFERENCE: [f64; 3] = [1.0, -2.0, 1.0];
/// Weight of the mean, which determines joints whose confidence weights are both near zero.
const TRACE: f64 = 1e-6;
/// `log w = 4 o + 4`: an untrained network reproduces its input; `log v = 4 o - 6.5`: and interpolates gaps of less than
/// half a second by cubics, longer ones linearly.
const WEIGHT_GAIN: f64 = 4.0;
const SEEN_START: f64 = 4.0;
const GUESS_START: f64 = -6.5;
const SEEN_RANGE: [f64; 2] = [-8.0, 10.0];
const GUESS_RANGE: [f64; 2] = [-14.0, 8.0];

/// Input of the fusion of one clip, T frames.
pub(crate) struct FusionInput<'a> {
    /// Observed features less the mean, `[T, 57]`; arbitrary where unseen.
    pub(crate) observed: &'a [f32],
    /// Linear interpolation of the seen frames less the mean, `[T, 57]`; guesses are corrections to it.
    pub(crate) straight: &'a [f32],
    /// Whether each joint is seen, `[T, 19]`.
    pub(crate) seen: &'a [bool],
    /// Unit of the guesses, `[57]`.
    pub(crate) spread: &'a [f32; N_FEATURES],
    /// Factors applied to the network's outputs.
    pub(crate) blending: BlendingFactors,
}

/// Fused features and what the backward pass needs.
pub(crate) struct Fusion {
    /// Fused features less the mean, `[T, 57]`.
    pub(crate) features: Vec<f32>,
    /// w and v, joint by joint.
    weights: Vec<[f64; 2]>,
    factors: Vec<Factored>,
}

fn weight(output: f32, start: f64, [low, high]: [f64; 2]) -> f64 {
    (WEIGHT_GAIN * f64::from(output) + start).clamp(low, high).exp()
}

/// Factors applied to the network's outputs: what it learnt from fifty minutes of motion generalises imperfectly to other
/// people. All figures below are for the held out training subjects.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BlendingFactors {
    /// Factor of the guess, as a correction to straight lines.
    pub(crate) guess_share: f32,
    /// Factor of the weight w of seen joints.
    pub(crate) seen_weight: f64,
    /// Factor of the weight v of guesses of seen joints.
    pub(crate) seen_guess_weight: f64,
    /// Factor of the decoder's residual.
    pub(crate) residual_share: f32,
}

impl BlendingFactors {
    /// The outputs unchanged, for training.
    pub(crate) const UNCHANGED: Self =
        Self { guess_share: 1.0, seen_weight: 1.0, seen_guess_weight: 1.0, residual_share: 1.0 };

    /// The factors for use after training.
    pub(crate) const SHIPPED: Self = Self {
        // A limb unseen for 60 frames: error 140 mm with 0.4, 134 mm with 0.7, 128 mm with 1; in a second training 0.7 was the
        // best (138 mm, with 1 142 mm), hence the cautious value.
        guess_share: 0.7,
        // Minimal error implies too little motion. With twice the weight, noisy joints move with 0.86 of the true acceleration
        // instead of 0.65, for 0.9 mm more error; with 2.5 times the error exceeds that of the best smoother.
        seen_weight: 2.0,
        // The linear code describes head rotations poorly: in training the guess of a seen head is unconstrained and serves to
        // change the rest of z. Near half a turn it jumps: one take at 25 and 30 Hz differed by 4 mm; without these guesses
        // by 1 mm, and nothing else changes.
        seen_guess_weight: 0.0,
        // Error of whole takes 1.74 mm, of clips of 8 frames 2.15 mm; with factor 1 1.81 mm and 2.80 mm.
        residual_share: 0.5,
    };

    /// Factors of w and v.
    fn factors(&self, seen: bool) -> [f64; 2] {
        if seen { [self.seen_weight, self.seen_guess_weight] } else { [0.0, 1.0] }
    }
}

/// Gradient to the output; zero where the weight is clamped at an end of its range.
fn weight_backward(output: f32, start: f64, [low, high]: [f64; 2], d_weight: f64) -> f32 {
    let log = WEIGHT_GAIN * f64::from(output) + start;
    if log < low || log > high { 0.0 } else { (WEIGHT_GAIN * log.exp() * d_weight) as f32 }
}

/// `head`: `[T, stride]`, its first [`N_FUSION`] columns are read.
pub(crate) fn fuse(input: &FusionInput, head: &[f32], stride: usize) -> Fusion {
    let n_frames = input.seen.len() / N_LATENT_JOINTS;
    let mut fusion = Fusion {
        features: vec![0.0; input.observed.len()],
        weights: Vec::with_capacity(N_LATENT_JOINTS * n_frames),
        factors: Vec::with_capacity(N_LATENT_JOINTS),
    };
    let mut path = Vec::new();
    for joint in 0..N_LATENT_JOINTS {
        let weights: Vec<[f64; 2]> = (0..n_frames)
            .map(|t| {
                let row = &head[t * stride..];
                let [by_w, by_v] = input.blending.factors(input.seen[t * N_LATENT_JOINTS + joint]);
                let w = by_w * weight(row[joint], SEEN_START, SEEN_RANGE);
                [w, by_v * weight(row[N_LATENT_JOINTS + joint], GUESS_START, GUESS_RANGE)]
            })
            .collect();
        let mut system = Pentadiagonal::diagonal(weights.iter().map(|[w, v]| w + v + TRACE));
        (2..n_frames).for_each(|t| system.add_innovation(t, &SECOND_DIFFERENCE, 1.0));
        let factors = system.factored();
        for column in 3 * joint..3 * joint + 3 {
            path.clear();
            path.extend(weights.iter().enumerate().map(|(t, [w, v])| {
                w * f64::from(input.observed[t * N_FEATURES + column]) + v * guess(input, head, stride, t, column)
            }));
            factors.solve(&mut path);
            path.iter().enumerate().for_each(|(t, x)| fusion.features[t * N_FEATURES + column] = *x as f32);
        }
        fusion.weights.extend(weights);
        fusion.factors.push(factors);
    }
    fusion
}

fn guess(input: &FusionInput, head: &[f32], stride: usize, t: usize, column: usize) -> f64 {
    let correction =
        input.blending.guess_share * head[t * stride + 2 * N_LATENT_JOINTS + column] * input.spread[column];
    f64::from(input.straight[t * N_FEATURES + column] + correction)
}

/// Adds the gradient to the head from that to the features. With `A x = w y + v p` and `g = A^-1 dx`:
/// `dw_t = g_t (y_t - x_t)`, `dv_t = g_t (p_t - x_t)`, `dp_t = v_t g_t`.
pub(crate) fn fuse_backward(
    input: &FusionInput,
    fusion: &Fusion,
    head: &[f32],
    stride: usize,
    d_features: &[f32],
    d_head: &mut [f32],
) {
    let n_frames = input.seen.len() / N_LATENT_JOINTS;
    let mut g = Vec::new();
    for joint in 0..N_LATENT_JOINTS {
        let weights = &fusion.weights[joint * n_frames..(joint + 1) * n_frames];
        let mut d_weights = vec![[0.0; 2]; n_frames];
        for column in 3 * joint..3 * joint + 3 {
            g.clear();
            g.extend((0..n_frames).map(|t| f64::from(d_features[t * N_FEATURES + column])));
            fusion.factors[joint].solve(&mut g);
            for (t, g) in g.iter().enumerate() {
                let x = f64::from(fusion.features[t * N_FEATURES + column]);
                d_weights[t][0] += g * (f64::from(input.observed[t * N_FEATURES + column]) - x);
                d_weights[t][1] += g * (guess(input, head, stride, t, column) - x);
                d_head[t * stride + 2 * N_LATENT_JOINTS + column] +=
                    (weights[t][1] * g) as f32 * input.blending.guess_share * input.spread[column];
            }
        }
        for (t, [dw, dv]) in d_weights.into_iter().enumerate() {
            let (seen_at, guess_at) = (t * stride + joint, t * stride + N_LATENT_JOINTS + joint);
            let [by_w, by_v] = input.blending.factors(input.seen[t * N_LATENT_JOINTS + joint]);
            d_head[seen_at] += weight_backward(head[seen_at], SEEN_START, SEEN_RANGE, by_w * dw);
            d_head[guess_at] += weight_backward(head[guess_at], GUESS_START, GUESS_RANGE, by_v * dv);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gradient_agrees_with_central_differences() {
        let n_frames = 7;
        let wave = |n: usize, step: f64| (0..n).map(|i| (i as f64 * step).sin() as f32 * 0.5).collect::<Vec<f32>>();
        let observed = wave(n_frames * N_FEATURES, 0.7);
        let seen: Vec<bool> = (0..n_frames * N_LATENT_JOINTS).map(|i| i % 3 != 0).collect();
        let spread = [0.8; N_FEATURES];
        let blending =
            BlendingFactors { guess_share: 0.8, seen_weight: 1.3, seen_guess_weight: 0.6, residual_share: 1.0 };
        let straight = wave(n_frames * N_FEATURES, 0.2);
        let input = FusionInput { observed: &observed, straight: &straight, seen: &seen, spread: &spread, blending };
        // Weights near the stiffness, so that every term matters.
        let mut head = wave(n_frames * N_FUSION, 1.9);
        head.chunks_exact_mut(N_FUSION).for_each(|row| row[N_LATENT_JOINTS..2 * N_LATENT_JOINTS].fill(1.5));
        let pull = wave(observed.len(), 0.3);
        let value = |head: &[f32]| -> f64 {
            let fusion = fuse(&input, head, N_FUSION);
            fusion.features.iter().zip(&pull).map(|(x, p)| f64::from(*x) * f64::from(*p)).sum()
        };
        let mut gradient = vec![0.0; head.len()];
        fuse_backward(&input, &fuse(&input, &head, N_FUSION), &head, N_FUSION, &pull, &mut gradient);
        for i in (0..head.len()).step_by(5) {
            let stepped = |h: f32| {
                let mut head = head.clone();
                head[i] += h;
                value(&head)
            };
            // Steps of 1e-2 in single precision: good to 1e-4 of the largest entries, which are near 1.
            let difference = (stepped(1e-2) - stepped(-1e-2)) / 2e-2;
            assert!((difference - f64::from(gradient[i])).abs() < 1e-3, "{i}: {difference} {}", gradient[i]);
        }
    }

    #[test]
    fn shipped_factors_use_guesses_for_unseen_joints_only() {
        let n_frames = 5;
        let observed = vec![0.3; n_frames * N_FEATURES];
        let spread = [0.8; N_FEATURES];
        let fused = |seen: bool, guess: f32| {
            let seen = vec![seen; n_frames * N_LATENT_JOINTS];
            let blending = BlendingFactors::SHIPPED;
            let input =
                FusionInput { observed: &observed, straight: &observed, seen: &seen, spread: &spread, blending };
            let row = [[1.0; 2 * N_LATENT_JOINTS].as_slice(), &[guess; N_FEATURES]].concat();
            fuse(&input, &row.repeat(n_frames), N_FUSION).features
        };
        assert_eq!(fused(true, 3.0), fused(true, 0.0));
        let expected = 0.3 + BlendingFactors::SHIPPED.guess_share * 3.0 * 0.8;
        // The weight of the mean is 1e-4 of a weight of e^-2.5.
        assert!(fused(false, 3.0).iter().all(|x| (x - expected).abs() < 1e-3));
    }
}
