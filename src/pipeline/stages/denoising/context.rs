//! Input of the repair, its records, and what all of its steps read.

use super::flips::{Flip, flips};
use crate::body::detector_noise::DetectorNoise;
use crate::geometry::Rigid;
use crate::matching::normalized::NormalizedView;
use crate::session::{JointTrajectory, PersonTrack, Session};

/// Input of the stage.
#[derive(Clone, Copy)]
pub struct DenoisingInput<'a> {
    /// The original detections.
    pub session: &'a Session,
    /// The same in normalised coordinates.
    pub views: &'a [NormalizedView],
    /// `camera_from_world` per view; the unit is a metre as far as bone lengths show.
    pub cameras: &'a [Option<Rigid>],
    /// The association so far.
    pub tracks: &'a [PersonTrack],
    /// Every person's smooth trajectory, in the order of the tracks.
    pub trajectories: &'a [JointTrajectory],
    /// Detector noise.
    pub noise: &'a DetectorNoise,
}

/// Input of all steps.
pub(super) struct Context<'a> {
    pub(super) input: DenoisingInput<'a>,
    /// The candidate flips; the first changes nothing.
    pub(super) flips: Vec<Flip>,
}

impl<'a> Context<'a> {
    pub(super) fn new(input: DenoisingInput<'a>) -> Self {
        Self { input, flips: flips(input.session.convention) }
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
