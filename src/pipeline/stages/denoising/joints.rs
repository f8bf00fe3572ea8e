//! Single bad joints: one wrong wrist does not cost a detection, and does not stay.

use super::Ground;
use crate::geometry::projection::NormalizedProjection;
use crate::matching::consistency::{Seen, squared_misfit};

/// A keypoint further from the person's path than this is wrong: under Rayleigh's distribution one in 270,000 lies beyond
/// five standard deviations.
const MAX_SIGMAS: f64 = 5.0;

/// Views that must have seen the joint: with fewer nothing says which of them is wrong.
const MIN_VIEWS: u8 = 3;

/// Keypoints (after the flip) that contradict all other views.
pub(super) fn rejected(
    ground: &Ground,
    seen: &Seen,
    expected: &[Option<NormalizedProjection>],
    n_views: &[u8],
    flip: usize,
) -> Vec<usize> {
    let order = &ground.flips[flip].order;
    let is_wrong = |k: &usize| {
        let misfit = expected[*k].and_then(|point| squared_misfit(seen, order[*k], &point, ground.input.noise, *k));
        n_views[*k] >= MIN_VIEWS && misfit.is_some_and(|e2| e2 > MAX_SIGMAS * MAX_SIGMAS)
    };
    (0..expected.len()).filter(is_wrong).collect()
}
