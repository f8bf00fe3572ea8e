//! Scores of relative poses of two cameras: epipolar votes, cheirality, human proportions.

use super::assignment::assign;
use super::normalized::{NormalizedDetection, NormalizedView};
use crate::body::bones::LimbBone;
use crate::body::detector_profile::DETECTOR;
use crate::geometry::Rigid;
use crate::geometry::epipolar::{essential_from_pose, sampson_squared};
use crate::geometry::triangulation::midpoint;
use crate::optim::robust::median_and_spread;
use nalgebra::{Matrix3, Vector3};

/// Distance from the epipolar line beyond which a point has no vote, rad: 16 px at a focal length of 1,060 px, four
/// times the detectors' own noise on people 4 m away; it grows with [`error_scale`].
pub const VOTE_RADIUS: f64 = 0.015;

/// Pairs of detections below this similarity do not match: two standing people agree by chance up to 0.4.
const MIN_SIMILARITY: f64 = 0.4;

/// How many times larger epipolar distances of two detections are than on people 4 m away: they follow the nearer one.
pub fn error_scale(a: &NormalizedDetection, b: &NormalizedDetection) -> f64 {
    a.error_scale().max(b.error_scale())
}

/// Spread (MAD) of log bone ratios at which the factor of a score falls to 1/e: true pairs have 0.05 to 0.07, wrong ones
/// 0.1 to 1.
const BONE_SPREAD: f64 = 0.25;

/// Fewest keypoints that two detections must share to match.
const MIN_SHARED: usize = 6;

/// Detections of two cameras in a fixed set of frames.
pub struct PairObservations<'a> {
    /// Detections of the first and the second camera, per frame.
    pub frames: Vec<(&'a [NormalizedDetection], &'a [NormalizedDetection])>,
    /// Bones with reference lengths.
    pub bones: &'a [LimbBone],
}

impl<'a> PairObservations<'a> {
    /// The detections of `frames`.
    pub fn new(first: &'a NormalizedView, second: &'a NormalizedView, frames: &[usize], bones: &'a [LimbBone]) -> Self {
        let at = |&f: &usize| (first.frames[f].as_slice(), second.frames[f].as_slice());
        Self { frames: frames.iter().map(at).filter(|(a, b)| !a.is_empty() && !b.is_empty()).collect(), bones }
    }
}

/// The score of a relative pose.
#[derive(Debug, Clone, Copy, Default)]
pub struct PairScore {
    /// Log of the metres that one unit of `second_from_first`'s translation stands for.
    pub log_metres: f64,
    /// The product by which hypotheses are ranked, 0 to 1: of the vote, of the share of points in front of both cameras and
    /// of how human the proportions of the bones are.
    pub quality: f64,
}

/// Two detections that match in one frame.
#[derive(Debug, Clone, Copy)]
pub struct MatchedPair<'a> {
    /// Detection of the first camera.
    pub first: &'a NormalizedDetection,
    /// Detection of the second camera.
    pub second: &'a NormalizedDetection,
}

/// Agreement of two detections with an essential matrix, 0 to 1: the mean of `max(0, 1 - (d / r)^2)` over shared points.
pub fn similarity(essential: &Matrix3<f64>, a: &NormalizedDetection, b: &NormalizedDetection, radius: f64) -> f64 {
    let (mut sum, mut n) = (0.0, 0usize);
    let inverse = 1.0 / (radius * radius);
    for k in 0..a.normalized.len() {
        if a.confidence[k] > DETECTOR.comparable && b.confidence[k] > DETECTOR.comparable {
            sum += (1.0 - sampson_squared(essential, &a.normalized[k], &b.normalized[k]) * inverse).max(0.0);
            n += 1;
        }
    }
    if n < MIN_SHARED { 0.0 } else { sum / n as f64 }
}

/// [`similarity`] within [`VOTE_RADIUS`] of the nearer detection.
pub fn agreement(essential: &Matrix3<f64>, a: &NormalizedDetection, b: &NormalizedDetection) -> f64 {
    similarity(essential, a, b, VOTE_RADIUS * error_scale(a, b))
}

/// The best one-to-one matches of every frame under an essential matrix, and their vote (0 to 1).
pub fn vote<'a>(observations: &PairObservations<'a>, essential: &Matrix3<f64>) -> (Vec<MatchedPair<'a>>, f64) {
    let mut matches = Vec::new();
    let (mut sum, mut possible) = (0.0, 0.0);
    for (first, second) in &observations.frames {
        let table: Vec<Vec<f64>> =
            first.iter().map(|a| second.iter().map(|b| agreement(essential, a, b)).collect()).collect();
        let columns = assign(first.len(), second.len(), 1.0 - MIN_SIMILARITY, |i, j| 1.0 - table[i][j]);
        for (i, column) in columns.iter().enumerate() {
            let Some(j) = *column else { continue };
            sum += table[i][j] - MIN_SIMILARITY;
            matches.push(MatchedPair { first: &first[i], second: &second[j] });
        }
        possible += first.len().min(second.len()) as f64 * (1.0 - MIN_SIMILARITY);
    }
    (matches, if possible > 0.0 { sum / possible } else { 0.0 })
}

/// Scores `second_from_first` (any unit of length) on the observations.
pub fn score_pair(observations: &PairObservations, second_from_first: &Rigid) -> PairScore {
    let (matches, vote) = vote(observations, &essential_from_pose(second_from_first));
    let mut log_ratios = Vec::new();
    let (mut in_front, mut behind) = (0usize, 0usize);
    for m in &matches {
        let points = triangulate_match(m, second_from_first);
        for p in points.iter().flatten() {
            if p.1 { in_front += 1 } else { behind += 1 }
        }
        for bone in observations.bones {
            if let (Some((a, true)), Some((b, true))) = (points[bone.a], points[bone.b]) {
                log_ratios.push((bone.length / (a - b).norm().max(1e-9)).ln());
            }
        }
    }
    let cheirality = in_front as f64 / (in_front + behind).max(1) as f64;
    let n_bones = log_ratios.len();
    let (log_metres, bone_spread) = median_and_spread(&mut log_ratios);
    let human = if n_bones >= MIN_BONES { (-(bone_spread / BONE_SPREAD).powi(2)).exp() } else { 0.0 };
    let quality = vote * (2.0 * cheirality - 1.0).max(0.0) * human;
    PairScore { log_metres, quality }
}

/// Fewest bones from which proportions are measured.
const MIN_BONES: usize = 8;

/// Points of a match in the first camera's frame and whether they lie in front of both cameras.
fn triangulate_match(m: &MatchedPair, second_from_first: &Rigid) -> Vec<Option<(Vector3<f64>, bool)>> {
    let n = m.first.normalized.len();
    (0..n)
        .map(|k| {
            let seen = m.first.confidence[k] > DETECTOR.comparable && m.second.confidence[k] > DETECTOR.comparable;
            if seen { midpoint(second_from_first, &m.first.normalized[k], &m.second.normalized[k]) } else { None }
        })
        .collect()
}
