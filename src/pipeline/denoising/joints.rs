//! Single bad joints: one wrong wrist does not cost a detection, and does not stay.

use super::Ground;
use crate::matching::consistency::{Seen, misfit};
use nalgebra::Vector3;

/// A keypoint further from the person's path than this is wrong: under Rayleigh's distribution one in 270,000 lies beyond
/// five standard deviations.
const MAX_SIGMAS: f64 = 5.0;

/// Views that must have seen the joint: with fewer nothing says which of them is wrong.
const MIN_VIEWS: u8 = 3;

/// Keypoints (after the flip) that contradict all other views.
pub(super) fn rejected(
    ground: &Ground,
    seen: Seen,
    points: &[Option<Vector3<f64>>],
    n_views: &[u8],
    flip: usize,
) -> Vec<usize> {
    let order = &ground.flips[flip].order;
    let is_wrong = |k: &usize| {
        let distance = points[*k].and_then(|point| misfit(seen, order[*k], &point, ground.input.noise, *k));
        n_views[*k] >= MIN_VIEWS && distance.is_some_and(|e| e > MAX_SIGMAS)
    };
    (0..points.len()).filter(is_wrong).collect()
}
