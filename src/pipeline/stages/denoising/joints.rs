//! Rejection of single keypoints: a wrong wrist is removed without rejecting the detection.

use crate::body::detector_noise::DetectorNoise;
use crate::geometry::projection::NormalizedProjection;
use crate::matching::consistency::{PosedDetection, squared_misfit};

/// Distance from the person's trajectory beyond which a keypoint is wrong, standard deviations: under Rayleigh's
/// distribution one in 270,000 lies beyond five.
const MAX_SIGMAS: f64 = 5.0;

/// Smallest number of views of the keypoint: with fewer it is unknown which of them is wrong.
const MIN_VIEWS: u8 = 3;

/// Keypoints that contradict all other views; `order`: the permutation of the flip.
pub(super) fn rejected(
    noise: &DetectorNoise,
    seen: &PosedDetection,
    expected: &[Option<NormalizedProjection>],
    n_views: &[u8],
    order: &[usize],
) -> Vec<usize> {
    let is_wrong = |k: &usize| {
        let misfit = expected[*k].and_then(|point| squared_misfit(seen, order[*k], &point, noise, *k));
        n_views[*k] >= MIN_VIEWS && misfit.is_some_and(|e2| e2 > MAX_SIGMAS * MAX_SIGMAS)
    };
    (0..expected.len()).filter(is_wrong).collect()
}
