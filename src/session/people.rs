//! People in motion: what the stages hand each other.

use super::recording::{FrameIndex, PersonId};
use crate::body::skeleton::N_JOINTS;
use nalgebra::{Matrix3, Vector3};

/// Which detection shows the person, per frame and view: `detection[frame - first][view]`.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PersonTrack {
    /// Who.
    pub person: PersonId,
    /// First frame of the track.
    pub first: FrameIndex,
    /// For every frame from `first` on and every view: index into `View::frames[frame]`, if given to this person.
    pub detections: Vec<Vec<Option<usize>>>,
}

/// Points of one person over time in the session's keypoint convention (named body keypoints only), world metres.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct JointTrajectory {
    /// Who.
    pub person: PersonId,
    /// First frame.
    pub first: FrameIndex,
    /// `points[frame - first][keypoint]`; `None` where nothing is known.
    pub points: Vec<Vec<Option<Vector3<f64>>>>,
    /// How many views each point was seen in, same shape.
    pub n_views: Vec<Vec<u8>>,
}

/// SMPL-convention motion of one person: shape once, pose per frame without holes.
#[derive(Debug, Clone, PartialEq)]
pub struct BodyMotion {
    /// Who.
    pub person: PersonId,
    /// First frame.
    pub first: FrameIndex,
    /// Shape coefficients, population standard deviations.
    pub betas: [f64; 10],
    /// One entry per frame from `first` on.
    pub frames: Vec<BodyPose>,
}

/// One frame of a [`BodyMotion`].
#[derive(Debug, Clone, PartialEq)]
pub struct BodyPose {
    /// Local rotations of the 24 joints (`parent_from_joint`); entry 0 is the root's, `world_from_pelvis`.
    pub rotations: [Matrix3<f64>; N_JOINTS],
    /// SMPL's `transl`: added after the rotation about the rest pelvis, metres.
    pub translation: Vector3<f64>,
    /// Posed joints in the world, metres.
    pub joints: [Vector3<f64>; N_JOINTS],
    /// False where nobody saw the person for longer than the gap limit.
    pub valid: bool,
}
