//! Training of the autoencoder on short stretches of recorded motions.

use super::basis::{FittedBasis, LATENT_DIM};
use super::chart::N_FEATURES;
use super::dataset::{Dataset, Take};
use super::descent::{Split, Trainee, TrainingConfig, TrainingError, initialise, named, on_cpu, provenance, trained};
use super::joints::Bones;
use super::latent_prior::LatentPrior;
use super::objective::TrueMotion;
use super::reconstruction::reconstruction_errors;
use super::stretches::Stretches;
use super::vae::{DEFAULT_WIDTH, FROZEN, Vae};
use super::vae_objective::VaeBatch;
use super::weights::{NetworkKind, Weights, WeightsError};
use crate::progress::Progress;
use candle_core::{DType, Device, Tensor};
use candle_nn::{VarBuilder, VarMap};
use rand::RngExt;
use rand_distr::StandardNormal;
use rayon::prelude::*;

/// The configuration where nothing else is said.
pub(super) const DEFAULTS: TrainingConfig =
    TrainingConfig { model: NetworkKind::Latent, seed: 1, steps: 1000, width: DEFAULT_WIDTH };

/// Frames of a stretch, and stretches of a step.
const N_FRAMES: usize = 64;
const N_MOTIONS: usize = 16;

/// The autoencoder in training.
struct Training<'a> {
    vae: Vae,
    stretches: Stretches<'a>,
    code: &'a FittedBasis,
    held_out: &'a [&'a Take],
    bones: Bones,
    device: &'a Device,
}

/// Trains an autoencoder; see [`super::training::train`].
pub(super) fn train_vae(
    data: &Dataset,
    config: &TrainingConfig,
    device: &Device,
    progress: &Progress,
    keep: &mut dyn FnMut(&Weights),
) -> Result<Weights, TrainingError> {
    let Split { training, held_out, code } = Split::of(data)?;
    let mut variables = VarMap::new();
    let vae = Vae::new(config.width, VarBuilder::from_varmap(&variables, DType::F32, device))?;
    initialise(&mut variables, config.seed, device)?;
    for (name, values, shape) in skip_connections(&code) {
        variables.set_one(name, Tensor::from_vec(values, shape, device)?)?;
    }
    let network = on_cpu(&named(&variables)?)?;
    let start = Weights { provenance: provenance(data, config), basis: code.basis.clone(), network };
    let stretches = Stretches { takes: &training, seed: config.seed };
    let trainee =
        Training { vae, stretches, code: &code, held_out: &held_out, bones: Bones::of_default_body(), device };
    let amount = (config.steps, !held_out.is_empty());
    let mut best = trained(&trainee, &variables, FROZEN, start, amount, progress, keep)?;
    if !best.provenance.held_out_error_mm.is_finite() {
        best.provenance.held_out_error_mm = trainee.held_out_mm(&best)?;
    }
    Ok(best)
}

/// The linear code as skip connections: `z = E (u - m)` and `u = m + D z`.
fn skip_connections(code: &FittedBasis) -> [(&'static str, Vec<f32>, Vec<usize>); 4] {
    let FittedBasis { basis, code_from_features: encode } = code;
    let of_mean = |row: &[f32]| -row.iter().zip(&basis.mean).map(|(e, m)| e * m).sum::<f32>();
    let decode = |i: usize| basis.features_from_code[i % LATENT_DIM * N_FEATURES + i / LATENT_DIM];
    [
        ("encoder.skip.weight", encode.clone(), vec![LATENT_DIM, N_FEATURES]),
        ("encoder.skip.bias", encode.chunks_exact(N_FEATURES).map(of_mean).collect(), vec![LATENT_DIM]),
        ("decoder.skip.weight", (0..N_FEATURES * LATENT_DIM).map(decode).collect(), vec![N_FEATURES, LATENT_DIM]),
        ("decoder.skip.bias", basis.mean.to_vec(), vec![N_FEATURES]),
    ]
}

impl Trainee for Training<'_> {
    const LEARNING_RATE: f64 = 1e-3;
    const ERROR_OF: &'static str = "reconstruction";

    fn loss(&self, step: usize) -> candle_core::Result<Tensor> {
        let motion = |place: usize| self.stretches.draw(N_FRAMES, &mut self.stretches.stream(step, place));
        let motions: Vec<TrueMotion> = (0..N_MOTIONS).into_par_iter().map(motion).collect();
        let mut rng = self.stretches.stream(step, N_MOTIONS);
        let noise = (0..N_FRAMES * N_MOTIONS * LATENT_DIM).map(|_| rng.sample(StandardNormal)).collect();
        VaeBatch::new(&self.bones, &self.code.basis.chart, &motions, noise, self.device)?.loss(&self.vae)
    }

    fn held_out_mm(&self, candidate: &Weights) -> Result<f64, WeightsError> {
        Ok(reconstruction_errors(&LatentPrior::new(candidate.clone())?, self.held_out).network.mean_mm)
    }
}
