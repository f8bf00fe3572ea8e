//! The 3D tracker: assigns every detection to a person, frame by frame, under known cameras.
//!
//! A person is a predicted skeleton (`person`). In each frame every view assigns its detections to the nearest
//! predictions; persons held by a single view are re-acquired by the others (`reacquisition`); unassigned detections start
//! new persons (`initialisation`), or continue a person that is lost where no other person can be meant (`continuation`).
//! A detector may have exchanged a person's left and right (`exchanged_sides`).
//! Long takes are followed in windows side by side (`tracking_windows`). At the end duplicates are merged (`duplicate_merging`),
//! and fragments of one person are joined (`stitching`) by position, build and the detectors' track numbers
//! (`reidentification`).

mod beginnings;
mod continuation;
mod duplicate_merging;
mod exchanged_sides;
mod initialisation;
mod monocular;
mod person;
mod reacquisition;
mod reidentification;
mod scene;
mod skeleton;
mod stitching;
mod tracking_windows;

use super::assignment::assign;
use crate::progress::{Canceled, Progress};
use exchanged_sides::{EXCHANGED_NATS, is_exchanged, with_usual_sides};
pub use person::TrackedPerson;
use rayon::prelude::*;
use scene::Seen;
pub use scene::{Assignment, Shown, TrackerConfig, TrackerScene};
pub use skeleton::Skeleton;
use std::ops::Range;
use tracking_windows::TrackingWindows;

/// A person that is not confirmed yet must be this many times as near.
const UNCONFIRMED_FACTOR: f64 = 1.3;

/// Negative log likelihood, nats, of a detection at the edge of a new gate, which lies at three standard deviations.
const NATS_AT_GATE: f64 = 4.5;

/// Cost of an impossible assignment; the limit is 1.
const IMPOSSIBLE: f64 = 2.0;

/// Follows all persons through the session; the result is in order of support, best first.
///
/// # Errors
/// [`Canceled`].
pub fn track(
    scene: &TrackerScene,
    config: &TrackerConfig,
    progress: &Progress,
) -> Result<Vec<TrackedPerson>, Canceled> {
    let windows = TrackingWindows::of(scene, config);
    let follow = |frames: &Range<usize>| follow(scene, config, frames.clone(), progress);
    let followed = windows.frames().par_iter().map(follow).collect::<Result<_, Canceled>>()?;
    let mut followed = windows.joined(scene, followed);
    followed.retain(|p| p.is_real(scene, config));
    let followed = beginnings::follow_backwards(scene, config, followed, progress)?;
    let mut people = stitching::stitch(scene, followed);
    people.retain(|p| p.is_real(scene, config));
    people.sort_by_key(|p| (std::cmp::Reverse(p.support()), p.first()));
    Ok(people)
}

/// Follows persons through some frames; what is seen too briefly to be a person is among them.
fn follow(
    scene: &TrackerScene,
    config: &TrackerConfig,
    frames: Range<usize>,
    progress: &Progress,
) -> Result<Vec<TrackedPerson>, Canceled> {
    let max_gap = (config.max_gap * scene.fps) as usize;
    let (mut people, mut finished): (Vec<TrackedPerson>, Vec<TrackedPerson>) = Default::default();
    for frame in frames {
        if frame % 64 == 0 {
            progress.check()?;
        }
        let (present, gone): (Vec<_>, Vec<_>) = people.into_iter().partition(|p| frame - p.last_seen() <= max_gap);
        finished.extend(gone);
        people = present;
        step(scene, config, frame, &mut people);
    }
    finished.extend(people);
    Ok(finished.into_iter().map(|person| with_usual_sides(person, scene)).collect())
}

/// One frame: assigns its detections, updates the persons, starts new ones.
fn step(scene: &TrackerScene, config: &TrackerConfig, frame: usize, people: &mut Vec<TrackedPerson>) {
    let all = scene.unassigned(frame, &[]);
    let mut assignments = nearest_detections(scene, config, frame, people, &all);
    reacquisition::reacquire(scene, config, frame, &mut assignments);
    for (person, assignment) in people.iter_mut().zip(&mut assignments) {
        person.update(scene, config, frame, assignment);
    }
    let n_known = people.len();
    let mut free = scene.unassigned(frame, &assignments);
    while let Some(new) = initialisation::new_person(scene, config, frame, &free, people) {
        for (view, detection) in new.detections_at(frame) {
            free[view].retain(|d| *d != detection);
        }
        people.push(new);
    }
    continuation::continue_lost(scene, config, frame, people, n_known);
}

/// For each person the `free` detection of every view that lies nearest to the prediction, one detection to one person.
fn nearest_detections(
    scene: &TrackerScene,
    config: &TrackerConfig,
    frame: usize,
    people: &[TrackedPerson],
    free: &[Vec<usize>],
) -> Vec<Assignment> {
    let mut assignments = vec![vec![None; scene.views.len()]; people.len()];
    let predictions: Vec<_> = people.iter().map(|p| p.predict(frame, scene.fps)).collect();
    for (view, camera) in scene.cameras.iter().enumerate() {
        let Some(camera) = camera else { continue };
        let (detections, free) = (scene.detections(view, frame), &free[view]);
        let cost = |p: usize, d: usize| {
            let gate = config.gate + config.gate_growth * (frame - people[p].last_seen() - 1) as f64 / scene.fps;
            let factor = if people[p].is_real(scene, config) { 1.0 } else { UNCONFIRMED_FACTOR };
            let distance = |seen: Seen| skeleton::distance_to_detection(&predictions[p], camera, seen);
            let cost = |m: f64| assignment_cost(m * factor, gate, config.gate);
            let Some(detected) = distance(Seen::as_detected(&detections[d])) else { return (IMPOSSIBLE, false) };
            let before = people[p].last_assignment()[view].map(|shown| shown.is_exchanged);
            if is_exchanged(scene, &predictions[p], camera, &detections[d], detected, before) {
                let exchanged = distance(Seen::exchanged(&detections[d], scene.mirror));
                return (exchanged.map_or(IMPOSSIBLE, |m| EXCHANGED_NATS / NATS_AT_GATE + cost(m)), true);
            }
            (cost(detected), false)
        };
        let costs: Vec<Vec<(f64, bool)>> =
            (0..people.len()).map(|p| free.iter().map(|&d| cost(p, d)).collect()).collect();
        for (p, i) in assign(people.len(), free.len(), 1.0, |p, i| costs[p][i].0).into_iter().enumerate() {
            assignments[p][view] = i.map(|i| Shown { detection: free[i], is_exchanged: costs[p][i].1 });
        }
    }
    exchanged_sides::withdraw_common(people, &mut assignments);
    assignments
}

/// Cost of a detection `distance` m from a prediction with a gate of `gate` m; 1 is the cost of no assignment.
///
/// The negative log likelihood over [`NATS_AT_GATE`]: a lost person's wide gate contains many detections, each of which is
/// the less likely this person's.
fn assignment_cost(distance: f64, gate: f64, new_gate: f64) -> f64 {
    if distance < gate { (distance / gate).powi(2) + 2.0 / NATS_AT_GATE * (gate / new_gate).ln() } else { IMPOSSIBLE }
}

/// The skeleton that the assigned detections of a frame agree on; `None` for keypoints that fewer than two views see.
pub fn skeleton(scene: &TrackerScene, frame: usize, assignment: &[Option<usize>]) -> Skeleton {
    let assignment: Assignment = assignment.iter().map(|d| d.map(Shown::as_detected)).collect();
    let seen = scene.detections_of(frame, &assignment);
    match seen[..] {
        [] => Vec::new(),
        [(_, detection)] if scene.n_confirming_views() == 1 => {
            monocular::flat_figure(scene, detection.detection, None).unwrap_or_default()
        }
        _ => skeleton::triangulated(scene, &seen),
    }
}

#[cfg(test)]
mod tests;
