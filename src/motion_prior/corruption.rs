//! What training takes away from a clip: joints that nobody saw, and noise.

use super::chart::{LATENT_JOINTS, N_FEATURES};
use super::paths::Observed;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

const N_JOINTS: usize = LATENT_JOINTS.len();

/// The latent joints of each limb: legs, then arms, left before right.
pub const LIMBS: [&[usize]; 4] = [&[1, 4, 7, 10], &[2, 5, 8, 11], &[16, 18, 20], &[17, 19, 21]];

/// How a clip was damaged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Damage {
    /// Not at all.
    None,
    /// All joints unseen for a while.
    Gap {
        /// First frame.
        start: usize,
        /// How many.
        n_frames: usize,
    },
    /// One limb unseen for a while.
    Limb {
        /// Index in [`LIMBS`].
        limb: usize,
        /// First frame.
        start: usize,
        /// How many.
        n_frames: usize,
    },
    /// Rotations shaken: each joint and frame (or each joint throughout) with a chance; a fifth of the joints unseen
    /// for ten frames.
    Noise {
        /// Standard deviation per axis, rad.
        sd: f64,
        /// Chance of a joint and frame.
        share: f64,
        /// Whether a shaken joint is shaken in every frame.
        steady: bool,
    },
}

/// Length of the holes that come with noise, frames, and the share of joints that have one.
pub const HOLE_FRAMES: usize = 10;
/// See [`HOLE_FRAMES`].
pub const HOLE_SHARE: f64 = 0.2;

/// Draws what training does to a clip of `n_frames`: half of it completion, a third denoising, the rest left clean.
pub(crate) fn random_damage(n_frames: usize, rng: &mut ChaCha8Rng) -> Damage {
    let kind: f64 = rng.random();
    let mut span = |low: usize, high: usize| {
        let n = rng.random_range(low..=high).min(n_frames / 2);
        (rng.random_range(0..=n_frames - n), n)
    };
    if kind < 0.15 {
        Damage::None
    } else if kind < 0.35 {
        let (start, n_frames) = span(4, 30);
        Damage::Gap { start, n_frames }
    } else if kind < 0.65 {
        let (start, n_frames) = span(20, 80);
        Damage::Limb { limb: rng.random_range(0..LIMBS.len()), start, n_frames }
    } else {
        let sd = rng.random_range(2.0_f64..15.0).to_radians();
        Damage::Noise { sd, share: rng.random_range(0.2..1.0), steady: rng.random_bool(0.5) }
    }
}

/// Does it to a clip `[T, 57]`. Noise is added to the features, whose small changes are right increments but for a
/// factor near 1.
pub(crate) fn damaged(clip: &[f32], damage: Damage, rng: &mut ChaCha8Rng) -> Observed {
    let mut observed = Observed::complete(clip.to_vec());
    let n_total = observed.n_frames();
    match damage {
        Damage::None => {}
        Damage::Gap { start, n_frames } => {
            observed.seen[start * N_JOINTS..(start + n_frames) * N_JOINTS].fill(false);
        }
        Damage::Limb { limb, start, n_frames } => {
            for joint in LIMBS[limb] {
                hide(&mut observed, *joint, start, n_frames);
            }
        }
        Damage::Noise { sd, share, steady } => {
            let shaken: [bool; N_JOINTS] = std::array::from_fn(|_| rng.random_bool(share));
            for row in observed.features.chunks_exact_mut(N_FEATURES) {
                for (joint, values) in row.chunks_exact_mut(3).enumerate() {
                    let hit = if steady { shaken[joint] } else { rng.random_bool(share) };
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
    fn damage_hides_what_it_says_and_leaves_the_rest() {
        let clip = vec![0.25; 50 * N_FEATURES];
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let gap = damaged(&clip, Damage::Gap { start: 10, n_frames: 15 }, &mut rng);
        assert_eq!(gap.seen.iter().filter(|seen| !**seen).count(), 15 * N_JOINTS);
        let limb = damaged(&clip, Damage::Limb { limb: 2, start: 0, n_frames: 50 }, &mut rng);
        assert_eq!(limb.seen.iter().filter(|seen| !**seen).count(), 50 * 3);
        assert_eq!(limb.features, clip);
        let noise = damaged(&clip, Damage::Noise { sd: 0.1, share: 1.0, steady: false }, &mut rng);
        let square: f32 = noise.features.iter().map(|v| (v - 0.25).powi(2)).sum::<f32>() / clip.len() as f32;
        // 2850 draws: the standard deviation is known to 1.4 %.
        assert!((square.sqrt() - 0.1).abs() < 0.006);
    }

    #[test]
    fn clips_of_any_length_can_be_damaged() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for n in [1, 2, 9, 40] {
            let clip = vec![0.0; n * N_FEATURES];
            for _ in 0..50 {
                let damage = random_damage(n, &mut rng);
                assert_eq!(damaged(&clip, damage, &mut rng).n_frames(), n);
            }
        }
    }
}
