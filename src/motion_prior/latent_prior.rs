//! The trained autoencoder and its operations.

use super::basis::{Basis, LATENT_DIM};
use super::chart::{Chart, Features, LocalRotations, N_FEATURES};
use super::joints::rows;
use super::time_windows::TimeWindows;
use super::vae::Vae;
use super::weights::{NetworkKind, Provenance, Weights, WeightsError};
use candle_core::{Device, Result, Tensor, Var};
use nalgebra::SMatrix;
use std::sync::OnceLock;

/// The embedded weights; their model card is `assets/latent-prior-v1.md`.
const WEIGHTS: &[u8] = include_bytes!("../../assets/latent-prior-v1.safetensors");

/// The latent code of one frame.
pub type Code = [f64; LATENT_DIM];

/// A trained autoencoder of motions of any length and frame rate.
#[derive(Debug, Clone)]
pub struct LatentPrior {
    provenance: Provenance,
    basis: Basis,
    vae: Vae,
}

const SHAPES: &str = "the shapes of network and input agree: the constructor has checked the network's";

impl LatentPrior {
    /// The prior embedded in the binary.
    pub fn embedded() -> &'static Self {
        static PRIOR: OnceLock<LatentPrior> = OnceLock::new();
        PRIOR.get_or_init(|| Self::from_bytes(WEIGHTS).expect("the embedded file is a prior; a test loads it"))
    }

    /// A prior from the bytes of its file.
    ///
    /// # Errors
    /// [`WeightsError`] names what is wrong.
    pub fn from_bytes(bytes: &[u8]) -> std::result::Result<Self, WeightsError> {
        Self::new(Weights::from_bytes(bytes)?)
    }

    /// A prior from its weights.
    ///
    /// # Errors
    /// The weights are of another network, or a variable is missing or has another shape.
    pub fn new(weights: Weights) -> std::result::Result<Self, WeightsError> {
        let vae = Vae::new(weights.provenance.width, weights.variables(NetworkKind::Latent)?)?;
        Ok(Self { vae, provenance: weights.provenance, basis: weights.basis })
    }

    /// Origin of the weights.
    pub fn provenance(&self) -> &Provenance {
        &self.provenance
    }

    /// The linear code, which the skip connections hold.
    pub fn basis(&self) -> &Basis {
        &self.basis
    }

    /// The chart of the features.
    pub fn chart(&self) -> &Chart {
        &self.basis.chart
    }

    /// Derivative of a frame's features by its own code through the decoder's skip connection. [57, 32]
    pub fn features_by_code(&self) -> SMatrix<f64, N_FEATURES, LATENT_DIM> {
        SMatrix::from_fn(|i, k| f64::from(self.basis.features_from_code[k * N_FEATURES + i]))
    }

    /// The encoder's mean of a motion at `fps`.
    ///
    /// # Panics
    /// Never for weights that [`Self::new`] accepted; so the others.
    pub fn encoded(&self, rotations: &[LocalRotations], fps: f64) -> Vec<Code> {
        let encode = || {
            let features = rows(&self.chart().features_of_take(rotations));
            let features = Tensor::from_vec(features, (rotations.len(), N_FEATURES), &Device::Cpu)?;
            let windows = TimeWindows::new(rotations.len(), fps)?;
            let residual = windows.joined(&self.vae.encoder_residual(&windows.split(&features)?)?)?;
            numbers(&(self.vae.encoded_frames(&features)? + residual.narrow(1, 0, LATENT_DIM)?)?)
        };
        if rotations.is_empty() { Vec::new() } else { encode().expect(SHAPES) }
    }

    /// The features of codes at `fps`.
    pub fn decoded(&self, codes: &[Code], fps: f64) -> Vec<Features> {
        let decode = || numbers(&self.decoded_tensor(&tensor(codes)?, fps)?);
        if codes.is_empty() { Vec::new() } else { decode().expect(SHAPES) }
    }

    /// The gradient by the codes of a function whose gradient by the decoded features is `by_features`: the transposed
    /// Jacobian of the decoder times it.
    pub fn pulled_back(&self, codes: &[Code], by_features: &[Features], fps: f64) -> Vec<Code> {
        let pull_back = || {
            let codes = Var::from_tensor(&tensor(codes)?)?;
            let weighted = self.decoded_tensor(codes.as_tensor(), fps)?.mul(&tensor(by_features)?)?.sum_all()?;
            numbers(weighted.backward()?.get(&codes).unwrap_or(&codes.zeros_like()?))
        };
        if codes.is_empty() { Vec::new() } else { pull_back().expect(SHAPES) }
    }

    /// A motion that was encoded and decoded; joints that the prior does not describe as given.
    pub fn reconstructed(&self, rotations: &[LocalRotations], fps: f64) -> Vec<LocalRotations> {
        let decoded = self.decoded(&self.encoded(rotations, fps), fps);
        let with_own = |(given, features): (&LocalRotations, Features)| {
            let mut found = *given;
            self.chart().write(&features, &mut found);
            found
        };
        rotations.iter().zip(decoded).map(with_own).collect()
    }

    /// The features of a motion that went through the skip connections alone, frame by frame.
    pub fn linearly_reconstructed(&self, rotations: &[LocalRotations]) -> Vec<Features> {
        let reconstruct = || {
            let features = rows(&self.chart().features_of_take(rotations));
            let features = Tensor::from_vec(features, (rotations.len(), N_FEATURES), &Device::Cpu)?;
            numbers(&self.vae.decoded_frames(&self.vae.encoded_frames(&features)?)?)
        };
        reconstruct().expect(SHAPES)
    }

    /// `[T, 32]` to `[T, 57]`.
    fn decoded_tensor(&self, codes: &Tensor, fps: f64) -> Result<Tensor> {
        let windows = TimeWindows::new(codes.dim(0)?, fps)?;
        let residual = windows.joined(&self.vae.decoder_residual(&windows.split(codes)?)?)?;
        self.vae.decoded_frames(codes)? + residual
    }
}

/// Frames as a tensor in single precision. [T, N]
fn tensor<const N: usize>(frames: &[[f64; N]]) -> Result<Tensor> {
    let values = frames.iter().flatten().map(|x| *x as f32).collect::<Vec<_>>();
    Tensor::from_vec(values, (frames.len(), N), &Device::Cpu)
}

/// The rows of a tensor `[T, N]`.
fn numbers<const N: usize>(tensor: &Tensor) -> Result<Vec<[f64; N]>> {
    let row = |row: &Vec<f32>| std::array::from_fn(|i| f64::from(row[i]));
    Ok(tensor.to_vec2::<f32>()?.iter().map(row).collect())
}
