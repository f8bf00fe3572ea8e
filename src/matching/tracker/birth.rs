//! New people: detections that nobody claims, where at least two views agree on a human skeleton.

use super::person::{Skeleton, TrackedPerson, detections_of, distance, distance_m, triangulated};
use super::{Scene, TrackerConfig};
use crate::geometry::epipolar::essential_from_pose;
use crate::matching::normalized::{BODY_SPAN_M, NormalizedDetection};
use crate::matching::pair_score::similarity;
use crate::optim::robust::median_and_spread;
use nalgebra::Matrix3;

/// Two detections are one person when this share of their points agrees.
const MIN_SIMILARITY: f64 = 0.5;

/// Log ratio of bones to an adult's beyond which a skeleton is not one person (a child of 1 m has -0.5).
const MAX_LOG_SIZE: f64 = 0.6;

/// Spread of log bone ratios beyond which a skeleton is two people's: true ones have 0.05 to 0.1.
const MAX_BONE_SPREAD: f64 = 0.35;

/// Two skeletons whose median joint is nearer than this are one person seen twice, m.
pub(super) const SAME_PERSON_M: f64 = 0.15;

/// The best supported new person among the free detections of a frame.
pub(super) fn strongest(
    scene: &Scene,
    config: &TrackerConfig,
    frame: usize,
    free: &[Vec<usize>],
    people: &[TrackedPerson],
) -> Option<TrackedPerson> {
    let mut pairs = agreeing_pairs(scene, config, frame, free);
    pairs.sort_by(|a, b| b.0.total_cmp(&a.0));
    for (_, claim) in pairs {
        let claim = joined_by_others(scene, config, frame, free, claim);
        let skeleton = triangulated(scene, &detections_of(scene, frame, &claim));
        if is_human(scene, &skeleton) && !is_known(&skeleton, people, frame) {
            return Some(TrackedPerson::new(frame, claim, skeleton));
        }
    }
    None
}

/// Pairs of free detections of two views that agree, with their agreement.
fn agreeing_pairs(
    scene: &Scene,
    config: &TrackerConfig,
    frame: usize,
    free: &[Vec<usize>],
) -> Vec<(f64, Vec<Option<usize>>)> {
    let mut pairs = Vec::new();
    for w in 0..scene.views.len() {
        for v in 0..w {
            let Some(essential) = essential(scene, v, w) else { continue };
            for (&a, &b) in free[v].iter().flat_map(|a| free[w].iter().map(move |b| (a, b))) {
                let (s, t) = (&scene.views[v].frames[frame][a], &scene.views[w].frames[frame][b]);
                if let Some(agreement) = agreement(config, &essential, s, t) {
                    let mut claim = vec![None; scene.views.len()];
                    (claim[v], claim[w]) = (Some(a), Some(b));
                    pairs.push((agreement, claim));
                }
            }
        }
    }
    pairs
}

/// The essential matrix of two views; `None` where a camera has no place.
pub(super) fn essential(scene: &Scene, first: usize, second: usize) -> Option<Matrix3<f64>> {
    let (first, second) = (scene.cameras[first].as_ref()?, scene.cameras[second].as_ref()?);
    Some(essential_from_pose(&(*second * first.inverse())))
}

/// How many points of two views' detections agree; `None` where hardly any do.
pub(super) fn agreement(
    config: &TrackerConfig,
    essential: &Matrix3<f64>,
    s: &NormalizedDetection,
    t: &NormalizedDetection,
) -> Option<f64> {
    // The Sampson distance combines both views: the radius follows the larger (nearer) image.
    let radius = config.birth_radius * s.size.max(t.size) / BODY_SPAN_M;
    let share = similarity(essential, s, t, radius);
    (share > MIN_SIMILARITY).then(|| share * s.n_points().min(t.n_points()) as f64)
}

/// Adds the free detection of every further view that fits the skeleton of the first two.
fn joined_by_others(
    scene: &Scene,
    config: &TrackerConfig,
    frame: usize,
    free: &[Vec<usize>],
    mut claim: Vec<Option<usize>>,
) -> Vec<Option<usize>> {
    let skeleton = triangulated(scene, &detections_of(scene, frame, &claim));
    for view in 0..scene.views.len() {
        let Some(camera) = scene.cameras[view].as_ref().filter(|_| claim[view].is_none()) else { continue };
        let distance = |d: &usize| distance_m(&skeleton, camera, &scene.views[view].frames[frame][*d]);
        let nearest = free[view].iter().filter_map(|d| Some((distance(d)?, *d))).min_by(|a, b| a.0.total_cmp(&b.0));
        claim[view] = nearest.filter(|(m, _)| *m < config.max_residual).map(|(_, d)| d);
    }
    claim
}

/// Whether bones have human lengths and proportions, as far as they can be measured.
pub(super) fn is_human(scene: &Scene, skeleton: &Skeleton) -> bool {
    let ratio = |b: &crate::body::bones::LimbBone| Some(((skeleton[b.a]? - skeleton[b.b]?).norm() / b.length).ln());
    let mut ratios: Vec<f64> = scene.bones.iter().filter_map(ratio).collect();
    let n = ratios.len();
    let (size, spread) = median_and_spread(&mut ratios);
    n < 2 || (size.abs() < MAX_LOG_SIZE && spread < MAX_BONE_SPREAD)
}

/// Whether somebody already stands there: detectors report some people twice.
pub(super) fn is_known(skeleton: &Skeleton, people: &[TrackedPerson], frame: usize) -> bool {
    let mut there = people.iter().filter(|p| p.last_seen() == frame);
    there.any(|p| distance(skeleton, p.last_skeleton()).is_some_and(|d| d < SAME_PERSON_M))
}
