//! The 3D tracker: assigns every detection to a person, frame by frame, under known cameras.
//!
//! A person is a predicted skeleton (`person`). In each frame every view assigns its detections to the nearest predictions
//! (`nearest_detections`); persons held by a single view are re-acquired by the others (`reacquisition`); unassigned
//! detections start new persons (`initialisation`), or continue a person that is lost where no other person can be meant
//! (`continuation`).
//! A detector may have exchanged a person's left and right (`exchanged_sides`). At last persons are followed backwards from where
//! they were found (`beginnings`).
//! Long takes are followed in windows side by side (`tracking_windows`). At the end duplicates are merged (`duplicate_merging`),
//! and fragments of one person are joined (`stitching`) by position, build and the detectors' track numbers
//! (`reidentification`).

mod beginnings;
mod continuation;
mod duplicate_merging;
mod exchanged_sides;
mod initialisation;
mod monocular;
mod nearest_detections;
mod person;
mod reacquisition;
mod reidentification;
mod scene;
mod skeleton;
mod stitching;
mod tracking_windows;

use crate::progress::{Canceled, Progress};
use exchanged_sides::with_usual_sides;
use nearest_detections::nearest_detections;
pub use person::TrackedPerson;
use rayon::prelude::*;
pub use scene::{Assignment, Shown, TrackerConfig, TrackerScene};
pub use skeleton::Skeleton;
use std::ops::Range;
use tracking_windows::TrackingWindows;

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
    // Below one frame each second people would be gone before the next frame.
    let max_gap = ((config.max_gap * scene.fps) as usize).max(1);
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
