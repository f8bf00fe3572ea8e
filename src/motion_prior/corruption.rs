//! Corruption of training clips: unseen joints and noise.

use super::chart::{LATENT_JOINTS, N_FEATURES};
use super::paths::Observed;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

const N_JOINTS: usize = LATENT_JOINTS.len();

/// The latent joints of each limb: legs, then arms, left before right.
pub const LIMBS: [&[usize]; 4] = [&[1, 4, 7, 10], &[2, 5, 8, 11], &[16, 18, 20], &[17, 19, 21]];

/// Corruption of a clip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Corruption {
    /// No corruption.
    None,
    /// All joints unseen for a while.
    Gap {
        /// First frame.
        start: usize,
        /// Number of frames.
        n_frames: usize,
    },
    /// One limb unseen for a while.
    Limb {
        /// Index in [`LIMBS`].
        limb: usize,
        /// First frame.
        start: usize,
        /// Number of frames.
        n_frames: usize,
    },
    /// Noisy rotations of random joints and frames (or of random joints in all frames); a fifth of the joints unseen for
    /// ten frames.
    Noise {
        /// Standard deviation per axis, rad.
        sd: f64,
        /// Probability of noise for a joint and frame.
        share: f64,
        /// Whether a noisy joint is noisy in every frame.
        steady: bool,
    },
}

/// Length of the gaps that come with noise, frames.
pub const HOLE_FRAMES: usize = 10;
/// Share of joints that have such a gap.
pub const HOLE_SHARE: f64 = 0.2;

/// A random corruption of a clip of `n_frames`: half of the clips train completion, a third denoising, the rest are clean.
pub(crate) fn random_corruption(n_frames: usize, rng: &mut ChaCha8Rng) -> Corruption {
    let kind: f64 = rng.random();
    let mut span = |low: usize, high: usize| {
        let n = rng.random_range(low..=high).min(n_frames / 2);
        (rng.random_range(0..=n_frames - n), n)
    };
    if kind < 0.15 {
        Corruption::None
    } else if kind < 0.35 {
        let (start, n_frames) = span(4, 30);
        Corruption::Gap { start, n_frames }
    } else if kind < 0.65 {
        let (start, n_frames) = span(20, 80);
        Corruption::Limb { limb: rng.random_range(0..LIMBS.len()), start, n_frames }
    } else {
        let sd = rng.random_range(2.0_f64..15.0).to_radians();
        Corruption::Noise { sd, share: rng.random_range(0.2..1.0), steady: rng.random_bool(0.5) }
    }
}

/// Applies a corruption to a clip `[T, 57]`. Noise is added to the features, whose small changes are right increments up to
/// a factor near 1.
pub(crate) fn corrupted(clip: &[f32], corruption: Corruption, rng: &mut ChaCha8Rng) -> Observed {
    let mut observed = Observed::complete(clip.to_vec());
    let n_total = observed.n_frames();
    match corruption {
        Corruption::None => {}
        Corruption::Gap { start, n_frames } => {
            observed.seen[start * N_JOINTS..(start + n_frames) * N_JOINTS].fill(false);
        }
        Corruption::Limb { limb, start, n_frames } => {
            for joint in LIMBS[limb] {
                hide(&mut observed, *joint, start, n_frames);
            }
        }
        Corruption::Noise { sd, share, steady } => {
            let noisy: [bool; N_JOINTS] = std::array::from_fn(|_| rng.random_bool(share));
            for row in observed.features.chunks_exact_mut(N_FEATURES) {
                for (joint, values) in row.chunks_exact_mut(3).enumerate() {
                    let hit = if steady { noisy[joint] } else { rng.random_bool(share) };
                    if hit {
                        values.iter_mut().for_each(|v| *v += (sd * rng.sample::<f64, _>(StandardNormal)) as f32);
                    }
                }
            }
            for joint in LATENT_JOINTS {
                if rng.random_bool(HOLE_SHARE) && n_total > HOLE_FRAMES {
                    let start = rng.random_range(0..=n_total - HOLE_FRAMES);
                    hide(&mut observed, joint, start, HOLE_FRAMES);
                }
            }
        }
    }
    observed
}

fn hide(observed: &mut Observed, joint: usize, start: usize, n_frames: usize) {
    if let Some(column) = LATENT_JOINTS.iter().position(|j| *j == joint) {
        (start..start + n_frames).for_each(|t| observed.seen[t * N_JOINTS + column] = false);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn corruption_changes_only_its_part() {
        let clip = vec![0.25; 50 * N_FEATURES];
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let gap = corrupted(&clip, Corruption::Gap { start: 10, n_frames: 15 }, &mut rng);
        assert_eq!(gap.seen.iter().filter(|seen| !**seen).count(), 15 * N_JOINTS);
        let limb = corrupted(&clip, Corruption::Limb { limb: 2, start: 0, n_frames: 50 }, &mut rng);
        assert_eq!(limb.seen.iter().filter(|seen| !**seen).count(), 50 * 3);
        assert_eq!(limb.features, clip);
        let noise = corrupted(&clip, Corruption::Noise { sd: 0.1, share: 1.0, steady: false }, &mut rng);
        let square: f32 = noise.features.iter().map(|v| (v - 0.25).powi(2)).sum::<f32>() / clip.len() as f32;
        // 2850 draws: the standard deviation is known to 1.4 %.
        assert!((square.sqrt() - 0.1).abs() < 0.006);
    }

    #[test]
    fn clips_of_any_length_can_be_corrupted() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for n in [1, 2, 9, 40] {
            let clip = vec![0.0; n * N_FEATURES];
            for _ in 0..50 {
                let corruption = random_corruption(n, &mut rng);
                assert_eq!(corrupted(&clip, corruption, &mut rng).n_frames(), n);
            }
        }
    }
}
