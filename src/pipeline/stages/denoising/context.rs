//! Records of the repair, and what all of its steps read.

use super::flips::{Flip, flips};
use crate::matching::normalized::NormalizedView;
use crate::pipeline::calibration::TrackedPeople;

/// Input of all steps.
pub(super) struct Context<'a> {
    /// Every person's points are the smooth trajectory.
    pub(super) input: TrackedPeople<'a>,
    /// The original detections in normalised coordinates.
    pub(super) views: &'a [NormalizedView],
    /// The candidate flips; the first changes nothing.
    pub(super) flips: Vec<Flip>,
}

impl<'a> Context<'a> {
    pub(super) fn new(input: TrackedPeople<'a>, views: &'a [NormalizedView]) -> Self {
        Self { input, views, flips: flips(input.session.convention) }
    }
}

/// Repairs of one frame.
pub(super) struct FrameRepairs {
    pub(super) repairs: Vec<Repair>,
    /// Whether the frame was ambiguous and solved as one matching.
    pub(super) is_ambiguous: bool,
}

/// A detection assigned to a person, and the changes to it.
pub(super) struct Repair {
    /// Index of the track.
    pub(super) track: usize,
    pub(super) at: DetectionIndex,
    /// Index of the flip.
    pub(super) flip: usize,
    /// Rejected keypoints, after the flip.
    pub(super) rejected: Vec<usize>,
}

/// Index of a detection in the session.
#[derive(Debug, Clone, Copy)]
pub(super) struct DetectionIndex {
    pub(super) view: usize,
    pub(super) frame: usize,
    pub(super) detection: usize,
}
