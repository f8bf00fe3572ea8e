//! Tracking windows: long takes are tracked piece by piece, side by side, and persons joined by the detections that they share
//! where two windows overlap.
//!
//! The grid is fixed by the take, not by the number of threads. Nothing is lost at its seams that would be kept elsewhere:
//! persons out of sight for longer than a stitching gap are joined by evidence anyway, and an overlap is longer than that.

use super::person::TrackedPerson;
use super::scene::{Assignment, TrackerConfig, TrackerScene};
use crate::matching::assignment::assign;
use std::collections::BTreeSet;
use std::ops::Range;

/// Shortest window, s: the overlap, which is tracked twice, is a tenth of it.
const WINDOW_SECS: f64 = 10.0;

/// Joined persons share more than this part of the detections of the one that has fewer in the overlap.
const MIN_SHARED: f64 = 0.5;

/// Equal windows. All but the first are begun early, in the frames of the one before.
pub(super) struct TrackingWindows {
    /// The first frame that each window has to itself, and the end of the take.
    seams: Vec<usize>,
    /// Frames by which a window is begun early.
    overlap: usize,
}

impl TrackingWindows {
    /// By the end of an overlap new persons are confirmed, and lost ones were seen again or are gone.
    pub(super) fn of(scene: &TrackerScene, config: &TrackerConfig) -> Self {
        let count = ((scene.n_frames as f64 / (WINDOW_SECS * scene.fps)) as usize).max(1);
        let seams = (0..=count).map(|i| i * scene.n_frames / count).collect();
        Self { seams, overlap: (config.max_gap.max(config.min_duration) * scene.fps).ceil() as usize }
    }

    /// The frames to be tracked, window by window.
    pub(super) fn frames(&self) -> Vec<Range<usize>> {
        self.seams.array_windows().map(|&[seam, end]| seam.saturating_sub(self.overlap)..end).collect()
    }

    /// All persons, from those of each window.
    pub(super) fn joined(&self, scene: &TrackerScene, of_windows: Vec<Vec<TrackedPerson>>) -> Vec<TrackedPerson> {
        let mut of_windows = of_windows.into_iter();
        let mut people = of_windows.next().unwrap_or_default();
        for (later, seam) in of_windows.zip(&self.seams[1..]) {
            self.join(scene, &mut people, later, *seam);
        }
        people
    }

    /// Lets persons go on as those of the window that begins at `seam`, which are new where no one shares their detections.
    fn join(&self, scene: &TrackerScene, people: &mut Vec<TrackedPerson>, later: Vec<TrackedPerson>, seam: usize) {
        let overlap = seam.saturating_sub(self.overlap)..seam;
        let present: Vec<usize> = (0..people.len()).filter(|&i| people[i].last_seen() >= overlap.start).collect();
        let before: Vec<BTreeSet<_>> = present.iter().map(|&i| detections(&people[i], &overlap)).collect();
        let after: Vec<BTreeSet<_>> = later.iter().map(|person| detections(person, &overlap)).collect();
        let cost = |i: usize, j: usize| {
            let n_shared = before[i].intersection(&after[j]).count() as f64;
            let n_least = before[i].len().min(after[j].len()) as f64;
            if n_shared > MIN_SHARED * n_least { -n_shared } else { 0.0 }
        };
        let continued = assign(before.len(), after.len(), 0.0, cost);
        for (j, person) in later.into_iter().enumerate() {
            let start = person.assignments.partition_point(|(frame, _)| *frame < seam);
            if start == person.assignments.len() {
                continue;
            }
            let rest = person.piece(scene, start..person.assignments.len());
            match continued.iter().position(|next| *next == Some(j)) {
                Some(i) => people[present[i]].append(rest),
                None => people.push(rest),
            }
        }
    }
}

/// Frame, view and number of a person's detections in some frames.
fn detections(person: &TrackedPerson, frames: &Range<usize>) -> BTreeSet<(usize, usize, usize)> {
    let [start, end] = [frames.start, frames.end].map(|frame| person.assignments.partition_point(|(f, _)| *f < frame));
    let of_frame = |(frame, assignment): &(usize, Assignment)| {
        let frame = *frame;
        let seen = assignment
            .iter()
            .enumerate()
            .filter_map(move |(view, shown)| shown.map(|shown| (frame, view, shown.detection)));
        seen.collect::<Vec<_>>()
    };
    person.assignments[start..end].iter().flat_map(of_frame).collect()
}
