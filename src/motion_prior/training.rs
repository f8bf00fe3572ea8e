//! Training of the denoiser on recorded motions with gaps and noise.
//!
//! Every motion of every step comes from its own random stream, keyed by seed, step and place, and sums have a fixed order:
//! the same data, seed and steps give the same bytes with any number of threads.

use super::basis::{fit_basis, mean_rotations};
use super::chart::{Features, LocalRotations, N_FEATURES};
use super::dataset::{Dataset, Take, mirrored, mirrored_path, split_by_subject};
use super::denoiser::{DEFAULT_WIDTH, Denoiser};
use super::denoiser_input::{DenoiserInput, denoiser_input};
use super::evaluation::{GapErrors, gap_errors, share_inside};
use super::gaps::{add_noise, hide_randomly};
use super::joints::Bones;
use super::objective::{Batch, TrueMotion};
use super::observed::ObservedMotion;
use super::prior::MotionPrior;
use super::weights::{Provenance, Weights, WeightsError};
use crate::geometry::rotation::{exp, log};
use crate::progress::{Canceled, Progress};
use candle_core::{DType, Device, Tensor, Var};
use candle_nn::{AdamW, Optimizer, ParamsAdamW, VarBuilder, VarMap};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Configuration of a training run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrainingConfig {
    /// Seed of every random choice.
    pub seed: u64,
    /// Number of steps, of some 2,000 frames each; with 0 the prior is the bridge with a calibrated uncertainty.
    pub steps: usize,
    /// Width of the network's layers.
    pub width: usize,
}

impl Default for TrainingConfig {
    fn default() -> Self {
        Self { seed: 1, steps: 1200, width: DEFAULT_WIDTH }
    }
}

/// Lengths of the motions of a step and their numbers: 2,048 frames or a little less.
const MOTIONS: [(usize, usize); 3] = [(96, 21), (144, 14), (204, 10)];
/// Tempo relative to the take.
const TEMPO: std::ops::Range<f64> = 0.7..1.4;
/// Largest learning rate; it rises over the first steps and falls with a cosine.
const LEARNING_RATE: f64 = 2e-3;
const WARM_UP_STEPS: f64 = 100.0;
const WEIGHT_DECAY: f64 = 0.01;
/// Gradients longer than this are shortened to it.
const MAX_GRADIENT: f64 = 1.0;
/// Share of the mean over steps that one step replaces; the mean is what is kept.
const MEAN_SHARE: f64 = 0.004;
/// At step n the mean is over the last n / 8 steps at first.
const MEAN_START: f64 = 8.0;
/// Steps between validations on the held-out subjects, and validations without improvement after which training ends.
const VALIDATION_EVERY: usize = 200;
const PATIENCE: usize = 8;
/// One of this number of gaps of the held-out subjects is validated on.
const VALIDATION_GAPS: usize = 12;
/// The same for the calibration of the temperature.
const CALIBRATION_GAPS: usize = 3;

/// Why training failed.
#[derive(Debug, thiserror::Error)]
pub enum TrainingError {
    /// The takes have too few frames.
    #[error("more than {N_FEATURES} frames and one take of {} frames expected, found {frames} frames", MOTIONS[2].0)]
    TooFewFrames {
        /// Number of frames.
        frames: usize,
    },
    /// The loss is not finite.
    #[error("step {step}: the loss is not finite")]
    Diverged {
        /// The step.
        step: usize,
    },
    /// The device cannot hold or compute the network.
    #[error(transparent)]
    Network(#[from] candle_core::Error),
    /// The weights cannot be kept.
    #[error(transparent)]
    Weights(#[from] WeightsError),
    /// The caller canceled the run.
    #[error(transparent)]
    Canceled(#[from] Canceled),
}

/// Trains a prior; with the feature `cuda` on the first CUDA device if there is one. `keep` receives the best weights after
/// every validation that improves on them, so that an interrupted run leaves something; their temperature is not yet
/// calibrated.
///
/// # Errors
/// [`TrainingError`]: too few frames, divergence, no memory, cancellation.
pub fn train(
    data: &Dataset,
    config: &TrainingConfig,
    progress: &Progress,
    keep: &mut dyn FnMut(&Weights),
) -> Result<Weights, TrainingError> {
    let device = Device::cuda_if_available(0)?;
    let [training, held_out] = split_by_subject(&data.takes);
    let basis = linear_code(&training)?;
    let provenance = Provenance {
        data_sha256: data.sha256.clone(),
        seed: config.seed,
        steps: 0,
        width: config.width,
        held_out_error_mm: f64::INFINITY,
        temperature: 1.0,
    };
    let variables = initial_variables(config, &device)?;
    let mut mean = detached(&variables)?;
    let mut best = Weights { provenance, basis, denoiser: on_cpu(&mean)? };
    let rest = MotionPrior::new(best.clone())?.mean_pose();
    let source = Source { takes: &training, rest: &rest, seed: config.seed };
    let vars: Vec<Var> = variables.data().lock().expect("no other thread").values().cloned().collect();
    let builder = VarBuilder::from_varmap(&variables, DType::F32, &device);
    let denoiser = Denoiser::new(config.width, builder)?;
    let params = ParamsAdamW { lr: LEARNING_RATE, weight_decay: WEIGHT_DECAY, ..ParamsAdamW::default() };
    let mut optimizer = AdamW::new(vars.clone(), params)?;
    let (bones, mut recent, mut stale) = (Bones::of_default_body(), 0.0, 0);
    for step in 0..config.steps {
        progress.check()?;
        let batch = Batch::new(&bones, &source.motions(step), &device)?;
        let loss = batch.loss(&denoiser.forward(&batch.input)?)?;
        let value = f64::from(loss.to_scalar::<f32>()?);
        if !value.is_finite() {
            return Err(TrainingError::Diverged { step });
        }
        recent += (value - recent) / (step + 1).min(100) as f64;
        optimizer.set_learning_rate(learning_rate(step, config.steps));
        let mut gradients = loss.backward()?;
        shorten(&mut gradients, &vars)?;
        optimizer.step(&gradients)?;
        follow(&mut mean, &variables, MEAN_SHARE.max(MEAN_START / (step as f64 + MEAN_START)))?;
        let done = step + 1;
        if done.is_multiple_of(VALIDATION_EVERY) || done == config.steps {
            let candidate = Weights {
                provenance: Provenance { steps: done, ..best.provenance.clone() },
                denoiser: on_cpu(&mean)?,
                ..best.clone()
            };
            let errors = gap_errors(&MotionPrior::new(candidate.clone())?, &held_out, VALIDATION_GAPS);
            let found_mm = mean_mm(&errors);
            stale += 1;
            if found_mm < best.provenance.held_out_error_mm || held_out.is_empty() {
                best = candidate;
                best.provenance.held_out_error_mm = found_mm;
                stale = 0;
                keep(&best);
            }
            let message = format!("step {done}: loss {recent:.3}, hidden joints of held-out subjects {found_mm:.1} mm");
            progress.report(done as f64 / config.steps as f64, message);
            if stale >= PATIENCE {
                break;
            }
        }
    }
    if held_out.is_empty() {
        best.provenance.held_out_error_mm = 0.0;
        return Ok(best);
    }
    let errors = gap_errors(&MotionPrior::new(best.clone())?, &held_out, CALIBRATION_GAPS);
    best.provenance.held_out_error_mm = mean_mm(&errors);
    best.provenance.temperature = temperature(&errors);
    Ok(best)
}

/// Mean over the kinds of gaps that occur, mm.
fn mean_mm(errors: &[GapErrors]) -> f64 {
    let found: Vec<f64> = errors.iter().filter(|kind| kind.n_gaps > 0).map(|kind| kind.denoiser_mm).collect();
    found.iter().sum::<f64>() / found.len().max(1) as f64
}

/// The linear code of the training takes and their mirror images.
fn linear_code(training: &[&Take]) -> Result<super::basis::Basis, TrainingError> {
    let both: Vec<_> = training.iter().flat_map(|take| [take.rotations.clone(), mirrored(&take.rotations)]).collect();
    let frames = both.iter().map(Vec::len).sum::<usize>() / 2;
    let chart = mean_rotations(&both);
    let features: Vec<Vec<Features>> = both.par_iter().map(|take| chart.features_of_take(take)).collect();
    let is_long = training.iter().any(|take| take.rotations.len() >= MOTIONS[2].0);
    fit_basis(chart, &features).filter(|_| is_long).ok_or(TrainingError::TooFewFrames { frames })
}

/// Random variables: normal with variance 1 / fan-in; biases and the last layer of the network and of each block are zero,
/// so that training begins at the bridge.
fn initial_variables(config: &TrainingConfig, device: &Device) -> candle_core::Result<VarMap> {
    let mut variables = VarMap::new();
    Denoiser::new(config.width, VarBuilder::from_varmap(&variables, DType::F32, device))?;
    let shapes: BTreeMap<String, Vec<usize>> = {
        let named = variables.data().lock().expect("no other thread");
        named.iter().map(|(name, var)| (name.clone(), var.dims().to_vec())).collect()
    };
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    for (name, shape) in shapes {
        let n: usize = shape.iter().product();
        let is_zero = name.ends_with("bias") || name.contains("out.") || name.contains("head.");
        let sd = (1.0 / shape.last().copied().unwrap_or(1) as f32).sqrt();
        let values: Vec<f32> =
            (0..n).map(|_| if is_zero { 0.0 } else { sd * rng.sample::<f32, _>(StandardNormal) }).collect();
        variables.set_one(&name, Tensor::from_vec(values, shape, device)?)?;
    }
    Ok(variables)
}

fn detached(variables: &VarMap) -> candle_core::Result<BTreeMap<String, Tensor>> {
    let named = variables.data().lock().expect("no other thread");
    named.iter().map(|(name, var)| Ok((name.clone(), var.as_detached_tensor().copy()?))).collect()
}

fn on_cpu(tensors: &BTreeMap<String, Tensor>) -> candle_core::Result<BTreeMap<String, Tensor>> {
    tensors.iter().map(|(name, tensor)| Ok((name.clone(), tensor.to_device(&Device::Cpu)?))).collect()
}

/// Moves the mean over steps by `share` towards the variables.
fn follow(mean: &mut BTreeMap<String, Tensor>, variables: &VarMap, share: f64) -> candle_core::Result<()> {
    let named = variables.data().lock().expect("no other thread");
    for (name, mean) in mean {
        if let Some(var) = named.get(name) {
            *mean = ((&*mean * (1.0 - share))? + (var.as_detached_tensor() * share)?)?;
        }
    }
    Ok(())
}

fn learning_rate(step: usize, steps: usize) -> f64 {
    let share = step as f64 / steps.max(1) as f64;
    let cosine = 0.5 * (1.0 + (std::f64::consts::PI * share).cos());
    LEARNING_RATE * ((step + 1) as f64 / WARM_UP_STEPS).min(1.0) * cosine.max(0.01)
}

/// Shortens the gradient of all variables together to [`MAX_GRADIENT`].
fn shorten(gradients: &mut candle_core::backprop::GradStore, vars: &[Var]) -> candle_core::Result<()> {
    // In the order of their sizes and values nothing is fixed: squares are summed in double precision, sorted.
    let mut squares = Vec::with_capacity(vars.len());
    for var in vars {
        if let Some(gradient) = gradients.get(var) {
            squares.push(f64::from(gradient.sqr()?.sum_all()?.to_scalar::<f32>()?));
        }
    }
    squares.sort_by(f64::total_cmp);
    let length = squares.iter().sum::<f64>().sqrt();
    if length > MAX_GRADIENT {
        for var in vars {
            if let Some(gradient) = gradients.get(var) {
                let shorter = (gradient * (MAX_GRADIENT / length))?;
                gradients.insert(var, shorter);
            }
        }
    }
    Ok(())
}

/// The smallest factor of the covariances with which 95 % of all errors lie inside their 95 % ellipsoids.
fn temperature(errors: &[GapErrors]) -> f64 {
    let ellipsoids: Vec<_> = errors.iter().flat_map(|kind| kind.ellipsoids.iter().copied()).collect();
    let (mut low, mut high) = (0.05_f64, 20.0_f64);
    for _ in 0..30 {
        let middle = (low * high).sqrt();
        if share_inside(&ellipsoids, middle) < 0.95 { low = middle } else { high = middle }
    }
    high
}

/// Where the motions of the training come from.
struct Source<'a> {
    takes: &'a [&'a Take],
    rest: &'a LocalRotations,
    seed: u64,
}

impl Source<'_> {
    /// The motions of a step.
    fn motions(&self, step: usize) -> Vec<(ObservedMotion, DenoiserInput, TrueMotion)> {
        let (n_frames, n_motions) = MOTIONS[step % MOTIONS.len()];
        let motion = |place: usize| {
            let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
            rng.set_stream(1 + (step * 64 + place) as u64);
            let truth = self.draw(n_frames, &mut rng);
            let mut observed = ObservedMotion::exact(truth.rotations.clone(), truth.pelvis.clone());
            add_noise(&mut observed, &mut rng);
            hide_randomly(&mut observed, &mut rng);
            let input = denoiser_input(&observed, self.rest);
            (observed, input, truth)
        };
        (0..n_motions).into_par_iter().map(motion).collect()
    }

    /// A stretch of a take at a random tempo, half of them as mirror images. Every frame is an equally likely start.
    fn draw(&self, n_frames: usize, rng: &mut ChaCha8Rng) -> TrueMotion {
        let starts = |take: &&Take| (take.rotations.len() + 1).saturating_sub(n_frames);
        let mut start = rng.random_range(0..self.takes.iter().map(starts).sum::<usize>().max(1));
        let Some(take) = self.takes.iter().find(|take| {
            let here = start < starts(take);
            start -= if here { 0 } else { starts(take) };
            here
        }) else {
            unreachable!("one take is as long as the longest motion");
        };
        let n_after = (take.rotations.len() - 1 - start) as f64;
        let tempo = rng.random_range(TEMPO).min(n_after / (n_frames - 1) as f64);
        let mut motion = TrueMotion { rotations: vec![], pelvis: vec![], contacts: vec![] };
        for t in 0..n_frames {
            let at = start as f64 + (t as f64 * tempo).min(n_after);
            let (first, next, share) = (at.floor() as usize, at.ceil() as usize, at.fract());
            let between = |joint: usize| {
                let from = take.rotations[first][joint];
                from * exp(&(log(&(from.transpose() * take.rotations[next][joint])) * share))
            };
            motion.rotations.push(std::array::from_fn(between));
            motion.pelvis.push(take.pelvis[first].lerp(&take.pelvis[next], share));
            motion.contacts.push(take.contacts[first]);
        }
        if rng.random_bool(0.5) {
            motion.rotations = mirrored(&motion.rotations);
            motion.pelvis = mirrored_path(&motion.pelvis);
            motion.contacts.iter_mut().for_each(|feet| feet.swap(0, 1));
        }
        motion
    }
}
