//! Flips: left and right exchanged in the whole body, the legs or the arms of one detection.

use crate::body::detector_noise::DetectorNoise;
use crate::body::skeleton::KeypointConvention;
use crate::geometry::projection::NormalizedProjection;
use crate::matching::consistency::{PosedDetection, physics_affinity};
use crate::session::Keypoint;

/// Index of the flip that changes nothing.
pub(super) const UNCHANGED: usize = 0;

/// A permutation of keypoints.
pub(super) struct Flip {
    /// For every keypoint of the body the index of the detection's keypoint that shows it.
    pub order: Vec<usize>,
}

/// Keypoints of legs and of arms, by the end of their names.
const LEGS: [&str; 6] = ["hip", "knee", "ankle", "toe", "heel", "foot_index"];
const ARMS: [&str; 7] = ["shoulder", "elbow", "wrist", "thumb", "pinky", "index", "hand"];

/// Smallest rise of the agreement for a flip: a third of the difference between the right person and another one. A person
/// seen from the side fits both ways almost equally well and is not flipped.
const MIN_RISE: f64 = 0.12;

/// All candidates: unchanged, whole body, legs, arms.
pub(super) fn flips(convention: KeypointConvention) -> Vec<Flip> {
    let (names, mirror) = (convention.names(), convention.mirror());
    let flipped = |parts: Option<&[&str]>| {
        let is_part = |k: usize| parts.is_none_or(|parts| parts.iter().any(|part| names[k].ends_with(part)));
        Flip { order: (0..names.len()).map(|k| if is_part(k) { mirror[k] } else { k }).collect() }
    };
    vec![Flip { order: (0..names.len()).collect() }, flipped(None), flipped(Some(&LEGS)), flipped(Some(&ARMS))]
}

impl Flip {
    /// Permutes the keypoints of a detection.
    pub(super) fn apply(&self, keypoints: &mut [Keypoint]) {
        let before = keypoints.to_vec();
        for (k, &from) in self.order.iter().enumerate() {
            keypoints[k] = before[from];
        }
    }
}

/// Index of the flip that agrees best with the person's expected points; 0 where none is clearly better than no flip.
pub(super) fn best(
    flips: &[Flip],
    noise: &DetectorNoise,
    seen: &PosedDetection,
    expected: &[Option<NormalizedProjection>],
) -> usize {
    let agreement =
        |flip: &Flip| physics_affinity(seen, expected, noise, &flip.order).map_or(0.0, |agreement| agreement.affinity);
    let unchanged = agreement(&flips[0]);
    let others = flips.iter().enumerate().skip(1).map(|(i, flip)| (agreement(flip), i));
    match others.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1))) {
        Some((flipped, i)) if flipped > unchanged + MIN_RISE => i,
        _ => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    #[test]
    fn a_flip_is_its_own_inverse_and_moves_only_its_part() {
        let convention = KeypointConvention::Body25;
        let names = convention.names();
        let keypoint = |k: usize| Keypoint::new(Vector2::new(k as f64, 0.0), 1.0);
        let before: Vec<Keypoint> = (0..names.len()).map(keypoint).collect();
        for (i, flip) in flips(convention).iter().enumerate() {
            let mut keypoints = before.clone();
            flip.apply(&mut keypoints);
            let moved: Vec<&str> = (0..names.len()).filter(|&k| keypoints[k] != before[k]).map(|k| names[k]).collect();
            assert_eq!(moved.len(), [0, 22, 12, 6][i], "{moved:?}");
            flip.apply(&mut keypoints);
            assert_eq!(keypoints, before);
        }
    }
}
