//! Evaluation of the autoencoder: joints of recorded motions after encoding and decoding.

use super::basis::LATENT_DIM;
use super::chart::Features;
use super::dataset::{GRID_FPS, Take};
use super::joints::{Bones, JointPositions};
use super::latent_prior::LatentPrior;
use crate::body::skeleton::N_JOINTS;

/// Distances of the 23 joints from those of the recorded motion, pelvis at the origin, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointErrors {
    /// Mean over joints and frames.
    pub mean_mm: f64,
    /// 95 % quantile over joints and frames.
    pub p95_mm: f64,
    /// Root mean square second difference of the joints over that of the recorded motion.
    pub acceleration: f64,
}

/// Errors of an autoencoder on takes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReconstructionErrors {
    /// Of the network, from the encoder's mean.
    pub network: JointErrors,
    /// Of its skip connections alone: the linear code.
    pub linear: JointErrors,
    /// Mean square of the codes, 1 for N(0, I).
    pub mean_square: f64,
}

/// Encodes and decodes takes on the default body.
pub fn reconstruction_errors(prior: &LatentPrior, takes: &[&Take]) -> ReconstructionErrors {
    let (bones, chart) = (Bones::of_default_body(), prior.chart());
    let (mut network, mut linear) = (Measured::default(), Measured::default());
    let (mut squares, mut n_codes) = (0.0, 0);
    for take in takes {
        let truth: Vec<JointPositions> = take.rotations.iter().map(|frame| bones.posed(frame).joints).collect();
        let joints = |features: &[Features]| features.iter().map(|f| bones.joints(chart, f)).collect::<Vec<_>>();
        let codes = prior.encoded(&take.rotations, GRID_FPS);
        network.add(&truth, &joints(&prior.decoded(&codes, GRID_FPS)));
        linear.add(&truth, &joints(&prior.linearly_reconstructed(&take.rotations)));
        squares += codes.iter().flatten().map(|z| z * z).sum::<f64>();
        n_codes += codes.len() * LATENT_DIM;
    }
    ReconstructionErrors {
        network: network.errors(),
        linear: linear.errors(),
        mean_square: squares / n_codes.max(1) as f64,
    }
}

#[derive(Default)]
struct Measured {
    distances: Vec<f64>,
    accelerations: [f64; 2],
}

impl Measured {
    fn add(&mut self, truth: &[JointPositions], found: &[JointPositions]) {
        for (truth, found) in truth.iter().zip(found) {
            self.distances.extend((1..N_JOINTS).map(|j| 1e3 * (found[j] - truth[j]).norm()));
        }
        for (sum, path) in self.accelerations.iter_mut().zip([truth, found]) {
            let bend = |w: &[JointPositions; 3], j: usize| (w[2][j] - w[1][j] * 2.0 + w[0][j]).norm_squared();
            *sum += path.array_windows().flat_map(|w| (1..N_JOINTS).map(move |j| bend(w, j))).sum::<f64>();
        }
    }

    fn errors(mut self) -> JointErrors {
        self.distances.sort_by(f64::total_cmp);
        let n = self.distances.len();
        let [truth, found] = self.accelerations;
        JointErrors {
            mean_mm: self.distances.iter().sum::<f64>() / n.max(1) as f64,
            p95_mm: self.distances.get(n * 95 / 100).copied().unwrap_or(0.0),
            acceleration: (found / truth.max(f64::MIN_POSITIVE)).sqrt(),
        }
    }
}
