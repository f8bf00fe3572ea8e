//! Runs of frames in which something is not seen.

use std::ops::Range;

/// Gaps shorter than this are left to the smoothness terms, s: the shortest of the training.
pub(super) const MIN_GAP: f64 = 5.0 / 30.0;

/// Runs of frames that are not seen.
pub(super) fn gaps(seen: &[bool]) -> Vec<Range<usize>> {
    let runs = seen.chunk_by(|a, b| a == b).scan(0, |start, run| {
        let range = *start..*start + run.len();
        *start = range.end;
        Some((range, run[0]))
    });
    runs.filter(|(_, is_seen)| !is_seen).map(|(range, _)| range).collect()
}
