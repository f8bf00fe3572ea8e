//! The relative pose of two views from point pairs with many outliers.

mod squares;

use super::consensus::{ConsensusProblem, find_consensus};
use crate::geometry::epipolar::{self, PointPair};
use crate::geometry::five_point::five_point;
use crate::geometry::{Rigid, rotation};
use crate::optim::dense_levenberg_marquardt::descend;
use nalgebra::{Matrix3, SVector};
use squares::PairLanes;

/// An estimated relative pose, with statistics of the pairs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EssentialEstimate {
    /// `[t]x R` of the pose.
    pub essential: Matrix3<f64>,
    /// Of its four poses the one with most inliers in front of both views; baseline 1.
    pub second_from_first: Rigid,
    /// `sum w max(0, 1 - d^2 / threshold^2)` over all pairs, d the Sampson distance.
    pub support: f64,
    /// Weight of the pairs within the threshold as a share of all weight.
    pub inlier_ratio: f64,
    /// Share of the inliers in front of both views; one half means that direction or rotation is undetermined.
    pub cheirality_ratio: f64,
}

/// Linearisations of the re-fit of a new best model, and of the final one.
const REFIT_ITERATIONS: usize = 4;
const FINAL_ITERATIONS: usize = 10;

/// Finds the essential matrix that most pairs agree on: five-point samples, soft score, re-fits.
///
/// `pairs`: ideal normalised coordinates. `weights`: of each pair, zero to ignore; `None`: all 1. `threshold`:
/// Sampson distance at which a pair's gain reaches zero, normalised (px / focal). `iterations`: most samples drawn.
///
/// `None` with fewer than five usable pairs or where no model has inliers. Known limit: pairs of a pure rotation fit many
/// essential matrices; a low `cheirality_ratio` and small angles of triangulation indicate it.
pub fn estimate_essential(
    pairs: &[PointPair],
    weights: Option<&[f64]>,
    threshold: f64,
    iterations: usize,
    seed: u64,
) -> Option<EssentialEstimate> {
    let problem = ConsensusProblem { n_data: pairs.len(), weights, threshold, iterations, seed };
    let lanes = PairLanes::new(pairs, |i| weight_of(weights, i));
    let refit = |pose: &Rigid, n: usize| refined(pose, &lanes, threshold, n);
    let found = find_consensus(
        &problem,
        |sample| five_point(&sample.map(|i| pairs[i])),
        |essential, i| epipolar::sampson_squared(essential, &pairs[i].0, &pairs[i].1),
        // All four poses have this essential matrix: any of them serves.
        |essential| {
            let [pose, ..] = epipolar::poses_from_essential(essential);
            epipolar::essential_from_pose(&refit(&pose, REFIT_ITERATIONS))
        },
    )?;
    let [pose, ..] = epipolar::poses_from_essential(&found.model);
    let refined = epipolar::essential_from_pose(&refit(&pose, FINAL_ITERATIONS));
    // The descent minimises a smooth robust cost, not the score; of two nearly equal models the score decides.
    let before = score_essential(&found.model, pairs, weights, threshold);
    let after = score_essential(&refined, pairs, weights, threshold);
    Some(if after.support >= before.support { after } else { before })
}

/// Scores an essential matrix on pairs and chooses its pose by cheirality.
pub fn score_essential(
    essential: &Matrix3<f64>,
    pairs: &[PointPair],
    weights: Option<&[f64]>,
    threshold: f64,
) -> EssentialEstimate {
    let poses = epipolar::poses_from_essential(essential);
    let (mut support, mut total, mut inliers, mut in_front) = (0.0, 0.0, 0.0, [0.0; 4]);
    for (i, (a, b)) in pairs.iter().enumerate() {
        let weight = weight_of(weights, i);
        total += weight;
        let gain = 1.0 - epipolar::sampson_squared(essential, a, b) / (threshold * threshold);
        if gain > 0.0 {
            support += weight * gain;
            inliers += weight;
            for (sum, pose) in in_front.iter_mut().zip(&poses) {
                *sum += if epipolar::in_front(pose, a, b) { weight } else { 0.0 };
            }
        }
    }
    let best = (1..4).fold(0, |best, i| if in_front[i] > in_front[best] { i } else { best });
    let share = |part: f64, whole: f64| if whole > 0.0 { part / whole } else { 0.0 };
    EssentialEstimate {
        essential: epipolar::essential_from_pose(&poses[best]),
        second_from_first: poses[best],
        support,
        inlier_ratio: share(inliers, total),
        cheirality_ratio: share(in_front[best], inliers),
    }
}

/// Refines a relative pose on pairs: the Geman-McClure loss of Sampson distances, with `threshold` as its scale, over
/// the five degrees of freedom of an essential matrix (rotation, and direction of the baseline).
///
/// Returns `second_from_first` with a baseline of 1, on the branch (of four) of the start; the normalised start where no
/// step improves it. A start with a zero baseline is returned unchanged.
pub fn refine_essential(
    start: &Rigid,
    pairs: &[PointPair],
    weights: Option<&[f64]>,
    threshold: f64,
    iterations: usize,
) -> Rigid {
    refined(start, &PairLanes::new(pairs, |i| weight_of(weights, i)), threshold, iterations)
}

/// As [`refine_essential`].
fn refined(start: &Rigid, pairs: &PairLanes, threshold: f64, iterations: usize) -> Rigid {
    let Some(translation) = start.translation.try_normalize(0.0) else {
        return *start;
    };
    let linearize = |pose: &Rigid| Some(pairs.linearized(pose, &rotation::tangents(&pose.translation), threshold));
    descend(Rigid { translation, ..*start }, iterations, linearize, retract)
}

fn retract(pose: &Rigid, step: &SVector<f64, 5>) -> Rigid {
    let turn = rotation::exp(&step.fixed_rows::<3>(0).into_owned());
    let moved = pose.translation + rotation::tangents(&pose.translation) * step.fixed_rows::<2>(3);
    Rigid { rotation: turn * pose.rotation, translation: moved.normalize() }
}

fn weight_of(weights: Option<&[f64]>, index: usize) -> f64 {
    weights.map_or(1.0, |w| w.get(index).copied().unwrap_or(0.0))
}

#[cfg(test)]
mod tests;
