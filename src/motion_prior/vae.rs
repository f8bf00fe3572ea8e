//! The variational autoencoder over whole motions.
//!
//! | line | shape |
//! |---|---|
//! | observed features and what was seen | `[T, 57]`, `[T, 19]` |
//! | candidates, seen, roughness ([`super::encoder_input`]) | `[T, B, 323]` |
//! | encoder trunk: entry, bidirectional GRU, skip, head | `[T, B, 127]` |
//! | trusts and guess joined with what was seen ([`super::fusion`]) | `[T, 57]` |
//! | mean of z: the frozen linear code of that ([`super::basis`]); log variance from the head | `[T, B, 32]` |
//! | decoder trunk: entry, bidirectional GRU, skip, head | `[T, B, 57]` |
//! | features: the frozen linear decoder of z plus the trunk's residual | `[T, B, 57]` |
//! | rotations: `M_j exp(u_j)` ([`super::chart`]) | `[T, 19]` |
//!
//! Why not the paper's plain form (6D in and out, no frozen code): its reconstruction stays at 100 mm under a full KL
//! and 16 mm at best, and it neither completes nor denoises better than smoothing (method.md 15). Here the frozen code
//! alone reconstructs to 3 mm, so that the recurrent parts learn only what smoothing cannot know.

use super::basis::{Basis, LATENT_DIM, LinearCode};
use super::chart::N_FEATURES;
use super::encoder_input::{EncoderInput, N_ENCODER_INPUT};
use super::fusion::{Fusion, FusionInput, GUESS_SHARE, N_FUSION, fuse, fuse_backward};
use super::layers::Reader;
use super::trunk::{Trunk, TrunkShape, TrunkTape};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Widths and form of the network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VaeShape {
    /// Width of the encoder's layers.
    pub encoder_hidden: usize,
    /// Width of the decoder's layers: the decoder is what a fit evaluates, so it is the smaller one.
    pub decoder_hidden: usize,
    /// False for the per-frame variant, which knows no neighbours (the role of VPoser in the paper's ablation).
    pub recurrent: bool,
}

impl Default for VaeShape {
    fn default() -> Self {
        Self { encoder_hidden: 128, decoder_hidden: 96, recurrent: true }
    }
}

/// Numbers of the encoder's head: fusion, log variance.
const N_HEAD: usize = N_FUSION + LATENT_DIM;
/// The untrained log variance of z: a standard deviation of 0.22.
const LOG_VARIANCE_START: f32 = -3.0;
/// Log variances are held between these.
const LOG_VARIANCE_RANGE: [f32; 2] = [-10.0, 2.0];
/// Unit of the decoder's residual, in spreads of a feature: small, so that training starts at the frozen code.
const RESIDUAL_UNIT: f32 = 0.1;

impl VaeShape {
    fn encoder(&self) -> TrunkShape {
        let hidden = self.encoder_hidden;
        TrunkShape { n_in: N_ENCODER_INPUT, hidden, n_out: N_HEAD, recurrent: self.recurrent }
    }

    fn decoder(&self) -> TrunkShape {
        let hidden = self.decoder_hidden;
        TrunkShape { n_in: LATENT_DIM, hidden, n_out: N_FEATURES, recurrent: self.recurrent }
    }

    /// How many trained numbers the network has.
    pub fn n_parameters(&self) -> usize {
        self.encoder().len() + self.decoder().len()
    }

    /// Random parameters: normal with variance 1 / (2 H) but for the two heads, which start at zero.
    pub fn initial_parameters(&self, seed: u64) -> Vec<f32> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut parameters = vec![0.0; self.n_parameters()];
        let (encoder, decoder) = parameters.split_at_mut(self.encoder().len());
        for (values, shape) in [(encoder, self.encoder()), (decoder, self.decoder())] {
            let sd = (0.5 / shape.hidden as f64).sqrt();
            for value in &mut values[..shape.len_before_head()] {
                *value = (sd * rng.sample::<f64, _>(StandardNormal)) as f32;
            }
        }
        parameters
    }
}

/// The network at given parameters.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Vae {
    linear: LinearCode,
    spread: [f32; N_FEATURES],
    encoder: Trunk,
    decoder: Trunk,
}

/// The encoder's answer for B clips of T frames, `[T, B, 32]`, and what its backward pass needs.
pub(crate) struct Encoded {
    /// Mean of z.
    pub(crate) mean: Vec<f32>,
    /// Logarithm of its variance.
    pub(crate) log_variance: Vec<f32>,
    inputs: Vec<f32>,
    heads: Vec<Vec<f32>>,
    fusions: Vec<Fusion>,
    tape: TrunkTape,
}

/// The decoder's answer and what its backward pass needs.
pub(crate) struct Decoded {
    /// `[T, B, 57]`.
    pub(crate) features: Vec<f32>,
    code: Vec<f32>,
    tape: TrunkTape,
}

impl Vae {
    pub(crate) fn new(shape: VaeShape, basis: &Basis, parameters: &[f32]) -> Self {
        let mut reader = Reader::new(parameters);
        Self {
            linear: LinearCode::new(basis),
            spread: basis.spread,
            encoder: Trunk::read(&mut reader, shape.encoder()),
            decoder: Trunk::read(&mut reader, shape.decoder()),
        }
    }

    /// The encoder's head on prepared inputs `[T, B, 323]`.
    pub(crate) fn head(&self, inputs: &[f32], batch: usize) -> Vec<f32> {
        self.encoder.forward(inputs, batch).0
    }

    /// Width of [`Vae::head`].
    pub(crate) const HEAD_WIDTH: usize = N_HEAD;

    /// Mean of z `[T, 32]` and its log variance from one take's head.
    pub(crate) fn posterior(&self, input: &EncoderInput, head: &[f32]) -> [Vec<f32>; 2] {
        let fusion = fuse(&self.fusion_input(input, GUESS_SHARE), head, N_HEAD);
        let log_variance = head.chunks_exact(N_HEAD).flat_map(|row| row[N_FUSION..].iter().map(|o| log_variance(*o)));
        [self.linear.code(&self.with_mean(&fusion.features)), log_variance.collect()]
    }

    fn fusion_input<'a>(&'a self, input: &'a EncoderInput, guess_share: f32) -> FusionInput<'a> {
        FusionInput {
            observed: &input.path,
            straight: &input.straight,
            seen: &input.seen,
            spread: &self.spread,
            guess_share,
        }
    }

    fn with_mean(&self, off: &[f32]) -> Vec<f32> {
        let zero = self.linear.features(&[0.0; LATENT_DIM]);
        off.chunks_exact(N_FEATURES).flat_map(|row| row.iter().zip(&zero).map(|(o, m)| o + m)).collect()
    }

    /// Encodes clips of equal length.
    pub(crate) fn encode(&self, clips: &[EncoderInput]) -> Encoded {
        let batch = clips.len();
        let values: Vec<&[f32]> = clips.iter().map(|clip| clip.values.as_slice()).collect();
        let inputs = interleaved(&values, N_ENCODER_INPUT);
        let (head, tape) = self.encoder.forward(&inputs, batch);
        let heads = separated(&head, N_HEAD, batch);
        let fuse = |(clip, head): (&EncoderInput, &Vec<f32>)| fuse(&self.fusion_input(clip, 1.0), head, N_HEAD);
        let fusions: Vec<Fusion> = clips.par_iter().zip(&heads).map(fuse).collect();
        let fused: Vec<&[f32]> = fusions.iter().map(|fusion| fusion.features.as_slice()).collect();
        let mean = self.linear.code(&self.with_mean(&interleaved(&fused, N_FEATURES)));
        let log_variance = head.chunks_exact(N_HEAD).flat_map(|row| row[N_FUSION..].iter().map(|o| log_variance(*o)));
        Encoded { mean, log_variance: log_variance.collect(), inputs, heads, fusions, tape }
    }

    /// Adds the gradient to the parameters from those to mean and log variance.
    pub(crate) fn encode_backward(
        &self,
        encoded: &Encoded,
        clips: &[EncoderInput],
        d_mean: &[f32],
        d_log_variance: &[f32],
        gradient: &mut [f32],
    ) {
        let batch = clips.len();
        let d_fused = separated(&self.linear.code_backward(d_mean), N_FEATURES, batch);
        let d_log_variance = separated(d_log_variance, LATENT_DIM, batch);
        let d_head = |b: usize| {
            let head = &encoded.heads[b];
            let mut d_head = vec![0.0; head.len()];
            let input = self.fusion_input(&clips[b], 1.0);
            fuse_backward(&input, &encoded.fusions[b], head, N_HEAD, &d_fused[b], &mut d_head);
            for ((row, head), d) in d_head
                .chunks_exact_mut(N_HEAD)
                .zip(head.chunks_exact(N_HEAD))
                .zip(d_log_variance[b].chunks_exact(LATENT_DIM))
            {
                for ((slot, output), d) in row[N_FUSION..].iter_mut().zip(&head[N_FUSION..]).zip(d) {
                    let [low, high] = LOG_VARIANCE_RANGE;
                    *slot = if (low..=high).contains(&(output + LOG_VARIANCE_START)) { *d } else { 0.0 };
                }
            }
            d_head
        };
        let d_heads: Vec<Vec<f32>> = (0..batch).into_par_iter().map(d_head).collect();
        let d_heads: Vec<&[f32]> = d_heads.iter().map(Vec::as_slice).collect();
        let d_head = interleaved(&d_heads, N_HEAD);
        self.encoder.backward(&encoded.tape, &encoded.inputs, &d_head, batch, Some(gradient));
    }

    /// Decodes `[T, B, 32]`.
    pub(crate) fn decode(&self, code: Vec<f32>, batch: usize) -> Decoded {
        let (residual, tape) = self.decoder.forward(&code, batch);
        let mut features = self.linear.features(&code);
        for (row, residual) in features.chunks_exact_mut(N_FEATURES).zip(residual.chunks_exact(N_FEATURES)) {
            for ((x, r), spread) in row.iter_mut().zip(residual).zip(&self.spread) {
                *x += RESIDUAL_UNIT * spread * r;
            }
        }
        Decoded { features, code, tape }
    }

    /// Gradient to the code from that to the features; adds that to the parameters where a vector is given.
    pub(crate) fn decode_backward(
        &self,
        decoded: &Decoded,
        d_features: &[f32],
        batch: usize,
        gradient: Option<&mut [f32]>,
    ) -> Vec<f32> {
        let mut d_residual = d_features.to_vec();
        for row in d_residual.chunks_exact_mut(N_FEATURES) {
            row.iter_mut().zip(&self.spread).for_each(|(d, spread)| *d *= RESIDUAL_UNIT * spread);
        }
        let mut d_code = self.decoder.backward(&decoded.tape, &decoded.code, &d_residual, batch, gradient);
        let direct = self.linear.features_backward(d_features);
        d_code.iter_mut().zip(&direct).for_each(|(d, direct)| *d += direct);
        d_code
    }
}

fn log_variance(output: f32) -> f32 {
    (output + LOG_VARIANCE_START).clamp(LOG_VARIANCE_RANGE[0], LOG_VARIANCE_RANGE[1])
}

/// B clips `[T, width]` as `[T, B, width]`.
pub(crate) fn interleaved(clips: &[&[f32]], width: usize) -> Vec<f32> {
    let n_frames = clips.first().map_or(0, |clip| clip.len() / width);
    let mut together = Vec::with_capacity(clips.len() * n_frames * width);
    for t in 0..n_frames {
        clips.iter().for_each(|clip| together.extend_from_slice(&clip[t * width..(t + 1) * width]));
    }
    together
}

/// Inverse of [`interleaved`].
pub(crate) fn separated(together: &[f32], width: usize, batch: usize) -> Vec<Vec<f32>> {
    let clip = |b: usize| {
        let rows = together.chunks_exact(width).skip(b).step_by(batch.max(1));
        rows.flatten().copied().collect()
    };
    (0..batch).map(clip).collect()
}

#[cfg(test)]
mod tests {
    use super::super::chart::{Chart, LATENT_JOINTS};
    use super::super::encoder_input::encoder_input;
    use super::super::paths::Observed;
    use super::*;
    use nalgebra::Matrix3;

    fn wave(n: usize, step: f32, size: f32) -> Vec<f32> {
        (0..n).map(|i| (i as f32 * step).sin() * size).collect()
    }

    fn basis() -> Basis {
        Basis {
            chart: Chart { means: [Matrix3::identity(); LATENT_JOINTS.len()] },
            mean: [0.1; N_FEATURES],
            spread: [0.5; N_FEATURES],
            code_from_features: wave(N_FEATURES * LATENT_DIM, 0.9, 0.3),
            features_from_code: wave(N_FEATURES * LATENT_DIM, 1.1, 0.3),
            autoregression: [[1.8, -0.9]; N_FEATURES],
        }
    }

    /// The sum of all outputs times a wave, along a random direction of parameters or codes: differences in single
    /// precision are good to some 1e-2 of the slope (shorter steps
    /// round, longer ones bend: every parameter moves at once).
    #[test]
    fn both_backward_passes_agree_with_differences() {
        for recurrent in [true, false] {
            let shape = VaeShape { encoder_hidden: 7, decoder_hidden: 5, recurrent };
            let basis = basis();
            let parameters = wave(shape.n_parameters(), 1.7, 0.3);
            let mut observed: Vec<Observed> =
                [0.4, 0.7].map(|s| Observed::complete(wave(9 * N_FEATURES, s, 0.6))).to_vec();
            observed[1].seen[20..60].fill(false);
            let inputs: Vec<EncoderInput> = observed.iter().map(|o| encoder_input(&basis, o)).collect();
            let pulls = [wave(18 * LATENT_DIM, 0.31, 1.0), wave(18 * LATENT_DIM, 0.77, 1.0)];
            let pull_features = wave(18 * N_FEATURES, 0.57, 1.0);
            let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
            let value = |parameters: &[f32], code_step: f32| {
                let vae = Vae::new(shape, &basis, parameters);
                let encoded = vae.encode(&inputs);
                let code: Vec<f32> = wave(18 * LATENT_DIM, 0.3, 1.0).iter().map(|z| z + code_step).collect();
                let decoded = vae.decode(code, 2);
                dot(&encoded.mean, &pulls[0])
                    + dot(&encoded.log_variance, &pulls[1])
                    + dot(&decoded.features, &pull_features)
            };
            let vae = Vae::new(shape, &basis, &parameters);
            let mut gradient = vec![0.0; parameters.len()];
            let encoded = vae.encode(&inputs);
            vae.encode_backward(&encoded, &inputs, &pulls[0], &pulls[1], &mut gradient);
            let decoded = vae.decode(wave(18 * LATENT_DIM, 0.3, 1.0), 2);
            let d_code = vae.decode_backward(&decoded, &pull_features, 2, Some(&mut gradient));
            for direction in [wave(parameters.len(), 2.3, 1.0), wave(parameters.len(), 0.019, 1.0)] {
                let stepped = |h: f32| {
                    let moved: Vec<f32> = parameters.iter().zip(&direction).map(|(p, d)| p + h * d).collect();
                    value(&moved, 0.0)
                };
                let difference = (stepped(1e-4) - stepped(-1e-4)) / 2e-4;
                let slope = dot(&gradient, &direction);
                assert!((difference - slope).abs() < 1e-2 * slope.abs().max(1.0), "{recurrent}: {difference} {slope}");
            }
            let difference = (value(&parameters, 1e-2) - value(&parameters, -1e-2)) / 2e-2;
            let slope: f64 = d_code.iter().map(|d| f64::from(*d)).sum();
            assert!((difference - slope).abs() < 1e-3 * slope.abs().max(1.0), "{recurrent}: {difference} {slope}");
        }
    }

    #[derive(serde::Deserialize)]
    struct Reference {
        features: Vec<f64>,
        d_code: Vec<f64>,
    }

    /// What automatic differentiation says in double precision (`reference/decoder_gradient.py`), to 1e-5 of the largest
    /// entry.
    #[test]
    fn the_decoder_and_its_gradient_agree_with_automatic_differentiation() {
        let reference: Reference = serde_json::from_str(include_str!("reference/decoder_gradient.json")).unwrap();
        let numbers = |n: usize, salt: usize| -> Vec<f32> {
            (0..n).map(|i| ((i * 7919 + salt * 104_729) % 1000) as f32 / 1000.0 - 0.5).collect()
        };
        let shape = VaeShape { encoder_hidden: 1, decoder_hidden: 5, recurrent: true };
        let basis = Basis { features_from_code: numbers(LATENT_DIM * N_FEATURES, 2), ..basis() };
        let mut parameters = vec![0.0; shape.encoder().len()];
        parameters.extend(numbers(shape.decoder().len(), 1));
        let vae = Vae::new(shape, &basis, &parameters);
        let decoded = vae.decode(numbers(6 * 2 * LATENT_DIM, 3), 2);
        let d_code = vae.decode_backward(&decoded, &numbers(6 * 2 * N_FEATURES, 4), 2, None);
        for (found, expected) in [(&decoded.features, &reference.features), (&d_code, &reference.d_code)] {
            assert_eq!(found.len(), expected.len());
            let largest = expected.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
            let worst = found.iter().zip(expected).fold(0.0_f64, |m, (a, b)| m.max((f64::from(*a) - b).abs()));
            assert!(worst < 1e-5 * largest, "{worst} of {largest}");
        }
    }
}
