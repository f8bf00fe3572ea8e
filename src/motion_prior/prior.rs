//! The trained prior and its operations.

use super::basis::Basis;
use super::bridge::{DECAY_FRAMES, bridge};
use super::chart::{Chart, Features, LocalRotations};
use super::denoiser::Denoiser;
use super::denoiser_input::{DenoiserInput, N_INPUT, denoiser_input, expected_errors};
use super::joints::frame;
use super::observed::{DESCRIBED_JOINTS, N_DESCRIBED, ObservedMotion};
use super::weights::{NetworkKind, Provenance, Weights, WeightsError};
use crate::geometry::rotation::{exp, right_jacobian_inverse};
use candle_core::{Device, Tensor};
use nalgebra::{Matrix3, Vector3};
use std::sync::OnceLock;

/// The embedded weights; their model card is `assets/motion-prior-v2.md`.
const WEIGHTS: &[u8] = include_bytes!("../../assets/motion-prior-v2.safetensors");

/// Share of the network's corrections that is kept. It learns from recordings; joints that a fit has found are off by some degrees, and
/// what follows from them overshoots. Hidden joints in 240 gaps of 30 fits, which the bridge makes 48.3 mm off, are 46.9 off with
/// all of the corrections, 46.4 with 0.7, 46.5 with half.
const KEPT: f64 = 0.6;

/// A trained prior over motions on the 30 Hz grid.
#[derive(Debug, Clone)]
pub struct MotionPrior {
    provenance: Provenance,
    basis: Basis,
    denoiser: Denoiser,
}

/// What the denoiser states about a motion.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Completion {
    /// Mean rotations; joints that the denoiser does not describe as given.
    pub rotations: Vec<LocalRotations>,
    /// Inverse covariance of each described joint's right increment about its mean, rad^-2.
    pub precision: Vec<[Matrix3<f64>; N_DESCRIBED]>,
}

impl MotionPrior {
    /// The prior embedded in the binary.
    pub fn embedded() -> &'static Self {
        static PRIOR: OnceLock<MotionPrior> = OnceLock::new();
        PRIOR.get_or_init(|| Self::from_bytes(WEIGHTS).expect("the embedded file is a prior; a test loads it"))
    }

    /// A prior from the bytes of its file.
    ///
    /// # Errors
    /// [`WeightsError`] names what is wrong.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, WeightsError> {
        Self::new(Weights::from_bytes(bytes)?)
    }

    /// A prior from its weights.
    ///
    /// # Errors
    /// A variable of the network is missing or has another shape.
    pub fn new(weights: Weights) -> Result<Self, WeightsError> {
        let denoiser = Denoiser::new(weights.provenance.width, weights.variables(NetworkKind::Denoiser)?)?;
        Ok(Self { denoiser, provenance: weights.provenance, basis: weights.basis })
    }

    /// Origin of the weights.
    pub fn provenance(&self) -> &Provenance {
        &self.provenance
    }

    /// The linear code of single poses.
    pub fn basis(&self) -> &Basis {
        &self.basis
    }

    /// The chart of the linear code's features.
    pub fn chart(&self) -> &Chart {
        &self.basis.chart
    }

    /// The mean pose: rotations of joints that are never seen.
    pub fn mean_pose(&self) -> LocalRotations {
        let mean: Features = frame(&self.basis.mean);
        self.chart().rotations(&mean)
    }

    /// Bridges the gaps of a motion at 30 Hz. The covariances are those of a bridge's usual error, the same about all axes.
    pub fn bridged(&self, motion: &ObservedMotion) -> Completion {
        let bridged = bridge(motion, &self.mean_pose(), DECAY_FRAMES);
        let of_joint = |unit: &f32| Matrix3::identity() / f64::from(unit * unit);
        let of_frame = |row: &[f32]| std::array::from_fn(|described| of_joint(&row[described]));
        let precision = expected_errors(motion, &bridged).chunks_exact(N_DESCRIBED).map(of_frame).collect();
        Completion { precision, rotations: bridged.rotations }
    }

    /// Completes and denoises a motion at 30 Hz of any length. A frame's result depends on the 36 frames around it, and on
    /// the edges of the gaps in them.
    ///
    /// # Panics
    /// Never for weights that [`Self::new`] accepted: the network's shapes are fixed.
    pub fn completed(&self, motion: &ObservedMotion) -> Completion {
        if motion.n_frames() == 0 {
            return Completion::default();
        }
        let input = denoiser_input(motion, &self.mean_pose());
        self.stated(&input).expect("the shapes of input and network agree")
    }

    fn stated(&self, input: &DenoiserInput) -> candle_core::Result<Completion> {
        let n_frames = input.bridged.pelvis.len();
        let values = Tensor::from_slice(&input.values, (1, n_frames, N_INPUT), &Device::Cpu)?;
        let stated = self.denoiser.forward(&values)?;
        let rows = |tensor: &Tensor| tensor.contiguous()?.flatten_all()?.to_vec1::<f32>();
        let [correction, diagonal, below] = [&stated.correction, &stated.log_diagonal, &stated.below].map(rows);
        let (correction, diagonal, below) = (correction?, diagonal?, below?);

        let mut rotations = input.bridged.rotations.clone();
        let mut precision = vec![[Matrix3::zeros(); N_DESCRIBED]; n_frames];
        for (t, frame) in rotations.iter_mut().enumerate() {
            for (described, &joint) in DESCRIBED_JOINTS.iter().enumerate() {
                let row = t * N_DESCRIBED + described;
                let unit = f64::from(input.units[row]);
                let off = three(&correction, row) * (unit * KEPT);
                frame[joint] *= exp(&off);
                let factor = factor(&three(&diagonal, row), &three(&below, row)) * right_jacobian_inverse(&off);
                precision[t][described] = factor.tr_mul(&factor) / (unit * unit * self.provenance.temperature);
            }
        }
        Ok(Completion { rotations, precision })
    }
}

/// Row `i` of rows of three.
fn three(values: &[f32], i: usize) -> Vector3<f64> {
    Vector3::from_fn(|axis, _| f64::from(values[3 * i + axis]))
}

/// The lower triangular factor L of a precision `L^T L`: its rows are those of a unit triangle times the diagonal.
fn factor(log_diagonal: &Vector3<f64>, below: &Vector3<f64>) -> Matrix3<f64> {
    let unit = Matrix3::new(1.0, 0.0, 0.0, below.x, 1.0, 0.0, below.y, below.z, 1.0);
    Matrix3::from_diagonal(&log_diagonal.map(f64::exp)) * unit
}
