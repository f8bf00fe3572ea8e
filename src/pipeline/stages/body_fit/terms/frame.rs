//! One frame of a motion as terms see it: the posed body and its landmarks.

use super::landmark_jacobian::{BorderJacobian, LandmarkJacobian};
use super::unknowns::{Border, TRANSLATION_GROUP, Unknowns};
use crate::body::kinematics::{Pose, PosedSkeleton, joints_by_betas, landmark_by_rotation, landmark_position, posed};
use crate::body::model::{Betas, BodyModel, ShapeDirections, ShapedBody};
use crate::body::skeleton::N_JOINTS;
use nalgebra::{Matrix3, Vector3};

/// The landmarks of the body model and which unknowns move each.
pub(crate) struct Landmarks<'a> {
    model: &'a BodyModel,
    border: Border<'a>,
    /// By landmark: groups and joints, see [`Unknowns::moving`].
    moving: Vec<Vec<(usize, usize)>>,
}

impl<'a> Landmarks<'a> {
    pub(crate) fn new(model: &'a BodyModel, unknowns: &Unknowns<'a>) -> Self {
        Self { model, border: unknowns.border, moving: unknowns.moving(model) }
    }
}

/// The body posed in one frame.
pub(crate) struct PosedFrame<'a> {
    pub index: usize,
    pub pose: &'a Pose,
    pub betas: &'a Betas,
    pub skeleton: PosedSkeleton,
    body: &'a ShapedBody,
    landmarks: &'a Landmarks<'a>,
}

impl<'a> PosedFrame<'a> {
    /// `body`: the model with the shape `betas`.
    pub(crate) fn new(
        landmarks: &'a Landmarks<'a>,
        (body, betas): (&'a ShapedBody, &'a Betas),
        index: usize,
        pose: &'a Pose,
    ) -> Self {
        Self { index, pose, betas, skeleton: posed(body, pose), body, landmarks }
    }

    /// Position of a landmark in the world, m.
    pub(crate) fn position(&self, landmark: usize) -> Vector3<f64> {
        landmark_position(self.landmarks.model, self.body, &self.skeleton, landmark)
    }

    /// The same with what derivatives need.
    pub(crate) fn linearised(self) -> LinearisedFrame<'a> {
        let has_betas = !self.landmarks.border.betas().is_empty();
        let joint_directions = has_betas.then(|| joints_by_betas(self.landmarks.model, &self.skeleton));
        LinearisedFrame { posed: self, joint_directions }
    }
}

/// The body posed in one frame with derivatives of its landmarks.
pub(crate) struct LinearisedFrame<'a> {
    pub posed: PosedFrame<'a>,
    /// Derivatives of the joints by the betas, where these are free.
    joint_directions: Option<[ShapeDirections; N_JOINTS]>,
}

impl LinearisedFrame<'_> {
    /// Derivatives of a landmark's position.
    pub(crate) fn jacobian(&self, landmark: usize) -> LandmarkJacobian {
        let PosedFrame { skeleton, body, landmarks: Landmarks { model, border, moving }, .. } = &self.posed;
        let by_rotation =
            |&(group, joint): &(usize, usize)| (group, landmark_by_rotation(model, body, skeleton, landmark, joint));
        let by_translation = std::iter::once((TRANSLATION_GROUP, Matrix3::identity()));
        LandmarkJacobian {
            by_frame: by_translation.chain(moving[landmark].iter().map(by_rotation)).collect(),
            by_border: BorderJacobian::new(border, model, landmark, skeleton, self.joint_directions.as_ref()),
        }
    }
}
