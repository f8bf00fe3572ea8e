//! The variational autoencoder over whole motions.
//!
//! | line | shape |
//! |---|---|
//! | observed features, visibility | `[T, 57]`, `[T, 19]` |
//! | candidates on their shortest branch, seen, roughness ([`super::encoder_input`]) | `[T, B, 323]` |
//! | encoder trunk: entry, bidirectional GRU, skip, head | `[T, B, 127]` |
//! | fusion of observed features and guess ([`super::fusion`]) | `[T, 57]` |
//! | mean of z: the frozen linear code of that on its shortest branch ([`super::basis`]); log variance from the head | `[T, B, 32]` |
//! | decoder trunk: entry, bidirectional GRU, skip, head | `[T, B, 57]` |
//! | features: the frozen linear decoder of z plus the trunk's residual | `[T, B, 57]` |
//! | rotations: `M_j exp(u_j)` ([`super::chart`]) | `[T, 19]` |
//!
//! Why not the paper's plain form (two columns a rotation as input and output, no frozen code: [`VaeForm::Plain`]): with the
//! same training its reconstruction error is 38 mm, that of the frozen code alone 3 mm, and it completes and denoises worse
//! than smoothing (model card). Here the recurrent parts learn only what smoothing cannot do.

use super::basis::{Basis, LATENT_DIM, LinearCode};
use super::chart::{Chart, N_FEATURES, on_shortest_branch, on_shortest_branch_backward};
use super::encoder_input::EncoderInput;
use super::fusion::{BlendingFactors, Fusion, FusionInput, fuse, fuse_backward};
use super::layers::Reader;
use super::panels::tanh;
use super::shape::{VaeForm, VaeShape};
use super::six_d::{features_of, features_of_backward};
use super::trunk::{Trunk, TrunkTape};
use rayon::prelude::*;

/// Log variance of z before training: a standard deviation of 0.22.
const LOG_VARIANCE_START: f32 = -3.0;
/// Range to which log variances are clamped.
const LOG_VARIANCE_RANGE: [f32; 2] = [-10.0, 2.0];
/// Unit of the decoder's residual, in spreads of a feature: small, so that training starts at the frozen code.
const RESIDUAL_UNIT: f32 = 0.1;
/// The decoder's trunk gets `c tanh(z / c)`, so that poses far from the training data do not move it far from the linear
/// code. On the held out subjects the residual increased the error of clips of 8 frames (2.9 mm, 2.2 mm without it), with
/// this bound less (2.6 mm).
const CODE_RANGE: f32 = 2.0;

/// The network at given parameters.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Vae {
    shape: VaeShape,
    chart: Chart,
    linear: LinearCode,
    spread: [f32; N_FEATURES],
    encoder: Trunk,
    decoder: Trunk,
}

/// The encoder's output for B clips of T frames, `[T, B, 32]`, with the values that its backward pass needs.
pub(crate) struct Encoded {
    /// Mean of z.
    pub(crate) mean: Vec<f32>,
    /// Logarithm of its variance.
    pub(crate) log_variance: Vec<f32>,
    inputs: Vec<f32>,
    heads: Vec<Vec<f32>>,
    means: Vec<Mean>,
    tape: TrunkTape,
}

/// One clip's mean of z, `[T, 32]`, and the fusion it was coded from (none in the paper's form).
struct Mean {
    code: Vec<f32>,
    fusion: Option<Fusion>,
}

/// The decoder's output with the values that its backward pass needs.
pub(crate) struct Decoded {
    /// Features, `[T, B, 57]`.
    pub(crate) features: Vec<f32>,
    /// Input and output of the trunk.
    input: Vec<f32>,
    output: Vec<f32>,
    tape: TrunkTape,
    blending: BlendingFactors,
}

impl Vae {
    pub(crate) fn new(shape: VaeShape, basis: &Basis, parameters: &[f32]) -> Self {
        let mut reader = Reader::new(parameters);
        Self {
            shape,
            chart: basis.chart.clone(),
            linear: LinearCode::new(basis),
            spread: basis.spread,
            encoder: Trunk::read(&mut reader, shape.encoder()),
            decoder: Trunk::read(&mut reader, shape.decoder()),
        }
    }

    fn is_plain(&self) -> bool {
        self.shape.form == VaeForm::Plain
    }

    fn head_width(&self) -> usize {
        self.shape.encoder().n_out
    }

    /// The encoder's head on prepared inputs `[T, B, 323]`.
    pub(crate) fn head(&self, inputs: &[f32], batch: usize) -> Vec<f32> {
        self.encoder.forward(inputs, batch).0
    }

    /// Mean of z `[T, 32]` and its log variance from one take's head.
    pub(crate) fn posterior(&self, input: &EncoderInput, head: &[f32]) -> [Vec<f32>; 2] {
        [self.mean(input, head, BlendingFactors::SHIPPED).code, self.log_variance(head)]
    }

    fn mean(&self, input: &EncoderInput, head: &[f32], blending: BlendingFactors) -> Mean {
        let width = self.head_width();
        if self.is_plain() {
            let code = head.chunks_exact(width).flat_map(|row| row[..LATENT_DIM].to_vec()).collect();
            return Mean { code, fusion: None };
        }
        let fusion = fuse(&self.fusion_input(input, blending), head, width);
        Mean { code: self.linear.code(&on_shortest_branch(self.with_mean(&fusion.features))), fusion: Some(fusion) }
    }

    /// From the head's last columns.
    fn log_variance(&self, head: &[f32]) -> Vec<f32> {
        let [low, high] = LOG_VARIANCE_RANGE;
        let rows = head.chunks_exact(self.head_width());
        let outputs = rows.flat_map(|row| &row[row.len() - LATENT_DIM..]);
        outputs.map(|output| (output + LOG_VARIANCE_START).clamp(low, high)).collect()
    }

    fn fusion_input<'a>(&'a self, input: &'a EncoderInput, blending: BlendingFactors) -> FusionInput<'a> {
        FusionInput {
            observed: &input.path,
            straight: &input.straight,
            seen: &input.seen,
            spread: &self.spread,
            blending,
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
        let inputs = interleaved(&values, self.shape.encoder().n_in);
        let (head, tape) = self.encoder.forward(&inputs, batch);
        let heads = separated(&head, self.head_width(), batch);
        let mean = |(clip, head): (&EncoderInput, &Vec<f32>)| self.mean(clip, head, BlendingFactors::UNCHANGED);
        let means: Vec<Mean> = clips.par_iter().zip(&heads).map(mean).collect();
        let codes: Vec<&[f32]> = means.iter().map(|mean| mean.code.as_slice()).collect();
        let mean = interleaved(&codes, LATENT_DIM);
        Encoded { mean, log_variance: self.log_variance(&head), inputs, heads, means, tape }
    }

    /// Adds the gradient to the parameters, given those to mean and log variance.
    pub(crate) fn encode_backward(
        &self,
        encoded: &Encoded,
        clips: &[EncoderInput],
        d_mean: &[f32],
        d_log_variance: &[f32],
        gradient: &mut [f32],
    ) {
        let batch = clips.len();
        let d_mean = separated(d_mean, LATENT_DIM, batch);
        let d_log_variance = separated(d_log_variance, LATENT_DIM, batch);
        let d_head = |b: usize| {
            let mut d_head = vec![0.0; encoded.heads[b].len()];
            self.mean_backward(&encoded.means[b], &clips[b], &encoded.heads[b], &d_mean[b], &mut d_head);
            self.log_variance_backward(&encoded.heads[b], &d_log_variance[b], &mut d_head);
            d_head
        };
        let d_heads: Vec<Vec<f32>> = (0..batch).into_par_iter().map(d_head).collect();
        let d_heads: Vec<&[f32]> = d_heads.iter().map(Vec::as_slice).collect();
        let d_head = interleaved(&d_heads, self.head_width());
        self.encoder.backward(&encoded.tape, &encoded.inputs, &d_head, batch, Some(gradient));
    }

    fn mean_backward(&self, mean: &Mean, input: &EncoderInput, head: &[f32], d_mean: &[f32], d_head: &mut [f32]) {
        let width = self.head_width();
        if let Some(fusion) = &mean.fusion {
            let mut d_fused = self.linear.code_backward(d_mean);
            on_shortest_branch_backward(&self.with_mean(&fusion.features), &mut d_fused);
            fuse_backward(&self.fusion_input(input, BlendingFactors::UNCHANGED), fusion, head, width, &d_fused, d_head);
        } else {
            let rows = d_head.chunks_exact_mut(width).zip(d_mean.chunks_exact(LATENT_DIM));
            rows.for_each(|(row, d)| row[..LATENT_DIM].copy_from_slice(d));
        }
    }

    fn log_variance_backward(&self, head: &[f32], d_log_variance: &[f32], d_head: &mut [f32]) {
        let [low, high] = LOG_VARIANCE_RANGE;
        let width = self.head_width();
        let first = width - LATENT_DIM;
        let rows = d_head.chunks_exact_mut(width).zip(head.chunks_exact(width));
        for ((row, head), d) in rows.zip(d_log_variance.chunks_exact(LATENT_DIM)) {
            for ((slot, output), d) in row[first..].iter_mut().zip(&head[first..]).zip(d) {
                *slot = if (low..=high).contains(&(output + LOG_VARIANCE_START)) { *d } else { 0.0 };
            }
        }
    }

    /// Decodes `[T, B, 32]`.
    pub(crate) fn decode(&self, code: &[f32], batch: usize, blending: BlendingFactors) -> Decoded {
        let bounded = |z: &f32| if self.is_plain() { *z } else { CODE_RANGE * tanh(z / CODE_RANGE) };
        let input: Vec<f32> = code.iter().map(bounded).collect();
        let (output, tape) = self.decoder.forward(&input, batch);
        let features = if self.is_plain() {
            features_of(&self.chart, &output)
        } else {
            let mut features = self.linear.features(code);
            for (row, residual) in features.chunks_exact_mut(N_FEATURES).zip(output.chunks_exact(N_FEATURES)) {
                for ((x, r), spread) in row.iter_mut().zip(residual).zip(&self.spread) {
                    *x += blending.residual_share * RESIDUAL_UNIT * spread * r;
                }
            }
            features
        };
        Decoded { features, input, output, tape, blending }
    }

    /// Gradient to the code from that to the features; adds the gradient to the parameters to `gradient`, if given.
    pub(crate) fn decode_backward(
        &self,
        decoded: &Decoded,
        d_features: &[f32],
        batch: usize,
        gradient: Option<&mut [f32]>,
    ) -> Vec<f32> {
        if self.is_plain() {
            let d_output = features_of_backward(&self.chart, &decoded.output, &decoded.features, d_features);
            return self.decoder.backward(&decoded.tape, &decoded.input, &d_output, batch, gradient);
        }
        let mut d_output = d_features.to_vec();
        let unit = decoded.blending.residual_share * RESIDUAL_UNIT;
        for row in d_output.chunks_exact_mut(N_FEATURES) {
            row.iter_mut().zip(&self.spread).for_each(|(d, spread)| *d *= unit * spread);
        }
        let mut d_code = self.decoder.backward(&decoded.tape, &decoded.input, &d_output, batch, gradient);
        d_code.iter_mut().zip(&decoded.input).for_each(|(d, input)| *d *= 1.0 - (input / CODE_RANGE).powi(2));
        let direct = self.linear.features_backward(d_features);
        d_code.iter_mut().zip(&direct).for_each(|(d, direct)| *d += direct);
        d_code
    }
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
    use super::super::chart::LATENT_JOINTS;
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

    /// Derivative of the sum of all outputs times a wave along a direction of parameters or codes. Differences in single
    /// precision are accurate to some 1e-5 of the product of the lengths of gradient and step, of which a slope is a hundredth
    /// (shorter steps suffer from rounding, longer ones from curvature).
    #[test]
    fn both_backward_passes_agree_with_differences() {
        for form in [VaeForm::Recurrent, VaeForm::PerFrame, VaeForm::Plain] {
            let shape = VaeShape { encoder_hidden: 7, decoder_hidden: 5, form };
            let basis = basis();
            let parameters = wave(shape.n_parameters(), 1.7, 0.15);
            let mut observed: Vec<Observed> =
                [0.4, 0.7].map(|s| Observed::complete(wave(9 * N_FEATURES, s, 0.6))).to_vec();
            observed[1].seen[20..60].fill(false);
            let inputs: Vec<EncoderInput> = observed.iter().map(|o| shape.input(&basis, o)).collect();
            let pulls = [wave(18 * LATENT_DIM, 0.31, 1.0), wave(18 * LATENT_DIM, 0.77, 1.0)];
            let pull_features = wave(18 * N_FEATURES, 0.57, 1.0);
            let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
            let value = |parameters: &[f32], code_step: f32| {
                let vae = Vae::new(shape, &basis, parameters);
                let encoded = vae.encode(&inputs);
                let code: Vec<f32> = wave(18 * LATENT_DIM, 0.3, 1.0).iter().map(|z| z + code_step).collect();
                let decoded = vae.decode(&code, 2, BlendingFactors::UNCHANGED);
                dot(&encoded.mean, &pulls[0])
                    + dot(&encoded.log_variance, &pulls[1])
                    + dot(&decoded.features, &pull_features)
            };
            let vae = Vae::new(shape, &basis, &parameters);
            let mut gradient = vec![0.0; parameters.len()];
            let encoded = vae.encode(&inputs);
            vae.encode_backward(&encoded, &inputs, &pulls[0], &pulls[1], &mut gradient);
            let decoded = vae.decode(&wave(18 * LATENT_DIM, 0.3, 1.0), 2, BlendingFactors::UNCHANGED);
            let d_code = vae.decode_backward(&decoded, &pull_features, 2, Some(&mut gradient));
            for direction in [wave(parameters.len(), 2.3, 1.0), wave(parameters.len(), 0.019, 1.0)] {
                let stepped = |h: f32| {
                    let moved: Vec<f32> = parameters.iter().zip(&direction).map(|(p, d)| p + h * d).collect();
                    value(&moved, 0.0)
                };
                let difference = (stepped(1e-4) - stepped(-1e-4)) / 2e-4;
                let (slope, length) = (dot(&gradient, &direction), dot(&gradient, &gradient).sqrt());
                let typical = length * (direction.len() as f64).sqrt();
                assert!((difference - slope).abs() < 1e-5 * typical, "{form:?}: {difference} {slope}");
            }
            let difference = (value(&parameters, 1e-2) - value(&parameters, -1e-2)) / 2e-2;
            let slope: f64 = d_code.iter().map(|d| f64::from(*d)).sum();
            assert!((difference - slope).abs() < 1e-3 * slope.abs().max(1.0), "{form:?}: {difference} {slope}");
        }
    }

    #[derive(serde::Deserialize)]
    struct Reference {
        features: Vec<f64>,
        d_code: Vec<f64>,
    }

    /// Against automatic differentiation in double precision (`reference/decoder_gradient.py`), to 1e-5 of the largest entry.
    #[test]
    fn the_decoder_agrees_with_automatic_differentiation() {
        let reference: Reference = serde_json::from_str(include_str!("reference/decoder_gradient.json")).unwrap();
        let numbers = |n: usize, salt: usize| -> Vec<f32> {
            (0..n).map(|i| ((i * 7919 + salt * 104_729) % 1000) as f32 / 1000.0 - 0.5).collect()
        };
        let shape = VaeShape { encoder_hidden: 1, decoder_hidden: 5, form: VaeForm::Recurrent };
        let basis = Basis { features_from_code: numbers(LATENT_DIM * N_FEATURES, 2), ..basis() };
        let mut parameters = vec![0.0; shape.encoder().len()];
        parameters.extend(numbers(shape.decoder().len(), 1));
        let vae = Vae::new(shape, &basis, &parameters);
        let decoded = vae.decode(&numbers(6 * 2 * LATENT_DIM, 3), 2, BlendingFactors::UNCHANGED);
        let d_code = vae.decode_backward(&decoded, &numbers(6 * 2 * N_FEATURES, 4), 2, None);
        for (found, expected) in [(&decoded.features, &reference.features), (&d_code, &reference.d_code)] {
            assert_eq!(found.len(), expected.len());
            let largest = expected.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
            let worst = found.iter().zip(expected).fold(0.0_f64, |m, (a, b)| m.max((f64::from(*a) - b).abs()));
            assert!(worst < 1e-5 * largest, "{worst} of {largest}");
        }
    }
}
