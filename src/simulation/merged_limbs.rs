//! Limbs of two people who overlap in the image: a detection with one person's trunk and the other's arm or leg.

use super::config::SimulationConfig;
use super::projection::size_of;
use super::random::{Purpose, stream};
use super::real_noise::RealNoise;
use crate::body::skeleton::KeypointConvention;
use crate::session::{Detection, Keypoint};
use nalgebra::Vector2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Two people overlap if the middles of their trunks are nearer than this, of the size of one. Fitted.
const OVERLAP_OF_SIZE: f64 = 0.25;
const TRUNK: [&str; 4] = ["nose", "neck", "shoulder", "hip"];
const ARM: [&str; 6] = ["elbow", "wrist", "hand", "pinky", "index", "thumb"];
const LEG: [&str; 5] = ["knee", "ankle", "foot", "toe", "heel"];

/// Merges limbs of the detections of a view.
pub(super) struct LimbMerging {
    rng: ChaCha8Rng,
    rate: f64,
    trunk: Vec<usize>,
    /// Keypoints of the arms and legs below the trunk.
    limbs: [Vec<usize>; 4],
}

impl LimbMerging {
    pub(super) fn new(real: RealNoise, view: usize, config: &SimulationConfig) -> Self {
        let keypoints = |side: &str, parts: &[&str]| keypoints_of(config.convention, side, parts);
        Self {
            rng: stream(config.seed, Purpose::MergedLimbs, view, 0),
            rate: real.merged_limb_rate,
            trunk: keypoints("", &TRUNK),
            limbs: [
                keypoints("left_", &ARM),
                keypoints("right_", &ARM),
                keypoints("left_", &LEG),
                keypoints("right_", &LEG),
            ],
        }
    }

    /// Lets detections that overlap report a limb of the other; returns the number of limbs.
    pub(super) fn merge(&mut self, detections: &mut [Detection]) -> usize {
        let mut n = 0;
        for second in 1..detections.len() {
            for first in 0..second {
                let pair = if self.rng.random::<bool>() { (first, second) } else { (second, first) };
                if self.overlap(&detections[pair.0].keypoints, &detections[pair.1].keypoints)
                    && self.rng.random::<f64>() < self.rate
                {
                    self.copy_limb(detections, pair);
                    n += 1;
                }
            }
        }
        n
    }

    fn overlap(&self, a: &[Keypoint], b: &[Keypoint]) -> bool {
        let size = size_of(a.iter().filter(|keypoint| keypoint.is_present()).map(|keypoint| keypoint.pixel));
        let middles = self.middle_of_trunk(a).zip(self.middle_of_trunk(b));
        middles.is_some_and(|(a, b)| (a - b).norm() < OVERLAP_OF_SIZE * size)
    }

    fn middle_of_trunk(&self, keypoints: &[Keypoint]) -> Option<Vector2<f64>> {
        let present: Vec<Vector2<f64>> =
            self.trunk.iter().filter(|&&k| keypoints[k].is_present()).map(|&k| keypoints[k].pixel).collect();
        (!present.is_empty()).then(|| present.iter().sum::<Vector2<f64>>() / present.len() as f64)
    }

    /// The first of the pair reports a random limb of the second, as far as that is reported.
    fn copy_limb(&mut self, detections: &mut [Detection], (to, from): (usize, usize)) {
        let limb = &self.limbs[self.rng.random_range(0..self.limbs.len())];
        for &k in limb {
            let keypoint = detections[from].keypoints[k];
            if keypoint.is_present() {
                detections[to].keypoints[k] = keypoint;
            }
        }
    }
}

fn keypoints_of(convention: KeypointConvention, side: &str, parts: &[&str]) -> Vec<usize> {
    let names = convention.names().iter().enumerate();
    let is_part = |name: &str| name.starts_with(side) && parts.iter().any(|part| name.contains(part));
    names.filter(|(_, name)| is_part(name)).map(|(k, _)| k).collect()
}
