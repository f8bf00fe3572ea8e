//! Training of the network on corrupted clips of takes.
//!
//! Every step draws its clips, corruptions and noise from a random stream keyed by seed and step, and sums do not depend on
//! the number of threads: the same data, seed and steps give the same bytes, also after an interruption.

use super::basis::{Basis, LATENT_DIM, fit_basis, mean_rotations};
use super::chart::{Features, N_FEATURES};
use super::checkpoint::{Checkpoint, Provenance};
use super::clips::{Clip, draw_clip, smooth_code};
use super::corruption::{Corruption, LIMBS, corrupted, random_corruption};
use super::dataset::{Dataset, mirrored, split_by_subject};
use super::encoder_input::EncoderInput;
use super::fusion::BlendingFactors;
use super::joints::{Bones, rows};
use super::objective::{Truth, joint_loss, joints_of, limit_loss};
use super::optimizer::{Adam, AdamState};
use super::shape::VaeShape;
use super::vae::{Vae, interleaved, separated};
use crate::progress::{Canceled, Progress};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rayon::prelude::*;

/// Configuration of a training run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrainingConfig {
    /// Seed of every random choice.
    pub seed: u64,
    /// Number of steps, of some 2,000 frames each.
    pub steps: usize,
    /// Widths and form of the network.
    pub shape: VaeShape,
    /// Weight of the paper's local linear term, the mean square of `z_(t+1) - 2 z_t + z_(t-1)`, per dimension.
    pub local_linear: f64,
}

impl Default for TrainingConfig {
    fn default() -> Self {
        // 3,000 steps take 12 minutes on one core.
        Self { seed: 1, steps: 3000, shape: VaeShape::default(), local_linear: 3.0 }
    }
}

/// Frames of one step, in clips of equal length.
const FRAMES_PER_STEP: usize = 2048;
/// Lengths of clips, frames at 30 Hz: one to four seconds.
const CLIP_LENGTHS: [usize; 4] = [32, 64, 96, 128];
/// Weight of one nat of KL per dimension and frame.
const KL_WEIGHT: f64 = 0.02;
/// Share of the run over which the KL weight grows to its final value.
const KL_WARM_UP: f64 = 0.3;
/// Number and length (frames) of clips drawn from the prior in every step, which train the decoder on the joint limits.
const PRIOR_CLIPS: usize = 4;
const PRIOR_FRAMES: usize = 64;
/// Steps between validations on the held out subjects.
const VALIDATION_EVERY: usize = 250;
/// Validations without an improvement after which training ends.
const PATIENCE: usize = 12;

/// State of a training run, from which it can be resumed.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainingState {
    /// Steps done.
    pub step: usize,
    /// Current parameters.
    pub parameters: Vec<f32>,
    /// State of the optimiser.
    pub optimizer: AdamState,
    /// Best mean parameters so far and their error on the held out subjects, mm.
    pub best: (Vec<f32>, f64),
    /// Validations since the best one.
    pub stale_validations: usize,
}

const STATE_MAGIC: &[u8; 8] = b"WLSTATE2";

/// The file of a state: `WLSTATE2`, three counts, the best error, five vectors of single precision numbers.
pub fn state_bytes(state: &TrainingState) -> Vec<u8> {
    let mut bytes = STATE_MAGIC.to_vec();
    for count in [state.step, state.stale_validations, state.parameters.len()] {
        bytes.extend((count as u64).to_le_bytes());
    }
    bytes.extend(state.best.1.to_le_bytes());
    let AdamState { first, second, average } = &state.optimizer;
    for numbers in [&state.parameters, first, second, average, &state.best.0] {
        numbers.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    }
    bytes
}

/// Reads the file of a state.
///
/// # Errors
/// [`TrainingError::Unreadable`] if the bytes are not a complete file of [`state_bytes`].
pub fn state_from_bytes(bytes: &[u8]) -> Result<TrainingState, TrainingError> {
    let unreadable = TrainingError::Unreadable;
    let rest = bytes.strip_prefix(STATE_MAGIC).ok_or(unreadable)?;
    let (head, rest) = rest.split_first_chunk::<32>().ok_or(TrainingError::Unreadable)?;
    let word = |i: usize| u64::from_le_bytes(std::array::from_fn(|k| head[8 * i + k]));
    let n = usize::try_from(word(2)).ok().filter(|n| n.checked_mul(20) == Some(rest.len()));
    let n = n.ok_or(TrainingError::Unreadable)?;
    let numbers: Vec<f32> = rest.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    let part = |i: usize| numbers[i * n..(i + 1) * n].to_vec();
    Ok(TrainingState {
        step: word(0) as usize,
        stale_validations: word(1) as usize,
        parameters: part(0),
        optimizer: AdamState { first: part(1), second: part(2), average: part(3) },
        best: (part(4), f64::from_bits(word(3))),
    })
}

/// Why training failed.
#[derive(Debug, thiserror::Error)]
pub enum TrainingError {
    /// The takes have too few frames.
    #[error("more than {N_FEATURES} frames and one take of {} frames expected, found {frames} frames", CLIP_LENGTHS[0])]
    TooFewFrames {
        /// Number of frames.
        frames: usize,
    },
    /// The state belongs to a network of another shape.
    #[error("the state to resume from belongs to a network of {found} parameters, expected {expected}")]
    State {
        /// Parameters of this network.
        expected: usize,
        /// Parameters in the state.
        found: usize,
    },
    /// The file is not a complete training state.
    #[error("not a complete state of a training run")]
    Unreadable,
    /// The loss is not finite.
    #[error("step {step}: the loss is not finite")]
    Diverged {
        /// The step.
        step: usize,
    },
    /// The caller canceled the run.
    #[error(transparent)]
    Canceled(#[from] Canceled),
}

/// Trains a prior. `resume` continues a run of the same data, seed and steps; `keep` receives the state after every
/// validation on the held out subjects.
///
/// # Errors
/// [`TrainingError`]: too few frames, a state of another shape, divergence, cancellation.
pub fn train(
    data: &Dataset,
    config: &TrainingConfig,
    resume: Option<TrainingState>,
    progress: &Progress,
    keep: &mut dyn FnMut(&TrainingState),
) -> Result<Checkpoint, TrainingError> {
    let [training, held_out] = prepare(data)?;
    let basis = training.basis;
    let bones = Bones::of_default_body();
    let shape = config.shape;
    let validation = validation_clips(shape, &basis, &held_out);
    let mut state = resume.unwrap_or_else(|| TrainingState {
        step: 0,
        parameters: shape.initial_parameters(config.seed),
        optimizer: AdamState::new(shape.n_parameters()),
        best: (shape.initial_parameters(config.seed), f64::INFINITY),
        stale_validations: 0,
    });
    if state.parameters.len() != shape.n_parameters() {
        return Err(TrainingError::State { expected: shape.n_parameters(), found: state.parameters.len() });
    }
    let adam = Adam::new(config.steps);
    while state.step < config.steps && state.stale_validations < PATIENCE {
        progress.check()?;
        let vae = Vae::new(shape, &basis, &state.parameters);
        let step = training_step(&vae, &basis, &bones, &training.takes, config, state.step);
        if !step.losses.total().is_finite() {
            return Err(TrainingError::Diverged { step: state.step });
        }
        adam.update(&mut state.parameters, &step.gradient, &mut state.optimizer, state.step);
        state.step += 1;
        if state.step.is_multiple_of(VALIDATION_EVERY) || state.step == config.steps {
            let vae = Vae::new(shape, &basis, &state.optimizer.average);
            let error_mm = validation_error_mm(&vae, &basis, &bones, &validation);
            state.stale_validations += 1;
            if error_mm < state.best.1 {
                state.best = (state.optimizer.average.clone(), error_mm);
                state.stale_validations = 0;
            }
            keep(&state);
            let message = format!("step {}: {}, held out {error_mm:.2} mm", state.step, step.losses);
            progress.report(state.step as f64 / config.steps as f64, message);
        }
    }
    let provenance = Provenance {
        data_sha256: data.sha256.clone(),
        seed: config.seed,
        steps: state.step,
        local_linear: config.local_linear,
        held_out_error_mm: if state.best.1.is_finite() { state.best.1 } else { 0.0 },
    };
    Ok(Checkpoint { shape, provenance, basis, parameters: state.best.0 })
}

struct Prepared {
    basis: Basis,
    takes: Vec<Vec<f32>>,
}

/// Training takes with their mirror images, and the held out ones, as features.
fn prepare(data: &Dataset) -> Result<[Prepared; 2], TrainingError> {
    let [training, held_out] = split_by_subject(&data.takes);
    let both: Vec<_> = training.iter().flat_map(|take| [take.rotations.clone(), mirrored(&take.rotations)]).collect();
    let chart = mean_rotations(&both);
    let features: Vec<Vec<Features>> = both.par_iter().map(|take| chart.features_of_take(take)).collect();
    let too_few = TrainingError::TooFewFrames { frames: both.iter().map(Vec::len).sum::<usize>() / 2 };
    let basis = fit_basis(chart, &features);
    let basis = basis.filter(|_| features.iter().any(|take| take.len() >= CLIP_LENGTHS[0])).ok_or(too_few)?;
    let held_out = held_out.iter().map(|take| rows(&basis.chart.features_of_take(&take.rotations))).collect::<Vec<_>>();
    let training = Prepared { basis: basis.clone(), takes: features.iter().map(|take| rows(take)).collect() };
    Ok([training, Prepared { basis, takes: held_out }])
}

/// Losses of a step, and their gradient to the parameters.
struct TrainingStep {
    losses: Losses,
    gradient: Vec<f32>,
}

struct Losses {
    joints: f64,
    kl: f64,
    linear: f64,
    limits: f64,
}

impl Losses {
    fn total(&self) -> f64 {
        self.joints + self.kl + self.linear + self.limits
    }
}

impl std::fmt::Display for Losses {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { joints, kl, linear, limits } = self;
        write!(f, "joints {joints:.3}, KL {kl:.3}, linear {linear:.3}, limits {limits:.3}")
    }
}

fn training_step(
    vae: &Vae,
    basis: &Basis,
    bones: &Bones,
    takes: &[Vec<f32>],
    config: &TrainingConfig,
    step: usize,
) -> TrainingStep {
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    rng.set_stream(1 + step as u64);
    let clips = draw_clips(takes, &mut rng);
    let batch = clips.len();
    let inputs: Vec<EncoderInput> = clips.par_iter().map(|clip| config.shape.input(basis, &clip.observed)).collect();
    let encoded = vae.encode(&inputs);
    let noise: Vec<f32> = (0..encoded.mean.len()).map(|_| rng.sample::<f32, _>(StandardNormal)).collect();
    let sds: Vec<f32> = encoded.log_variance.iter().map(|v| (0.5 * v).exp()).collect();
    let code: Vec<f32> = encoded.mean.iter().zip(&sds).zip(&noise).map(|((m, sd), n)| m + sd * n).collect();
    let decoded = vae.decode(&code, batch, BlendingFactors::UNCHANGED);

    let mut gradient = vec![0.0; config.shape.n_parameters()];
    let joints = batch_loss(vae_clips(&decoded.features, batch), |b, features| {
        let truth = Truth::of(&basis.chart, bones, &clips[b].truth);
        joint_loss(&basis.chart, bones, features, &truth, 1.0 / batch as f64)
    });
    let d_code = vae.decode_backward(&decoded, &joints.d_features, batch, Some(&mut gradient));
    let posterior = Posterior { mean: &encoded.mean, log_variance: &encoded.log_variance };
    let warmth = (step as f64 / (KL_WARM_UP * config.steps as f64)).min(1.0);
    let latent = latent_loss(&posterior, batch, KL_WEIGHT * warmth, config.local_linear);
    let d_mean: Vec<f32> = d_code.iter().zip(&latent.d_mean).map(|(a, b)| a + b).collect();
    let through_noise = d_code.iter().zip(&sds).zip(&noise).map(|((d, sd), n)| 0.5 * d * sd * n);
    let d_log_variance: Vec<f32> = through_noise.zip(&latent.d_log_variance).map(|(a, b)| a + b).collect();
    vae.encode_backward(&encoded, &inputs, &d_mean, &d_log_variance, &mut gradient);

    let samples: Vec<Vec<f32>> = (0..PRIOR_CLIPS).map(|_| smooth_code(PRIOR_FRAMES, &mut rng)).collect();
    let samples: Vec<&[f32]> = samples.iter().map(Vec::as_slice).collect();
    let sampled = vae.decode(&interleaved(&samples, LATENT_DIM), PRIOR_CLIPS, BlendingFactors::UNCHANGED);
    let limits = batch_loss(vae_clips(&sampled.features, PRIOR_CLIPS), |_, features| {
        limit_loss(&basis.chart, features, 1.0 / PRIOR_CLIPS as f64)
    });
    vae.decode_backward(&sampled, &limits.d_features, PRIOR_CLIPS, Some(&mut gradient));
    let losses = Losses { joints: joints.value, kl: latent.kl, linear: latent.linear, limits: limits.value };
    TrainingStep { losses, gradient }
}

/// Clips of one random length from random takes, corrupted.
fn draw_clips(takes: &[Vec<f32>], rng: &mut ChaCha8Rng) -> Vec<Clip> {
    let longest = takes.iter().map(|take| take.len() / N_FEATURES).max().unwrap_or(0);
    let lengths: Vec<usize> = CLIP_LENGTHS.into_iter().filter(|length| *length <= longest).collect();
    let length = lengths[rng.random_range(0..lengths.len())];
    let clip = |_| {
        let truth = draw_clip(takes, length, rng);
        let corruption = random_corruption(length, rng);
        Clip { observed: corrupted(&truth, corruption, rng), truth }
    };
    (0..FRAMES_PER_STEP / length).map(clip).collect()
}

fn vae_clips(together: &[f32], batch: usize) -> Vec<Vec<f32>> {
    separated(together, N_FEATURES, batch)
}

/// A loss summed over clips, its gradient `[T, B, 57]`.
fn batch_loss(
    clips: Vec<Vec<f32>>,
    loss: impl Fn(usize, &[f32]) -> super::objective::Loss + Sync,
) -> super::objective::Loss {
    let losses: Vec<_> = clips.par_iter().enumerate().map(|(b, features)| loss(b, features)).collect();
    let parts: Vec<&[f32]> = losses.iter().map(|loss| loss.d_features.as_slice()).collect();
    super::objective::Loss {
        value: losses.iter().map(|loss| loss.value).sum(),
        d_features: interleaved(&parts, N_FEATURES),
    }
}

struct Posterior<'a> {
    mean: &'a [f32],
    log_variance: &'a [f32],
}

struct LatentLoss {
    kl: f64,
    linear: f64,
    d_mean: Vec<f32>,
    d_log_variance: Vec<f32>,
}

/// `KL(q | N(0, 1)) = (m^2 + s^2 - log s^2 - 1) / 2` and the square of `m_(t+1) - 2 m_t + m_(t-1)`, means per entry.
fn latent_loss(posterior: &Posterior, batch: usize, kl_weight: f64, linear_weight: f64) -> LatentLoss {
    let n = posterior.mean.len();
    let unit = kl_weight / n.max(1) as f64;
    let pairs = || posterior.mean.iter().zip(posterior.log_variance).map(|(m, v)| (f64::from(*m), f64::from(*v)));
    let kl: f64 = pairs().map(|(m, v)| 0.5 * unit * (m * m + v.exp() - v - 1.0)).sum();
    let mut d_mean: Vec<f32> = pairs().map(|(m, _)| (unit * m) as f32).collect();
    let d_log_variance = pairs().map(|(_, v)| (0.5 * unit * (v.exp() - 1.0)) as f32).collect();
    let stride = batch * LATENT_DIM;
    let unit = linear_weight / n.max(1) as f64;
    let mut linear = 0.0;
    for i in stride..n.saturating_sub(stride) {
        let bend = f64::from(posterior.mean[i + stride] - 2.0 * posterior.mean[i] + posterior.mean[i - stride]);
        linear += unit * bend * bend;
        let d = (2.0 * unit * bend) as f32;
        d_mean[i + stride] += d;
        d_mean[i] -= 2.0 * d;
        d_mean[i - stride] += d;
    }
    LatentLoss { kl, linear, d_mean, d_log_variance }
}

/// Length of the validation clips, frames.
const VALIDATION_FRAMES: usize = 96;
/// Most validation clips.
const MAX_VALIDATION_CLIPS: usize = 48;

/// Held out clips, each with one of four corruptions in turn.
fn validation_clips(shape: VaeShape, basis: &Basis, held_out: &Prepared) -> Vec<(Clip, EncoderInput)> {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let all: Vec<&[f32]> = held_out.takes.iter().flat_map(|t| t.chunks_exact(VALIDATION_FRAMES * N_FEATURES)).collect();
    let stride = all.len().div_ceil(MAX_VALIDATION_CLIPS).max(1);
    let clip = |(i, truth): (usize, &&[f32])| {
        let corruption = match i % 4 {
            0 => Corruption::None,
            1 => Corruption::Gap { start: 40, n_frames: 15 },
            2 => Corruption::Limb { limb: (i / 4) % LIMBS.len(), start: 18, n_frames: 60 },
            _ => Corruption::Noise { sd: 10.0_f64.to_radians(), share: 0.5, steady: false },
        };
        let observed = corrupted(truth, corruption, &mut rng);
        let input = shape.input(basis, &observed);
        (Clip { truth: truth.to_vec(), observed }, input)
    };
    all.iter().step_by(stride).enumerate().map(clip).collect()
}

/// Mean joint error of the posterior's mean over all validation clips, mm; 0 without any.
fn validation_error_mm(vae: &Vae, basis: &Basis, bones: &Bones, clips: &[(Clip, EncoderInput)]) -> f64 {
    if clips.is_empty() {
        return 0.0;
    }
    let inputs: Vec<EncoderInput> = clips.iter().map(|(_, input)| input.clone()).collect();
    let decoded = vae.decode(&vae.encode(&inputs).mean, clips.len(), BlendingFactors::UNCHANGED);
    let decoded = vae_clips(&decoded.features, clips.len());
    let error = |(features, (clip, _)): (&Vec<f32>, &(Clip, EncoderInput))| -> f64 {
        let truth = joints_of(&basis.chart, bones, &clip.truth);
        let found = joints_of(&basis.chart, bones, features);
        let errors = found.iter().zip(&truth).flat_map(|(a, b)| (1..a.len()).map(move |j| (a[j] - b[j]).norm()));
        errors.sum::<f64>() / (truth.len() * (truth[0].len() - 1)) as f64
    };
    1e3 * decoded.iter().zip(clips).map(error).sum::<f64>() / clips.len() as f64
}
