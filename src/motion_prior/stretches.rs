//! Stretches of recorded takes for training, each from its own random stream.

use super::dataset::{Take, mirrored, mirrored_path};
use super::objective::TrueMotion;
use crate::geometry::rotation::{exp, log};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Tempo relative to the take.
const TEMPO: std::ops::Range<f64> = 0.7..1.4;

/// Random streams of a step, one for each of its motions.
pub(super) const MAX_MOTIONS: usize = 64;

/// Where the motions of a training come from.
pub(super) struct Stretches<'a> {
    pub takes: &'a [&'a Take],
    pub seed: u64,
}

impl Stretches<'_> {
    /// The random stream of a motion of a step.
    pub(super) fn stream(&self, step: usize, place: usize) -> ChaCha8Rng {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(1 + (step * MAX_MOTIONS + place) as u64);
        rng
    }

    /// A stretch of a take at a random tempo, half of them as mirror images. Every frame is an equally likely start.
    pub(super) fn draw(&self, n_frames: usize, rng: &mut ChaCha8Rng) -> TrueMotion {
        let starts = |take: &&Take| (take.rotations.len() + 1).saturating_sub(n_frames);
        let mut start = rng.random_range(0..self.takes.iter().map(starts).sum::<usize>().max(1));
        let Some(take) = self.takes.iter().find(|take| {
            let here = start < starts(take);
            start -= if here { 0 } else { starts(take) };
            here
        }) else {
            unreachable!("one take is as long as the longest motion");
        };
        let n_after = (take.rotations.len() - 1 - start) as f64;
        let tempo = rng.random_range(TEMPO).min(n_after / (n_frames - 1) as f64);
        let mut motion = TrueMotion { rotations: vec![], pelvis: vec![], contacts: vec![] };
        for t in 0..n_frames {
            let at = start as f64 + (t as f64 * tempo).min(n_after);
            let (first, next, share) = (at.floor() as usize, at.ceil() as usize, at.fract());
            let between = |joint: usize| {
                let from = take.rotations[first][joint];
                from * exp(&(log(&(from.transpose() * take.rotations[next][joint])) * share))
            };
            motion.rotations.push(std::array::from_fn(between));
            motion.pelvis.push(take.pelvis[first].lerp(&take.pelvis[next], share));
            motion.contacts.push(take.contacts[first]);
        }
        if rng.random_bool(0.5) {
            motion.rotations = mirrored(&motion.rotations);
            motion.pelvis = mirrored_path(&motion.pelvis);
            motion.contacts.iter_mut().for_each(|feet| feet.swap(0, 1));
        }
        motion
    }
}
