//! Re-acquisition: other views' unassigned detections for persons that a single view holds.
//!
//! A single view fixes a person's direction but not its depth: within a second the person may be a step away from where the other
//! views expect it. Agreement of the rays of two views then counts more than the predicted position.

use super::initialisation::agreement;
use super::scene::{Assignment, Seen, Shown, TrackerConfig, TrackerScene};
use super::skeleton::{is_human, triangulated};

/// An unassigned detection that fits a person.
struct Candidate {
    agreement: f64,
    person: usize,
    view: usize,
    detection: usize,
}

/// Assigns unassigned detections of a frame to persons that a single view holds, best agreement first.
pub(super) fn reacquire(scene: &TrackerScene, config: &TrackerConfig, frame: usize, assignments: &mut [Assignment]) {
    if assignments.iter().all(|assignment| scene.is_confirmed(assignment)) {
        return;
    }
    let free = scene.unassigned(frame, assignments);
    let mut candidates = Vec::new();
    for (person, assignment) in assignments.iter().enumerate().filter(|(_, a)| !scene.is_confirmed(a)) {
        let [(holder, held)] = scene.detections_of(frame, assignment)[..] else { continue };
        if held.is_exchanged() {
            continue;
        }
        for view in (0..scene.views.len()).filter(|view| *view != holder) {
            let Some(essential) = scene.essential(holder, view) else { continue };
            for &detection in &free[view] {
                let seen = &scene.detections(view, frame)[detection];
                let Some(agreement) = agreement(config, &essential, held.detection, seen) else { continue };
                if is_human(scene, &triangulated(scene, &[(holder, held), (view, Seen::as_detected(seen))])) {
                    candidates.push(Candidate { agreement, person, view, detection });
                }
            }
        }
    }
    candidates.sort_by(|a, b| b.agreement.total_cmp(&a.agreement));
    for Candidate { person, view, detection, .. } in candidates {
        let is_taken =
            assignments.iter().flat_map(|assignment| assignment[view]).any(|shown| shown.detection == detection);
        if !is_taken && assignments[person][view].is_none() {
            assignments[person][view] = Some(Shown::as_detected(detection));
        }
    }
}
