//! Training of the networks on recorded motions.

use super::dataset::Dataset;
pub use super::descent::{TrainingConfig, TrainingError};
use super::weights::{NetworkKind, Weights};
use super::{denoiser_training, vae_training};
use crate::progress::Progress;
use candle_core::Device;

impl TrainingConfig {
    /// The configuration of a network where nothing else is said.
    pub fn of(model: NetworkKind) -> Self {
        match model {
            NetworkKind::Denoiser => denoiser_training::DEFAULTS,
            NetworkKind::Latent => vae_training::DEFAULTS,
        }
    }
}

/// Trains a network; with the feature `cuda` on the first CUDA device if there is one. `keep` receives the best weights after
/// every validation that improves on them, so that an interrupted run leaves something; the temperature of a denoiser is not
/// yet calibrated.
///
/// # Errors
/// [`TrainingError`]: too few frames, divergence, no memory, cancellation.
pub fn train(
    data: &Dataset,
    config: &TrainingConfig,
    progress: &Progress,
    keep: &mut dyn FnMut(&Weights),
) -> Result<Weights, TrainingError> {
    let device = &Device::cuda_if_available(0)?;
    match config.model {
        NetworkKind::Denoiser => denoiser_training::train_denoiser(data, config, device, progress, keep),
        NetworkKind::Latent => vae_training::train_vae(data, config, device, progress, keep),
    }
}
