//! New persons from unassigned detections: where two views agree on a human skeleton or, with a single camera, wherever
//! enough keypoints are seen.

use super::monocular::flat_figure;
use super::person::TrackedPerson;
use super::scene::{Assignment, Seen, Shown, TrackerConfig, TrackerScene};
use super::skeleton::{
    SAME_PERSON_M, Skeleton, distance_to_detection, distance_to_either_side, is_human, triangulated,
};
use crate::matching::normalized::{BODY_SPAN_M, NormalizedDetection};
use crate::matching::pair_score::similarity;
use nalgebra::Matrix3;

/// Two detections show one person when this share of their keypoints agrees.
const MIN_SIMILARITY: f64 = 0.5;

/// Keypoints that a detection of a single camera needs to start a person: a face alone has five.
const MIN_KEYPOINTS: usize = 6;

/// The best supported new person among the unassigned detections of a frame.
pub(super) fn new_person(
    scene: &TrackerScene,
    config: &TrackerConfig,
    frame: usize,
    free: &[Vec<usize>],
    people: &[TrackedPerson],
) -> Option<TrackedPerson> {
    match scene.views.len() {
        1 => from_single_view(scene, frame, &free[0], people),
        _ => from_agreeing_views(scene, config, frame, free, people),
    }
}

/// The detection with most keypoints that no person stands for yet.
fn from_single_view(
    scene: &TrackerScene,
    frame: usize,
    free: &[usize],
    people: &[TrackedPerson],
) -> Option<TrackedPerson> {
    let detection = |d: usize| &scene.detections(0, frame)[d];
    let mut order: Vec<usize> = free.iter().copied().filter(|d| detection(*d).n_points() >= MIN_KEYPOINTS).collect();
    order.sort_by_key(|d| (std::cmp::Reverse(detection(*d).n_points()), *d));
    order.into_iter().find_map(|d| {
        let skeleton = flat_figure(scene, detection(d), None)?;
        let is_new = !is_known(scene, &skeleton, people, frame);
        is_new.then(|| TrackedPerson::new(frame, vec![Some(Shown::as_detected(d))], skeleton))
    })
}

/// The pair of detections that agrees best on a new human skeleton, with the detections of further views that fit.
fn from_agreeing_views(
    scene: &TrackerScene,
    config: &TrackerConfig,
    frame: usize,
    free: &[Vec<usize>],
    people: &[TrackedPerson],
) -> Option<TrackedPerson> {
    let mut pairs = agreeing_pairs(scene, config, frame, free);
    pairs.sort_by(|a, b| b.0.total_cmp(&a.0));
    for (_, pair) in pairs {
        let assignment = extended(scene, config, frame, free, pair);
        let skeleton = triangulated(scene, &scene.detections_of(frame, &assignment));
        if is_human(scene, &skeleton) && !is_known(scene, &skeleton, people, frame) {
            return Some(TrackedPerson::new(frame, assignment, skeleton));
        }
    }
    None
}

/// Pairs of unassigned detections of two views that agree, with their agreement.
fn agreeing_pairs(
    scene: &TrackerScene,
    config: &TrackerConfig,
    frame: usize,
    free: &[Vec<usize>],
) -> Vec<(f64, Assignment)> {
    let mut pairs = Vec::new();
    for w in 0..scene.views.len() {
        for v in 0..w {
            let Some(essential) = scene.essential(v, w) else { continue };
            for (&a, &b) in free[v].iter().flat_map(|a| free[w].iter().map(move |b| (a, b))) {
                let (s, t) = (&scene.detections(v, frame)[a], &scene.detections(w, frame)[b]);
                if let Some(agreement) = agreement(config, &essential, s, t) {
                    let mut assignment = vec![None; scene.views.len()];
                    (assignment[v], assignment[w]) = (Some(Shown::as_detected(a)), Some(Shown::as_detected(b)));
                    pairs.push((agreement, assignment));
                }
            }
        }
    }
    pairs
}

/// How many keypoints of two views' detections agree; `None` where too small a share does.
pub(super) fn agreement(
    config: &TrackerConfig,
    essential: &Matrix3<f64>,
    s: &NormalizedDetection,
    t: &NormalizedDetection,
) -> Option<f64> {
    // The Sampson distance combines both views: the radius follows the larger (nearer) image.
    let radius = config.agreement_radius * s.size.max(t.size) / BODY_SPAN_M;
    let share = similarity(essential, s, t, radius);
    (share > MIN_SIMILARITY).then(|| share * s.n_points().min(t.n_points()) as f64)
}

/// Adds the unassigned detection of every further view that fits the skeleton of the first two.
fn extended(
    scene: &TrackerScene,
    config: &TrackerConfig,
    frame: usize,
    free: &[Vec<usize>],
    mut assignment: Assignment,
) -> Assignment {
    let skeleton = triangulated(scene, &scene.detections_of(frame, &assignment));
    for view in 0..scene.views.len() {
        let Some(camera) = scene.cameras[view].as_ref().filter(|_| assignment[view].is_none()) else { continue };
        let seen = |d: &usize| Seen::as_detected(&scene.detections(view, frame)[*d]);
        let distance = |d: &usize| distance_to_detection(&skeleton, camera, seen(d));
        let nearest = free[view].iter().filter_map(|d| Some((distance(d)?, *d))).min_by(|a, b| a.0.total_cmp(&b.0));
        assignment[view] = nearest.filter(|(m, _)| *m < config.max_residual).map(|(_, d)| Shown::as_detected(d));
    }
    assignment
}

/// Whether a tracked person already stands there: detectors report some people twice, or exchange left and right.
fn is_known(scene: &TrackerScene, skeleton: &Skeleton, people: &[TrackedPerson], frame: usize) -> bool {
    let mut present = people.iter().filter(|p| p.last_seen() == frame);
    let distance = |p: &TrackedPerson| distance_to_either_side(scene, skeleton, p.last_skeleton());
    present.any(|p| distance(p).is_some_and(|d| d < SAME_PERSON_M))
}
