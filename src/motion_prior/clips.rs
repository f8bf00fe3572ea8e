//! Data of a training step: clips of takes at a random tempo, and smooth random codes.

use super::basis::LATENT_DIM;
use super::chart::N_FEATURES;
use super::paths::Observed;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// A clip of a take and its corrupted version.
pub(crate) struct Clip {
    /// True features, `[T, 57]`.
    pub(crate) truth: Vec<f32>,
    /// The same, corrupted.
    pub(crate) observed: Observed,
}

/// Tempo relative to the take.
const TEMPO: std::ops::Range<f64> = 0.7..1.4;

/// A clip of `length` frames from a random start: every frame of every take is an equally likely start. The tempo is
/// random where the take is long enough. At least one take must have `length` frames.
pub(crate) fn draw_clip(takes: &[Vec<f32>], length: usize, rng: &mut ChaCha8Rng) -> Vec<f32> {
    let starts = |take: &Vec<f32>| (take.len() / N_FEATURES + 1).saturating_sub(length);
    let mut start = rng.random_range(0..takes.iter().map(starts).sum::<usize>().max(1));
    let Some(take) = takes.iter().find(|take| {
        let here = start < starts(take);
        start -= if here { 0 } else { starts(take) };
        here
    }) else {
        return vec![0.0; length * N_FEATURES];
    };
    let n_after = take.len() / N_FEATURES - 1 - start;
    let tempo = rng.random_range(TEMPO).min(n_after as f64 / (length - 1).max(1) as f64);
    let mut clip = Vec::with_capacity(length * N_FEATURES);
    for t in 0..length {
        let at = (t as f64 * tempo).min(n_after as f64);
        let first = (at as usize).min(n_after.saturating_sub(1));
        let share = (at - first as f64) as f32;
        let row = |frame: usize| &take[(start + frame.min(n_after)) * N_FEATURES..][..N_FEATURES];
        clip.extend(row(first).iter().zip(row(first + 1)).map(|(a, b)| a + share * (b - a)));
    }
    clip
}

/// Standard deviation of the kernel that smooths a random code, frames: 0.17 s.
const SMOOTH_FRAMES: f64 = 5.0;

/// A code from N(0, I), smoothed in time by a Gaussian kernel and scaled back to variance 1, `[T, 32]`.
pub(crate) fn smooth_code(n_frames: usize, rng: &mut ChaCha8Rng) -> Vec<f32> {
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
    use rand::SeedableRng;

    #[test]
    fn clips_have_their_length_and_lie_within_their_take() {
        let take: Vec<f32> = (0..40 * N_FEATURES).map(|i| (i / N_FEATURES) as f32).collect();
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        for _ in 0..200 {
            let clip = draw_clip(&[vec![0.0; 3 * N_FEATURES], take.clone()], 32, &mut rng);
            assert_eq!(clip.len(), 32 * N_FEATURES);
            let steps: Vec<f32> = (1..32).map(|t| clip[t * N_FEATURES] - clip[(t - 1) * N_FEATURES]).collect();
            assert!(steps.iter().all(|s| (0.69..1.41).contains(s)) && clip[31 * N_FEATURES] <= 39.0);
        }
    }

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
}
