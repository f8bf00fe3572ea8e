//! The training objective of the autoencoder, the paper's `L_vae` (Eq. 6).
//!
//! Per frame `L_6d + L_v + 0.05 KL(q(z | X) || N(0, I)) + 0.05 |z_{t+1} - 2 z_t + z_{t-1}|^2` (Eqs. 7, 8, 9 and 11); `L_reg`
//! (Eq. 10) is the optimiser's weight decay. In place of squares stand Charbonnier costs `sqrt(1 + |e|^2 / s^2) - 1`, of each joint's rotation for `L_6d`, and
//! of the joints' positions and velocities for `L_v`, to first order in the error of the features.

use super::basis::LATENT_DIM;
use super::chart::{Chart, LATENT_JOINTS, N_FEATURES};
use super::joints::{Bones, rows};
use super::objective::{TrueMotion, levers};
use super::observed::N_DESCRIBED;
use super::vae::{Posterior, Vae};
use crate::body::skeleton::N_JOINTS;
use candle_core::{D, Device, Result, Tensor};
use nalgebra::Vector3;

/// Errors at which a cost changes from a square to a distance: rotations, rad; joints, m; joints' velocities, m a frame.
const ROTATION_KNEE: f64 = 0.1;
const POSITION_KNEE: f64 = 0.015;
const VELOCITY_KNEE: f64 = 0.006;
/// Weight of the divergence: with 1 codes of small motions are noise alone.
const KL_WEIGHT: f64 = 0.05;
/// Weight of the local linear term.
const LINEAR_WEIGHT: f64 = 0.05;

/// Motions of equal length as tensors; B motions of T frames.
pub struct VaeBatch {
    /// `[T, B, 57]`
    features: Tensor,
    /// Derivatives of the joints by the features, `[T B, 69, 57]`.
    levers: Tensor,
    /// Normal numbers of the sampled codes, `[T, B, 32]`.
    noise: Tensor,
}

impl VaeBatch {
    /// Motions with `noise`, a normal number for each of their codes.
    ///
    /// # Errors
    /// The device has no memory left.
    pub fn new(bones: &Bones, chart: &Chart, motions: &[TrueMotion], noise: Vec<f32>, device: &Device) -> Result<Self> {
        let (n_batch, n_frames) = (motions.len(), motions.first().map_or(0, |motion| motion.rotations.len()));
        let (mut values, mut by_features) = (Vec::new(), Vec::new());
        for motion in motions {
            let features = chart.features_of_take(&motion.rotations);
            for (rotations, features) in motion.rotations.iter().zip(&features) {
                let mut from_mean = [Vector3::zeros(); N_DESCRIBED];
                for (own, feature) in from_mean[1..].iter_mut().zip(features.chunks_exact(3)) {
                    *own = Vector3::from_column_slice(feature);
                }
                by_features.extend(levers(bones, rotations, &from_mean));
            }
            values.extend(rows(&features));
        }
        let by_motion = Tensor::from_vec(values, (n_batch, n_frames, N_FEATURES), device)?;
        let n_coordinates = 3 * (N_JOINTS - 1);
        let levers = Tensor::from_vec(by_features, (n_batch, n_frames, n_coordinates, 3 * N_DESCRIBED), device)?;
        let levers = levers.narrow(3, 3, N_FEATURES)?.transpose(0, 1)?.contiguous()?;
        Ok(Self {
            features: by_motion.transpose(0, 1)?.contiguous()?,
            levers: levers.reshape((n_frames * n_batch, n_coordinates, N_FEATURES))?,
            noise: Tensor::from_vec(noise, (n_frames, n_batch, LATENT_DIM), device)?,
        })
    }

    /// The loss of a network, a mean over frames.
    ///
    /// # Errors
    /// Shapes differ.
    pub fn loss(&self, vae: &Vae) -> Result<Tensor> {
        let posterior = vae.posterior(&self.features)?;
        let codes = (&posterior.mean + (&posterior.log_variance * 0.5)?.exp()?.mul(&self.noise)?)?;
        let errors = (vae.decoded(&codes)? - &self.features)?; // [T, B, 57]
        let (n_frames, n_batch, _) = errors.dims3()?;
        let joints = self.levers.matmul(&errors.reshape((n_frames * n_batch, N_FEATURES, 1))?)?;
        let joints = joints.reshape((n_frames, n_batch, N_JOINTS - 1, 3))?;
        let velocities = (joints.narrow(0, 1, n_frames - 1)? - joints.narrow(0, 0, n_frames - 1)?)?;
        let rotations = charbonnier(&errors.reshape((n_frames, n_batch, LATENT_JOINTS.len(), 3))?, ROTATION_KNEE)?;
        let reconstruction =
            ((rotations + charbonnier(&joints, POSITION_KNEE)?)? + charbonnier(&velocities, VELOCITY_KNEE)?)?;
        (reconstruction + (divergence(&posterior)? * KL_WEIGHT)?)? + (bend(&posterior.mean)? * LINEAR_WEIGHT)?
    }
}

/// The costs of errors `[T, B, J, 3]`, summed over joints.
fn charbonnier(errors: &Tensor, knee: f64) -> Result<Tensor> {
    let squares = (errors.sqr()?.sum(D::Minus1)? * knee.powi(-2))?;
    ((squares + 1.0)?.sqrt()? - 1.0)?.sum(D::Minus1)?.mean_all()
}

/// The divergence (Eq. 9) `KL(q || N(0, I)) = sum (m^2 + s^2 - 1 - log s^2) / 2`.
fn divergence(q: &Posterior) -> Result<Tensor> {
    let variance = q.log_variance.exp()?;
    let terms = (((q.mean.sqr()? + variance)? - 1.0)? - &q.log_variance)?;
    (terms.sum(D::Minus1)? * 0.5)?.mean_all()
}

/// The local linear term (Eq. 11) `|z_{t+1} - 2 z_t + z_{t-1}|^2`.
fn bend(codes: &Tensor) -> Result<Tensor> {
    let n = codes.dim(0)? - 2;
    let ends = (codes.narrow(0, 0, n)? + codes.narrow(0, 2, n)?)?;
    (ends - (codes.narrow(0, 1, n)? * 2.0)?)?.sqr()?.sum(D::Minus1)?.mean_all()
}
