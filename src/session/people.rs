//! Tracks, trajectories and body motions of people: the data that the pipeline's stages exchange.

use super::recording::{FrameIndex, PersonId};
use crate::body::hand::N_FINGER_JOINTS;
use crate::body::skeleton::N_JOINTS;
use nalgebra::{Matrix3, Vector3};

/// Detections of one person in all views: `detections[frame - first][view]`.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PersonTrack {
    /// The person.
    pub person: PersonId,
    /// First frame of the track.
    pub first: FrameIndex,
    /// For every frame from `first` on and every view: index into `View::frames[frame]`, `None` without a detection of this
    /// person.
    pub detections: Vec<Vec<Option<usize>>>,
}

/// 3D points of one person over time, one per named keypoint of the session's convention, world metres.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct JointTrajectory {
    /// The person.
    pub person: PersonId,
    /// First frame.
    pub first: FrameIndex,
    /// `points[frame - first][keypoint]`; `None` where the point is unknown.
    pub points: Vec<Vec<Option<Vector3<f64>>>>,
    /// Number of views that observe each point, same shape as `points`.
    pub n_views: Vec<Vec<u8>>,
}

/// Motion of one person in SMPL's convention: one shape, and a pose for every frame without gaps.
#[derive(Debug, Clone, PartialEq)]
pub struct BodyMotion {
    /// The person.
    pub person: PersonId,
    /// First frame.
    pub first: FrameIndex,
    /// Shape coefficients (SMPL's betas), in standard deviations of the population.
    pub betas: [f64; 10],
    /// One entry per frame from `first` on.
    pub frames: Vec<BodyPose>,
    /// Standard deviations of the joints' positions by frame, three axes together, m; apart from a similarity of the whole
    /// scene. `None` where the session does not show them.
    pub joint_sigmas: Option<Vec<JointSigmas>>,
    /// The fingers of the left and the right hand, where hands were fitted.
    pub hands: Option<[HandMotion; 2]>,
}

/// Motion of a hand's fingers: one entry per frame of the [`BodyMotion`] that it belongs to.
#[derive(Debug, Clone, PartialEq)]
pub struct HandMotion {
    /// By frame.
    pub frames: Vec<HandPose>,
}

/// One frame of a [`HandMotion`]: finger joints in SMPL-H's order ([`crate::body::hand`]).
#[derive(Debug, Clone, PartialEq)]
pub struct HandPose {
    /// Local rotations, `parent_from_joint`; a finger's first joint has the wrist as parent.
    pub rotations: [Matrix3<f64>; N_FINGER_JOINTS],
    /// Positions in the world, m.
    pub joints: [Vector3<f64>; N_FINGER_JOINTS],
    /// Number of views that saw the hand.
    pub n_views: u8,
}

/// A standard deviation for each joint, m.
pub type JointSigmas = [f64; N_JOINTS];

/// One frame of a [`BodyMotion`].
#[derive(Debug, Clone, PartialEq)]
pub struct BodyPose {
    /// Local rotations of the 24 joints, `parent_from_joint`; entry 0 is `world_from_pelvis`.
    pub rotations: [Matrix3<f64>; N_JOINTS],
    /// SMPL's `transl`, metres: added after the rotation about the rest pelvis.
    pub translation: Vector3<f64>,
    /// Positions of the joints in the world, metres.
    pub joints: [Vector3<f64>; N_JOINTS],
    /// False where no camera detected the person for longer than the gap limit; the pose is then carried over.
    pub valid: bool,
}
