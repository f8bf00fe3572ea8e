//! The input of the fit.

use crate::body::detector_noise::DetectorNoise;
use crate::geometry::Rigid;
use crate::session::{JointTrajectory, PersonTrack, Session};
use nalgebra::Vector3;

/// Detections, cameras, tracks and triangulated keypoints of one session.
#[derive(Debug, Clone, Copy)]
pub struct BodyFitInput<'a> {
    /// The detections.
    pub session: &'a Session,
    /// Accuracy of the detector.
    pub noise: &'a DetectorNoise,
    /// `camera_from_world` by view, metres; `None` for a camera without a pose.
    pub cameras: &'a [Option<Rigid>],
    /// The detections of each person.
    pub tracks: &'a [PersonTrack],
    /// Triangulated keypoints, metres; matched to tracks by person, in any order.
    pub points: &'a [JointTrajectory],
    /// The upward direction in the world, unit length. Monocular fits use it, since a single view does not show how far
    /// people lean.
    pub up: Vector3<f64>,
}
