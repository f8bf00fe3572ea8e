//! Beginnings: persons followed backwards in time from where they were found, through detections that no other person has.
//!
//! A new person needs two views that agree, and goes on where one alone sees it. So persons who leave are followed for as long as any view
//! sees them; with time running backwards, persons who come are, too.

use super::nearest_detections::nearest_detections;
use super::person::TrackedPerson;
use super::scene::{Assignment, TrackerConfig, TrackerScene};
use super::stitching::max_gap;
use crate::progress::{Canceled, Progress};

/// Extends persons to frames before their first one.
///
/// # Errors
/// [`Canceled`].
pub(super) fn follow_backwards(
    scene: &TrackerScene,
    config: &TrackerConfig,
    people: Vec<TrackedPerson>,
    progress: &Progress,
) -> Result<Vec<TrackedPerson>, Canceled> {
    let backwards = &scene.backwards();
    let max_gap = max_gap(scene);
    let mut beginnings: Vec<TrackedPerson> = people.iter().map(|p| p.backwards_from_start(backwards)).collect();
    for frame in 0..scene.n_frames {
        if frame % 64 == 0 {
            progress.check()?;
        }
        let is_expected = |p: &TrackedPerson| p.last_seen() < frame && frame - p.last_seen() <= max_gap;
        let expected: Vec<usize> = (0..beginnings.len()).filter(|&i| is_expected(&beginnings[i])).collect();
        if expected.is_empty() {
            continue;
        }
        let free = backwards.unassigned(frame, &assigned(&people, scene.mirrored_frame(frame)));
        let followed: Vec<TrackedPerson> = expected.iter().map(|&i| std::mem::take(&mut beginnings[i])).collect();
        let assignments = nearest_detections(backwards, config, frame, &followed, &free);
        for ((i, mut person), mut assignment) in expected.into_iter().zip(followed).zip(assignments) {
            person.update(backwards, config, frame, &mut assignment);
            beginnings[i] = person;
        }
    }
    Ok(people.into_iter().zip(&beginnings).map(|(person, beginning)| person.with_beginning(scene, beginning)).collect())
}

/// What persons have of the detections of a frame.
fn assigned(people: &[TrackedPerson], frame: usize) -> Vec<Assignment> {
    let of_person = |person: &TrackedPerson| {
        let at = person.assignments.binary_search_by_key(&frame, |(frame, _)| *frame).ok()?;
        Some(person.assignments[at].1.clone())
    };
    people.iter().filter_map(of_person).collect()
}
