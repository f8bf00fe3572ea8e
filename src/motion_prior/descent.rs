//! Training of a network: steps of AdamW, validation on held-out subjects, early stopping.
//!
//! Sums have a fixed order, and motions come from random streams of their own: the same data, seed and steps give the same
//! bytes with any number of threads.

use super::basis::{FittedBasis, fit_basis, mean_rotations};
use super::chart::{Features, N_FEATURES};
use super::dataset::{Dataset, Take, mirrored, split_by_subject};
use super::weights::{NetworkKind, Provenance, Weights, WeightsError};
use crate::progress::{Canceled, Progress};
use candle_core::backprop::GradStore;
use candle_core::{Device, Tensor, Var};
use candle_nn::{AdamW, Optimizer, ParamsAdamW, VarMap};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Configuration of a training run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrainingConfig {
    /// The network that is trained.
    pub model: NetworkKind,
    /// Seed of every random choice.
    pub seed: u64,
    /// Number of steps. With 0 a denoiser is the bridge with a calibrated uncertainty, an autoencoder the linear code.
    pub steps: usize,
    /// Width of the network's layers.
    pub width: usize,
}

/// Why training failed.
#[derive(Debug, thiserror::Error)]
pub enum TrainingError {
    /// The takes have too few frames.
    #[error("more than {N_FEATURES} frames and one take of {LONGEST_MOTION} frames expected, found {frames} frames")]
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

/// Longest motion that a training draws, frames.
pub(super) const LONGEST_MOTION: usize = 204;
/// The learning rate rises over the first steps.
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

/// A network on variables that are trained.
pub(super) trait Trainee {
    /// Largest learning rate; it falls with a cosine.
    const LEARNING_RATE: f64;
    /// What [`Self::held_out_mm`] is the error of.
    const ERROR_OF: &'static str;

    /// The loss on the motions of a step.
    fn loss(&self, step: usize) -> candle_core::Result<Tensor>;

    /// Mean error of candidate weights on the held-out subjects, mm.
    fn held_out_mm(&self, candidate: &Weights) -> Result<f64, WeightsError>;
}

/// Takes of a dataset in training and held out, and their linear code.
pub(super) struct Split<'a> {
    pub training: Vec<&'a Take>,
    pub held_out: Vec<&'a Take>,
    pub code: FittedBasis,
}

impl<'a> Split<'a> {
    /// Splits by subject and measures the linear code of the training takes and their mirror images.
    pub(super) fn of(data: &'a Dataset) -> Result<Self, TrainingError> {
        let [training, held_out] = split_by_subject(&data.takes);
        let both: Vec<_> =
            training.iter().flat_map(|take| [take.rotations.clone(), mirrored(&take.rotations)]).collect();
        let frames = both.iter().map(Vec::len).sum::<usize>() / 2;
        let chart = mean_rotations(&both);
        let features: Vec<Vec<Features>> = both.par_iter().map(|take| chart.features_of_take(take)).collect();
        let is_long = training.iter().any(|take| take.rotations.len() >= LONGEST_MOTION);
        let code = fit_basis(chart, &features).filter(|_| is_long).ok_or(TrainingError::TooFewFrames { frames })?;
        Ok(Self { training, held_out, code })
    }
}

/// The facts of a training before its first step.
pub(super) fn provenance(data: &Dataset, config: &TrainingConfig) -> Provenance {
    Provenance {
        model: config.model,
        data_sha256: data.sha256.clone(),
        seed: config.seed,
        steps: 0,
        width: config.width,
        held_out_error_mm: f64::INFINITY,
        temperature: 1.0,
    }
}

/// Trains `variables`, of which those whose names contain `frozen` are held, and returns the best weights. `keep` receives them
/// after every validation that improves on the ones before.
pub(super) fn trained<T: Trainee>(
    trainee: &T,
    variables: &VarMap,
    frozen: &str,
    start: Weights,
    (n_steps, has_held_out): (usize, bool),
    progress: &Progress,
    keep: &mut dyn FnMut(&Weights),
) -> Result<Weights, TrainingError> {
    let (mut mean, mut best) = (named(variables)?, start);
    let vars: Vec<Var> = {
        let all = variables.data().lock().expect("no other thread");
        let all: BTreeMap<&String, &Var> = all.iter().collect();
        all.into_iter().filter(|(name, _)| !name.contains(frozen)).map(|(_, var)| var.clone()).collect()
    };
    let params = ParamsAdamW { lr: T::LEARNING_RATE, weight_decay: WEIGHT_DECAY, ..ParamsAdamW::default() };
    let mut optimizer = AdamW::new(vars.clone(), params)?;
    let (mut recent, mut stale) = (0.0, 0);
    for step in 0..n_steps {
        progress.check()?;
        let loss = trainee.loss(step)?;
        let value = f64::from(loss.to_scalar::<f32>()?);
        if !value.is_finite() {
            return Err(TrainingError::Diverged { step });
        }
        recent += (value - recent) / (step + 1).min(100) as f64;
        optimizer.set_learning_rate(T::LEARNING_RATE * learning_rate(step, n_steps));
        let mut gradients = loss.backward()?;
        shorten(&mut gradients, &vars)?;
        optimizer.step(&gradients)?;
        follow(&mut mean, variables, MEAN_SHARE.max(MEAN_START / (step as f64 + MEAN_START)))?;
        let done = step + 1;
        if done.is_multiple_of(VALIDATION_EVERY) || done == n_steps {
            let provenance = Provenance { steps: done, ..best.provenance.clone() };
            let mut candidate = Weights { provenance, network: on_cpu(&mean)?, ..best.clone() };
            let found_mm = trainee.held_out_mm(&candidate)?;
            stale += 1;
            if found_mm < best.provenance.held_out_error_mm || !has_held_out {
                candidate.provenance.held_out_error_mm = found_mm;
                (best, stale) = (candidate, 0);
                keep(&best);
            }
            let of = T::ERROR_OF;
            let message = format!("step {done}: loss {recent:.3}, {of} of held-out subjects {found_mm:.2} mm");
            progress.report(done as f64 / n_steps as f64, message);
            if stale >= PATIENCE {
                break;
            }
        }
    }
    Ok(best)
}

/// Fills the variables that a network has declared: normal with variance 1 / fan-in; biases and the last layer of the network
/// and of each block are zero, so that training begins at what needs no network.
pub(super) fn initialise(variables: &mut VarMap, seed: u64, device: &Device) -> candle_core::Result<()> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    for (name, declared) in named(variables)? {
        let shape = declared.dims();
        let is_zero = name.ends_with("bias") || name.contains("out.") || name.contains("head.");
        let sd = (1.0 / shape.last().copied().unwrap_or(1) as f32).sqrt();
        let number = |_| if is_zero { 0.0 } else { sd * rng.sample::<f32, _>(StandardNormal) };
        let values: Vec<f32> = (0..declared.elem_count()).map(number).collect();
        variables.set_one(&name, Tensor::from_vec(values, shape, device)?)?;
    }
    Ok(())
}

/// Copies of the variables by name.
pub(super) fn named(variables: &VarMap) -> candle_core::Result<BTreeMap<String, Tensor>> {
    let named = variables.data().lock().expect("no other thread");
    named.iter().map(|(name, var)| Ok((name.clone(), var.as_detached_tensor().copy()?))).collect()
}

/// The same on the CPU.
pub(super) fn on_cpu(tensors: &BTreeMap<String, Tensor>) -> candle_core::Result<BTreeMap<String, Tensor>> {
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

/// Share of the largest learning rate.
fn learning_rate(step: usize, steps: usize) -> f64 {
    let share = step as f64 / steps.max(1) as f64;
    let cosine = 0.5 * (1.0 + (std::f64::consts::PI * share).cos());
    ((step + 1) as f64 / WARM_UP_STEPS).min(1.0) * cosine.max(0.01)
}

/// Shortens the gradient of all variables together to [`MAX_GRADIENT`].
fn shorten(gradients: &mut GradStore, vars: &[Var]) -> candle_core::Result<()> {
    let mut square = 0.0;
    for gradient in vars.iter().filter_map(|var| gradients.get(var)) {
        square += f64::from(gradient.sqr()?.sum_all()?.to_scalar::<f32>()?);
    }
    let length = square.sqrt();
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
