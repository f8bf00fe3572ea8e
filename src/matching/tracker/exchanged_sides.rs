//! Detections that show a person with left and right exchanged, as detectors do for seconds of people seen from behind.
//!
//! Several views show it: each detection is compared with the prediction as it is and exchanged. Such detections lead the person on, and
//! start no other one; the repair of detections turns them back.

use super::person::TrackedPerson;
use super::scene::{Assignment, Seen, Shown, TrackerScene};
use super::skeleton::Skeleton;
use crate::body::detector_profile::DETECTOR;
use crate::geometry::Rigid;
use crate::geometry::projection::squared_offset;
use crate::matching::normalized::NormalizedDetection;
use crate::optim::robust::OUTLIER_SIGMAS;
use nalgebra::Vector3;
use std::ops::Range;

/// Negative log probability, nats, of a detection whose left and right are exchanged: one in ten.
pub(super) const EXCHANGED_NATS: f64 = 2.3;

/// Distances, m, of a person's detection with exchanged sides from where the person is expected: beyond the detectors' errors,
/// within the width of shoulders, which are farthest from their counterparts.
const EXCHANGED_M: Range<f64> = 0.06..MAX_EXCHANGED_M;
/// The end of that range.
pub(super) const MAX_EXCHANGED_M: f64 = 0.6;

/// Least [`Seen::sidedness`] of a detection that has two sides to exchange: eight pairs a twelfth of a body apart.
const MIN_SIDEDNESS: f64 = 0.05;

/// Standard deviation of a keypoint's distance from where it is expected, m per axis, and the number of keypoints that err together.
const EXPECTED_SIGMA_M: f64 = 0.06;
const N_CORRELATED: f64 = 3.0;

/// Negative log odds, nats, of exchanged sides after a frame with sides as they are, and after an exchanged one: detectors exchange
/// sides for a second at a time.
const EXCHANGE_BEGINS: f64 = 4.6;
const EXCHANGE_GOES_ON: f64 = -2.9;

/// Whether a detection shows the projected skeleton with left and right exchanged: log likelihoods of the keypoints, each limited to
/// that of an outlier, against the probability of an exchange.
///
/// `distance_m`: of the detection as it is; `before`: whether sides were exchanged in this view's last frame. A single camera does not
/// show it.
pub(super) fn is_exchanged(
    scene: &TrackerScene,
    skeleton: &Skeleton,
    camera: &Rigid,
    detection: &NormalizedDetection,
    distance_m: f64,
    before: Option<bool>,
) -> bool {
    if scene.n_confirming_views() < 2 || !EXCHANGED_M.contains(&distance_m) {
        return false;
    }
    let mirror = scene.mirror;
    let prior = match before {
        None => EXCHANGED_NATS,
        Some(false) => EXCHANGE_BEGINS,
        Some(true) => EXCHANGE_GOES_ON,
    };
    let outlier = OUTLIER_SIGMAS * OUTLIER_SIGMAS;
    let misfit = |point: &Vector3<f64>, k: usize| {
        let is_seen = detection.confidence[k] >= DETECTOR.comparable;
        let offset = is_seen.then(|| squared_offset(camera, point, &detection.normalized[k]))?;
        Some((offset? / (EXPECTED_SIGMA_M * EXPECTED_SIGMA_M)).min(outlier))
    };
    let gain = |(k, point): (usize, &Option<Vector3<f64>>)| {
        let point = point.as_ref().filter(|_| mirror[k] != k)?;
        Some(misfit(point, k)? - misfit(point, mirror[k])?)
    };
    let gains: f64 = skeleton.iter().enumerate().filter_map(gain).sum();
    0.5 * gains > prior * N_CORRELATED
}

/// Takes back exchanges that begin in all views of a person at once: errors of two views have nothing to do with each other, so that the
/// prediction is wrong.
pub(super) fn withdraw_common(people: &[TrackedPerson], assignments: &mut [Assignment]) {
    for (person, assignment) in people.iter().zip(assignments) {
        let begins = |(now, before): (&Option<Shown>, &Option<Shown>)| {
            now.is_none_or(|shown| shown.is_exchanged && before.is_none_or(|before| !before.is_exchanged))
        };
        if assignment.iter().zip(person.last_assignment()).all(begins) {
            assignment.iter_mut().flatten().for_each(|shown| shown.is_exchanged = false);
        }
    }
}

/// A person with left and right as the detections have them for the most part: a track that began with exchanged ones has them
/// the other way round. Each counts by how far its sides are apart, since from the side there are none.
pub(super) fn with_usual_sides(mut person: TrackedPerson, scene: &TrackerScene) -> TrackedPerson {
    let vote = |(frame, assignment): &(usize, Assignment)| -> f64 {
        let sign = |seen: &Seen| if seen.is_exchanged() { -1.0 } else { 1.0 };
        scene.detections_of(*frame, assignment).iter().map(|(_, seen)| sign(seen) * seen.sidedness(scene.mirror)).sum()
    };
    if person.assignments.iter().map(vote).sum::<f64>() < 0.0 {
        for (frame, assignment) in &mut person.assignments {
            for (view, shown) in assignment.iter_mut().enumerate() {
                let Some(shown) = shown else { continue };
                let is_clear = scene.seen(view, *frame, *shown).sidedness(scene.mirror) > MIN_SIDEDNESS;
                shown.is_exchanged = !shown.is_exchanged && is_clear;
            }
        }
        let exchanged = |skeleton: &Skeleton| scene.mirror.iter().map(|&twin| skeleton[twin]).collect();
        person.skeletons.iter_mut().for_each(|skeleton| *skeleton = exchanged(skeleton));
    }
    person
}
