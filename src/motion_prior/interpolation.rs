//! Rotations between samples: a cubic on SO(3) through four neighbours.
//!
//! The prior uses a 30 Hz grid, sessions have their own frame rates. Between samples 1 and 2 of four the rotation is
//! `R_1 exp(c_0 l_0 + c_2 l_2 + c_3 l_3)`, `l_k = log(R_1^T R_k)`, with Catmull and Rom's weights c of the place s
//! (Computer Aided Geometric Design, 1974): it passes through the samples, has a continuous angular velocity,
//! and errs by the fourth derivative of the motion, where a geodesic errs by the second.

use crate::geometry::rotation;
use nalgebra::{Matrix3, Vector3};

/// A time on a grid: the four samples around it and the position between the middle ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridPlace {
    /// Samples 0 to 3; at the ends of the grid the last one is repeated.
    pub samples: [usize; 4],
    /// Position between sample 1 (0) and sample 2 (1).
    pub share: f64,
}

/// The samples around position `at` (clamped to 0 to `n_samples` - 1). `n_samples` is at least 1.
pub fn grid_place(at: f64, n_samples: usize) -> GridPlace {
    let last = n_samples.saturating_sub(1);
    let at = at.clamp(0.0, last as f64);
    let first = (at.floor() as usize).min(last.saturating_sub(1));
    let samples = [first.saturating_sub(1), first, (first + 1).min(last), (first + 2).min(last)];
    GridPlace { samples, share: at - first as f64 }
}

/// Number of samples of a grid of `to_fps` over a take of `n_frames` at `from_fps`, up to its last frame.
pub fn resampled_len(n_frames: usize, from_fps: f64, to_fps: f64) -> usize {
    let duration = n_frames.saturating_sub(1) as f64 / from_fps;
    (duration * to_fps + 1e-6).floor() as usize + usize::from(n_frames > 0)
}

/// Catmull and Rom's weights of samples 0, 2 and 3; those of all four sum to 1 and sample 1 is the origin.
fn weights(share: f64) -> [f64; 3] {
    let (s, s2, s3) = (share, share * share, share * share * share);
    [-0.5 * s + s2 - 0.5 * s3, 0.5 * s + 2.0 * s2 - 1.5 * s3, -0.5 * s2 + 0.5 * s3]
}

/// The rotation at `share` between samples 1 and 2.
pub fn interpolate(samples: &[Matrix3<f64>; 4], share: f64) -> Matrix3<f64> {
    samples[1] * rotation::exp(&increment(samples, share))
}

/// The position at `share` between samples 1 and 2, by the same weights.
pub fn interpolate_positions(samples: &[Vector3<f64>; 4], share: f64) -> Vector3<f64> {
    let [c0, c2, c3] = weights(share);
    let from_first = |k: usize| samples[k] - samples[1];
    samples[1] + from_first(0) * c0 + from_first(2) * c2 + from_first(3) * c3
}

fn increment(samples: &[Matrix3<f64>; 4], share: f64) -> Vector3<f64> {
    let [c0, c2, c3] = weights(share);
    let from_first = |k: usize| rotation::step(&samples[1], &samples[k]);
    from_first(0) * c0 + from_first(2) * c2 + from_first(3) * c3
}

/// Rotations of all joints of a take on another grid, from the first frame on.
pub fn resampled<const J: usize>(
    take: &[[Matrix3<f64>; J]],
    from_fps: f64,
    to_fps: f64,
    n_samples: usize,
) -> Vec<[Matrix3<f64>; J]> {
    if take.is_empty() {
        return Vec::new();
    }
    let sample = |i: usize| {
        let place = grid_place(i as f64 * from_fps / to_fps, take.len());
        std::array::from_fn(|j| interpolate(&place.samples.map(|s| take[s][j]), place.share))
    };
    (0..n_samples).map(sample).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples() -> [Matrix3<f64>; 4] {
        [[0.1, 0.5, -0.2], [0.3, 0.7, 0.1], [0.8, 0.2, 0.4], [1.1, -0.3, 0.3]].map(|w| rotation::exp(&Vector3::from(w)))
    }

    #[test]
    fn passes_through_samples_and_follows_a_steady_turn() {
        let s = samples();
        assert!((interpolate(&s, 0.0) - s[1]).norm() < 1e-12 && (interpolate(&s, 1.0) - s[2]).norm() < 1e-12);
        let steady = [0.0, 0.2, 0.4, 0.6].map(|a| rotation::exp(&Vector3::new(0.0, a, 0.0)));
        let half = rotation::log(&interpolate(&steady, 0.5)).y;
        assert!((half - 0.3).abs() < 1e-12);
    }

    #[test]
    fn grids_of_any_rate_end_with_the_take() {
        assert_eq!(
            [resampled_len(0, 25.0, 30.0), resampled_len(1, 25.0, 30.0), resampled_len(26, 25.0, 30.0)],
            [0, 1, 31]
        );
        let place = grid_place(30.0, 31);
        assert_eq!((place.samples, place.share), ([28, 29, 30, 30], 1.0));
        assert_eq!(grid_place(0.4, 1).samples, [0; 4]);
        let take: Vec<[Matrix3<f64>; 1]> =
            (0..7).map(|t| [rotation::exp(&(Vector3::z() * (0.1 * t as f64)))]).collect();
        let there = resampled(&take, 30.0, 60.0, resampled_len(7, 30.0, 60.0));
        assert_eq!(there.len(), 13);
        assert!((there[4][0] - take[2][0]).norm() < 1e-12);
    }
}
