//! Reads the motion prior that a command works with.

use crate::cli::bad_input::BadInput;
use crate::motion_prior::weights::{NetworkKind, WeightsError};
use crate::motion_prior::{LatentPrior, MotionPrior};
use std::path::Path;

/// The networks, as commands name them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Model {
    /// Completes hidden joints and removes noise
    Denoiser,
    /// Encodes motions as latent codes and decodes them
    Latent,
}

impl Model {
    pub(super) fn kind(self) -> NetworkKind {
        match self {
            Self::Denoiser => NetworkKind::Denoiser,
            Self::Latent => NetworkKind::Latent,
        }
    }
}

/// Reads a denoiser from a file; without a file the embedded one.
pub(super) fn read_prior(file: Option<&Path>) -> anyhow::Result<MotionPrior> {
    file.map_or_else(|| Ok(MotionPrior::embedded().clone()), |file| read(file, MotionPrior::from_bytes))
}

/// Reads an autoencoder from a file; without a file the embedded one.
pub(super) fn read_latent_prior(file: Option<&Path>) -> anyhow::Result<LatentPrior> {
    file.map_or_else(|| Ok(LatentPrior::embedded().clone()), |file| read(file, LatentPrior::from_bytes))
}

fn read<T>(file: &Path, parse: impl Fn(&[u8]) -> Result<T, WeightsError>) -> anyhow::Result<T> {
    let bad = |reason: String| BadInput(format!("{}: {reason}", file.display()));
    let bytes = std::fs::read(file).map_err(|error| bad(error.to_string()))?;
    Ok(parse(&bytes).map_err(|error| bad(error.to_string()))?)
}
