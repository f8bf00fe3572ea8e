//! The trained prior and its operations, for takes of any length.

use super::basis::{Basis, LATENT_DIM};
use super::chart::{Chart, LATENT_JOINTS, LocalRotations, N_FEATURES, OUTSIDE_JOINTS};
use super::checkpoint::{Checkpoint, CheckpointError, Provenance, checkpoint_from_bytes};
use super::dataset::GRID_FPS;
use super::encoder_input::EncoderInput;
use super::fusion::BlendingFactors;
use super::interpolation::{grid_place, interpolate, resampled_len};
use super::joints::{frame, rows};
use super::paths::Observed;
use super::shape::VaeShape;
use super::vae::Vae;
use super::windows::window_batches;
use crate::body::skeleton::N_JOINTS;
use std::sync::OnceLock;

/// The embedded weights; their model card is `assets/motion-prior-v1.md`.
const WEIGHTS: &[u8] = include_bytes!("../../assets/motion-prior-v1.bin");

/// A trained prior over motions on the 30 Hz grid.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionPrior {
    shape: VaeShape,
    provenance: Provenance,
    basis: Basis,
    vae: Vae,
}

/// The encoder's posterior of one take.
#[derive(Debug, Clone, PartialEq)]
pub struct Posterior {
    /// Mean of z, `[T, 32]`.
    pub mean: Vec<f32>,
    /// Logarithm of its variance, `[T, 32]`.
    pub log_variance: Vec<f32>,
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
    /// [`CheckpointError`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CheckpointError> {
        Ok(Self::new(checkpoint_from_bytes(bytes)?))
    }

    /// A prior from a checkpoint.
    pub fn new(checkpoint: Checkpoint) -> Self {
        let Checkpoint { shape, provenance, basis, parameters } = checkpoint;
        Self { shape, provenance, vae: Vae::new(shape, &basis, &parameters), basis }
    }

    /// Origin of the weights.
    pub fn provenance(&self) -> &Provenance {
        &self.provenance
    }

    /// The frozen basis.
    pub fn basis(&self) -> &Basis {
        &self.basis
    }

    /// The chart of the features.
    pub fn chart(&self) -> &Chart {
        &self.basis.chart
    }

    /// Encodes takes of any length; completes unseen joints and removes noise.
    pub fn encode(&self, takes: &[Observed]) -> Vec<Posterior> {
        let inputs: Vec<EncoderInput> = takes.iter().map(|take| self.shape.input(&self.basis, take)).collect();
        let values: Vec<&[f32]> = inputs.iter().map(|input| input.values.as_slice()).collect();
        let lengths: Vec<usize> = takes.iter().map(Observed::n_frames).collect();
        let (n_in, n_head) = (self.shape.encoder().n_in, self.shape.encoder().n_out);
        let mut heads: Vec<Vec<f32>> = lengths.iter().map(|n| vec![0.0; n * n_head]).collect();
        for batch in window_batches(&lengths) {
            let head = self.vae.head(&batch.cut(&values, n_in), batch.len());
            batch.blend(&head, n_head, &mut heads);
        }
        let posterior = |(input, head): (&EncoderInput, &Vec<f32>)| {
            let [mean, log_variance] = self.vae.posterior(input, head);
            Posterior { mean, log_variance }
        };
        inputs.iter().zip(&heads).map(posterior).collect()
    }

    /// Decodes codes `[T, 32]`, each take of its own length, to features `[T, 57]`.
    pub fn decode(&self, codes: &[Vec<f32>]) -> Vec<Vec<f32>> {
        let views: Vec<&[f32]> = codes.iter().map(Vec::as_slice).collect();
        let lengths: Vec<usize> = codes.iter().map(|code| code.len() / LATENT_DIM).collect();
        let mut features: Vec<Vec<f32>> = lengths.iter().map(|n| vec![0.0; n * N_FEATURES]).collect();
        for batch in window_batches(&lengths) {
            let decoded = self.vae.decode(&batch.cut(&views, LATENT_DIM), batch.len(), BlendingFactors::SHIPPED);
            batch.blend(&decoded.features, N_FEATURES, &mut features);
        }
        features
    }

    /// Rotations of a take's features `[T, 57]`, on the prior's grid; joints outside the latent at rest.
    pub fn rotations(&self, features: &[f32]) -> Vec<LocalRotations> {
        features.chunks_exact(N_FEATURES).map(|row| self.chart().rotations(&frame(row))).collect()
    }

    /// Rotations of a take at `fps` after encoder and decoder: unseen joints completed, noise removed.
    ///
    /// `seen`: for every frame and joint in SMPL's order whether its rotation is known; `None`: all are. Pelvis, collars
    /// and hands are returned unchanged.
    pub fn reconstructed(
        &self,
        take: &[LocalRotations],
        seen: Option<&[[bool; N_JOINTS]]>,
        fps: f64,
    ) -> Vec<LocalRotations> {
        if take.is_empty() {
            return Vec::new();
        }
        let observed = self.observed(take, seen, fps);
        let codes: Vec<Vec<f32>> = self.encode(&[observed]).into_iter().map(|posterior| posterior.mean).collect();
        let features = &self.decode(&codes)[0];
        let grid: Vec<LocalRotations> = self.rotations(features);
        let at_frame = |(f, given): (usize, &LocalRotations)| {
            let place = grid_place(f as f64 * GRID_FPS / fps, grid.len());
            std::array::from_fn(|j| {
                if j == 0 || OUTSIDE_JOINTS.contains(&j) {
                    return given[j];
                }
                interpolate(&place.samples.map(|s| grid[s][j]), place.share)
            })
        };
        take.iter().enumerate().map(at_frame).collect()
    }

    /// A take at `fps` on the 30 Hz grid. A joint is seen where it is seen in both neighbouring frames; if it is unseen in
    /// one of the outer two frames of the cubic, that frame is replaced by its neighbour. A grid sample less than one frame
    /// after the take's end repeats the last frame.
    pub fn observed(&self, take: &[LocalRotations], seen: Option<&[[bool; N_JOINTS]]>, fps: f64) -> Observed {
        let is_seen = |frame: usize, joint: usize| seen.is_none_or(|seen| seen[frame][joint]);
        let n_samples = resampled_len(take.len(), fps, GRID_FPS);
        let ends_before = (n_samples as f64 - 1.0) * fps / GRID_FPS < take.len() as f64 - 1.0 - 1e-6;
        let n_samples = n_samples + usize::from(ends_before);
        let mut grid = Vec::with_capacity(n_samples);
        let mut flags = Vec::with_capacity(n_samples * LATENT_JOINTS.len());
        for i in 0..n_samples {
            let place = grid_place(i as f64 * fps / GRID_FPS, take.len());
            let known = |joint: usize| {
                let [mut before, first, second, mut after] = place.samples;
                before = if is_seen(before, joint) { before } else { first };
                after = if is_seen(after, joint) { after } else { second };
                [before, first, second, after]
            };
            grid.push(std::array::from_fn(|j| interpolate(&known(j).map(|s| take[s][j]), place.share)));
            flags.extend(LATENT_JOINTS.iter().map(|joint| {
                let [_, first, second, _] = place.samples;
                (place.share > 0.999 || is_seen(first, *joint)) && (place.share < 0.001 || is_seen(second, *joint))
            }));
        }
        Observed { features: rows(&self.chart().features_of_take(&grid)), seen: flags }
    }
}
