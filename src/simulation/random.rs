//! Random streams keyed by purpose and item.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Purpose of a stream of random numbers; its index is part of the stream's key.
#[derive(Debug, Clone, Copy)]
pub(super) enum Purpose {
    Config,
    Body,
    Motion,
    Placement,
    Camera,
    Detector,
    Tracker,
    TrackNames,
    Joints,
    KeypointBias,
    Ghosts,
    MergedLimbs,
    Hand,
    Fingers,
    Wrists,
    Details,
    HandSwaps,
    Covariances,
}

/// The stream of one purpose and one item; `view` or `person` is 0 where the item has none.
pub(super) fn stream(seed: u64, purpose: Purpose, view: usize, person: usize) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream((purpose as u64) << 48 | (view as u64 & 0xff_ffff) << 24 | (person as u64 & 0xff_ffff));
    rng
}

/// A normally distributed number of mean 0 and standard deviation `sd`.
pub(super) fn normal(rng: &mut ChaCha8Rng, sd: f64) -> f64 {
    sd * rng.sample::<f64, _>(StandardNormal)
}
