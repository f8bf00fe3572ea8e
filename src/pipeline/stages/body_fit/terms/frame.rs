//! One frame of a motion as terms see it: the posed body and its landmarks.

use super::super::completed_joints::GapCompletion;
use super::landmark_jacobian::{BorderJacobian, LinearLandmarks};
use super::unknowns::{Border, Unknowns};
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
    /// Group of the translation.
    translation: usize,
    completion: Option<&'a GapCompletion>,
}

impl<'a> Landmarks<'a> {
    pub(crate) fn new(model: &'a BodyModel, unknowns: &Unknowns<'a>, completion: Option<&'a GapCompletion>) -> Self {
        Self {
            model,
            border: unknowns.border,
            moving: unknowns.moving(model),
            translation: unknowns.translation(),
            completion,
        }
    }
}

/// The body posed in one frame.
pub(crate) struct PosedFrame<'a> {
    pub index: usize,
    pub pose: &'a Pose,
    pub betas: &'a Betas,
    pub skeleton: PosedSkeleton,
    /// With the joints that no keypoint shows as the motion prior states them; `None` without such joints.
    completed: Option<PosedSkeleton>,
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
        let completed = landmarks.completion.and_then(|completion| completion.with_hidden(index, pose));
        let completed = completed.map(|pose| posed(body, &pose));
        Self { index, pose, betas, skeleton: posed(body, pose), completed, body, landmarks }
    }

    /// Position of a landmark in the world, m.
    pub(crate) fn position(&self, landmark: usize) -> Vector3<f64> {
        landmark_position(self.landmarks.model, self.body, &self.skeleton, landmark)
    }

    /// Position of a landmark that is observed, m. A keypoint shows no rotation of a hidden joint, but may turn with it: hips and
    /// shoulders lie 4 to 8 cm beside their joints. A hidden limb would turn to where the detector's errors at its upper end are smallest,
    /// so that those of its joints are taken as the motion prior states them.
    pub(crate) fn observed_position(&self, landmark: usize) -> Vector3<f64> {
        landmark_position(self.landmarks.model, self.body, self.observed_skeleton(), landmark)
    }

    fn observed_skeleton(&self) -> &PosedSkeleton {
        self.completed.as_ref().unwrap_or(&self.skeleton)
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
    /// Appends a landmark with derivatives of its position.
    pub(crate) fn add_landmark(&self, landmark: usize, to: &mut LinearLandmarks) {
        self.add(landmark, &self.posed.skeleton, |_| true, to);
    }

    /// The same of [`PosedFrame::observed_position`].
    pub(crate) fn add_observed(&self, landmark: usize, to: &mut LinearLandmarks) {
        let PosedFrame { index, landmarks, .. } = self.posed;
        let moves = |joint| !landmarks.completion.is_some_and(|completion| completion.hides(index, joint));
        self.add(landmark, self.posed.observed_skeleton(), moves, to);
    }

    fn add(&self, landmark: usize, skeleton: &PosedSkeleton, moves: impl Fn(usize) -> bool, to: &mut LinearLandmarks) {
        let PosedFrame { body, landmarks: Landmarks { model, border, moving, translation, .. }, .. } = &self.posed;
        let by_rotation = |&(group, joint): &(usize, usize)| {
            (3 * group, landmark_by_rotation(model, body, skeleton, landmark, joint))
        };
        let moving = moving[landmark].iter().filter(|(_, joint)| moves(*joint));
        to.push(
            landmark_position(model, body, skeleton, landmark),
            moving.map(by_rotation).chain([(3 * translation, Matrix3::identity())]),
            BorderJacobian::new(border, model, landmark, skeleton, self.joint_directions.as_ref()),
        );
    }
}
