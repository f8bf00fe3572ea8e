//! Motions drawn from the linear code or the autoencoder: random poses that change smoothly.

use super::basis::LATENT_DIM;
use super::chart::{LocalRotations, N_FEATURES};
use super::dataset::GRID_FPS;
use super::joints::frame;
use super::latent_prior::Code;
use super::{LatentPrior, MotionPrior};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

impl MotionPrior {
    /// A motion of `n_frames` at 30 Hz: a code from N(0, I), smoothed in time, decoded to poses. The pelvis, the collars and
    /// the hands are at identity.
    pub fn drawn(&self, n_frames: usize, seed: u64) -> Vec<LocalRotations> {
        let codes = smooth_code(n_frames, &mut ChaCha8Rng::seed_from_u64(seed));
        let features = self.basis().features(&codes);
        features.chunks_exact(N_FEATURES).map(|row| self.chart().rotations(&frame(row))).collect()
    }
}

impl LatentPrior {
    /// The same, decoded by the network.
    pub fn drawn(&self, n_frames: usize, seed: u64) -> Vec<LocalRotations> {
        let codes = smooth_code(n_frames, &mut ChaCha8Rng::seed_from_u64(seed));
        let code = |row: &[f32]| -> Code { std::array::from_fn(|k| f64::from(row[k])) };
        let codes: Vec<Code> = codes.chunks_exact(LATENT_DIM).map(code).collect();
        self.decoded(&codes, GRID_FPS).iter().map(|features| self.chart().rotations(features)).collect()
    }
}

/// Standard deviation of the kernel that smooths a random code, frames: 0.17 s.
const SMOOTH_FRAMES: f64 = 5.0;

/// A code from N(0, I), smoothed in time by a Gaussian kernel and scaled back to variance 1, `[T, 32]`.
fn smooth_code(n_frames: usize, rng: &mut ChaCha8Rng) -> Vec<f32> {
    let reach = (3.0 * SMOOTH_FRAMES) as usize;
    let kernel: Vec<f64> =
        (0..=2 * reach).map(|k| (-0.5 * ((k as f64 - reach as f64) / SMOOTH_FRAMES).powi(2)).exp()).collect();
    let norm = kernel.iter().map(|k| k * k).sum::<f64>().sqrt();
    let white: Vec<f64> = (0..(n_frames + 2 * reach) * LATENT_DIM).map(|_| rng.sample(StandardNormal)).collect();
    let entry = |t: usize, d: usize| {
        kernel.iter().enumerate().map(|(k, weight)| weight * white[(t + k) * LATENT_DIM + d]).sum::<f64>() / norm
    };
    (0..n_frames * LATENT_DIM).map(|i| entry(i / LATENT_DIM, i % LATENT_DIM) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smooth_codes_have_variance_one_and_small_steps() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let code = smooth_code(2000, &mut rng);
        let square = code.iter().map(|z| f64::from(z * z)).sum::<f64>() / code.len() as f64;
        // Some 2000 / 18 independent stretches of 32 numbers: known to 2.4 %.
        assert!((square - 1.0).abs() < 0.1);
        let step = (LATENT_DIM..code.len()).map(|i| (code[i] - code[i - LATENT_DIM]).abs()).fold(0.0, f32::max);
        assert!(step < 0.8);
    }

    #[test]
    fn drawn_motions_depend_on_their_seed_alone() {
        let prior = MotionPrior::embedded();
        assert_eq!(prior.drawn(40, 1), prior.drawn(40, 1));
        assert_ne!(prior.drawn(40, 1), prior.drawn(40, 2));
        assert_eq!(prior.drawn(0, 1).len(), 0);
    }
}
