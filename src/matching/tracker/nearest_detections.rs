//! Detections of a frame for the persons who are expected in it.

use super::exchanged_sides::{self, EXCHANGED_NATS, MAX_EXCHANGED_M, is_exchanged};
use super::person::TrackedPerson;
use super::scene::{Assignment, Seen, Shown, TrackerConfig, TrackerScene};
use super::skeleton;
use crate::matching::assignment::assign;

/// A person that is not confirmed yet must be this many times as near.
const UNCONFIRMED_FACTOR: f64 = 1.3;

/// Negative log likelihood, nats, of a detection at the edge of a new gate, which lies at three standard deviations.
const NATS_AT_GATE: f64 = 4.5;

/// Cost of an impossible assignment; the limit is 1.
const IMPOSSIBLE: f64 = 2.0;

/// For each person the `free` detection of every view that lies nearest to the prediction, one detection to one person.
pub(super) fn nearest_detections(
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
            let limit = (gate / factor).max(MAX_EXCHANGED_M);
            let distance = |seen: Seen| skeleton::distance_within(&predictions[p], camera, seen, limit);
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
