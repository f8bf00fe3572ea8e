//! Skeletons of tracked persons: triangulation, completion, distances and plausibility.

use super::scene::{Seen, TrackerScene};
use crate::body::bones::LimbBone;
use crate::body::detector_profile::DETECTOR;
use crate::estimation::triangulation::triangulate_reweighted;
use crate::geometry::Rigid;
use crate::geometry::projection::squared_offset;
use crate::geometry::triangulation::PointObservation;
use crate::optim::robust::{median, median_and_spread};
use nalgebra::Vector3;

/// Position of every keypoint in the world, m; `None` where it is unknown.
pub type Skeleton = Vec<Option<Vector3<f64>>>;

/// Two skeletons whose median joint distance is below this show one person, m.
pub(super) const SAME_PERSON_M: f64 = 0.15;

/// Keypoints that a detection must share with a skeleton for their distance to count.
const MIN_SHARED: usize = 4;

/// Residual at which a ray loses three quarters of its weight, m on the body: three times a good detector's noise.
const ROBUST_SCALE_M: f64 = 0.06;

/// Log ratio of bones to an adult's beyond which a skeleton is not one person's (a child of 1 m has -0.5).
const MAX_LOG_SIZE: f64 = 0.6;

/// Spread of log bone ratios beyond which a skeleton is mixed from two persons: true ones have 0.05 to 0.1.
const MAX_BONE_SPREAD: f64 = 0.35;

/// Median distance of two skeletons' shared keypoints, m.
pub(super) fn distance(one: &Skeleton, other: &Skeleton) -> Option<f64> {
    let mut distances: Vec<f64> = one.iter().zip(other).filter_map(|(a, b)| Some(((*a)? - (*b)?).norm())).collect();
    median(&mut distances)
}

/// [`distance`] where the first may have left and right exchanged: the smaller one.
pub(super) fn distance_to_either_side(scene: &TrackerScene, one: &Skeleton, other: &Skeleton) -> Option<f64> {
    let exchanged: Skeleton = scene.mirror.iter().map(|&twin| one[twin]).collect();
    [distance(one, other), distance(&exchanged, other)].into_iter().flatten().min_by(f64::total_cmp)
}

/// Median distance of a detection to a projected skeleton, in metres on the body; `None` with too few shared keypoints.
pub(super) fn distance_to_detection(skeleton: &Skeleton, camera: &Rigid, seen: Seen) -> Option<f64> {
    distance_within(skeleton, camera, seen, f64::INFINITY)
}

/// [`distance_to_detection`] where it is less than `limit`, m. Most people of a scene are farther than that from a detection, and to
/// count their keypoints takes less than to order them.
pub(super) fn distance_within(skeleton: &Skeleton, camera: &Rigid, seen: Seen, limit: f64) -> Option<f64> {
    let mut squares: Vec<f64> = Vec::with_capacity(skeleton.len());
    for (k, point) in skeleton.iter().enumerate() {
        if seen.confidence(k) < DETECTOR.comparable {
            continue;
        }
        squares.extend(point.and_then(|p| squared_offset(camera, &p, &seen.normalized(k))));
    }
    let n_within = squares.iter().filter(|square| **square < limit * limit).count();
    // The median is the upper one.
    let is_within = squares.len() >= MIN_SHARED && n_within > squares.len() / 2;
    if is_within { median(&mut squares).map(f64::sqrt) } else { None }
}

/// The keypoints that at least two views see, triangulated so that one wrong view does not move them.
pub(super) fn triangulated(scene: &TrackerScene, seen: &[(usize, Seen)]) -> Skeleton {
    let n = seen[0].1.n_keypoints();
    (0..n).map(|k| triangulated_point(scene, seen, k)).collect()
}

fn triangulated_point(scene: &TrackerScene, seen: &[(usize, Seen)], k: usize) -> Option<Vector3<f64>> {
    let mut rays = Vec::with_capacity(seen.len());
    for (view, detection) in seen {
        if detection.confidence(k) > 0.0 {
            let camera_from_world = scene.cameras[*view].as_ref()?;
            let (normalized, weight) = (detection.normalized(k), detection.confidence(k));
            rays.push(PointObservation { camera_from_world, normalized, weight });
        }
    }
    triangulate_reweighted(&rays, ROBUST_SCALE_M)
}

/// Fills the keypoints that were not triangulated with predicted ones. A single ray corrects a prediction across the ray
/// and leaves its depth.
pub(super) fn completed(
    scene: &TrackerScene,
    seen: &[(usize, Seen)],
    mut skeleton: Skeleton,
    predicted: &Skeleton,
) -> Skeleton {
    if skeleton.iter().all(Option::is_some) {
        return skeleton;
    }
    let moves: Vec<Vector3<f64>> = skeleton.iter().zip(predicted).filter_map(|(a, b)| Some((*a)? - (*b)?)).collect();
    let drift = componentwise_median(&moves);
    for (k, point) in skeleton.iter_mut().enumerate() {
        if point.is_some() {
            continue;
        }
        let Some(start) = predicted[k].map(|p| p + drift) else { continue };
        let ray = seen.iter().find(|(_, s)| s.confidence(k) > DETECTOR.comparable);
        *point = Some(match ray.and_then(|(v, s)| Some((scene.cameras[*v].as_ref()?, s.normalized(k)))) {
            Some((camera, normalized)) => {
                let depth = camera.transform(&start).z;
                camera.inverse().transform(&Vector3::new(normalized.x * depth, normalized.y * depth, depth))
            }
            None => start,
        });
    }
    skeleton
}

fn componentwise_median(moves: &[Vector3<f64>]) -> Vector3<f64> {
    let axis = |a: usize| median(&mut moves.iter().map(|m| m[a]).collect::<Vec<_>>()).unwrap_or(0.0);
    Vector3::new(axis(0), axis(1), axis(2))
}

/// Whether bones have human lengths and proportions, as far as they can be measured.
pub(super) fn is_human(scene: &TrackerScene, skeleton: &Skeleton) -> bool {
    let ratio = |b: &LimbBone| Some(((skeleton[b.a]? - skeleton[b.b]?).norm() / b.length).ln());
    let mut ratios: Vec<f64> = scene.bones.iter().filter_map(ratio).collect();
    let n = ratios.len();
    let (size, spread) = median_and_spread(&mut ratios);
    n < 2 || (size.abs() < MAX_LOG_SIZE && spread < MAX_BONE_SPREAD)
}
