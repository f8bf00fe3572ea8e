//! The unknowns of a motion, and their places in the Gauss-Newton system.

use super::camera_unknowns::CameraUnknowns;
use crate::body::anthropometry::N_BETAS;
use crate::body::bone_offsets::N_BONES;
use crate::body::detector_offsets::OffsetTable;
use crate::body::kinematics::{Pose, moving_joints};
use crate::body::model::{Betas, BodyModel};
use crate::body::skeleton::N_JOINTS;
use crate::geometry::rotation;
use crate::optim::block_banded::BandedStep;
use std::ops::Range;

/// Values of the unknowns of one person's motion.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct MotionState {
    pub betas: Betas,
    /// One per frame.
    pub poses: Vec<Pose>,
}

impl MotionState {
    /// The motion in some of its frames.
    pub(crate) fn of(&self, frames: &Range<usize>) -> Self {
        self.thinned(frames.clone(), 1)
    }

    /// The motion in every `stride`-th of some of its frames.
    pub(crate) fn thinned(&self, frames: Range<usize>, stride: usize) -> Self {
        Self { betas: self.betas, poses: self.poses[frames].iter().step_by(stride).copied().collect() }
    }
}

/// Whether the betas are unknowns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Shape {
    Free,
    Held,
}

/// Columns of the unknowns that all frames share.
///
/// First those of the person (betas, bone offsets), then those of the whole session (keypoint offsets), so that a session
/// can eliminate each person's own and add up what remains.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Border<'a> {
    pub shape: Shape,
    /// Whether the person's bone offsets are unknowns. Their values, and those of keypoint offsets, are in the body model.
    pub has_bones: bool,
    /// The keypoint offsets, where they are unknowns.
    pub bias: Option<&'a OffsetTable>,
    /// The cameras, where they are unknowns.
    pub cameras: CameraColumns,
}

/// Cameras whose unknowns are in the border.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct CameraColumns {
    /// All of the observations, or none.
    pub n_cameras: usize,
    /// Of each.
    pub unknowns: CameraUnknowns,
}

impl CameraColumns {
    /// Number of columns.
    pub(crate) fn len(&self) -> usize {
        self.n_cameras * self.unknowns.len()
    }
}

impl Border<'_> {
    /// Columns of the betas.
    pub(crate) fn betas(&self) -> Range<usize> {
        0..if self.shape == Shape::Free { N_BETAS } else { 0 }
    }

    /// Columns of the bone offsets, three per bone.
    pub(crate) fn bones(&self) -> Range<usize> {
        let first = self.betas().end;
        first..first + if self.has_bones { 3 * N_BONES } else { 0 }
    }

    /// Columns of the keypoint offsets, three per kind of keypoint.
    pub(crate) fn keypoint_bias(&self) -> Range<usize> {
        let first = self.bones().end;
        first..first + self.bias.map_or(0, |table| 3 * table.kinds.len())
    }

    /// Columns of the cameras, [`CameraUnknowns`] each.
    pub(crate) fn camera_columns(&self) -> Range<usize> {
        let first = self.keypoint_bias().end;
        first..first + self.cameras.len()
    }

    /// Columns of the person's own unknowns.
    pub(crate) fn person(&self) -> Range<usize> {
        0..self.bones().end
    }

    /// Columns of the unknowns that all persons of the session share.
    pub(crate) fn session(&self) -> Range<usize> {
        self.person().end..self.len()
    }

    /// Number of columns.
    pub(crate) fn len(&self) -> usize {
        self.camera_columns().end
    }
}

/// The joints that may be unknowns, limb after limb, each from its end to the trunk; hands are never unknowns, since no keypoint shows
/// their rotation.
///
/// What frames have in common with those two frames later (slow errors, smoothness) lies within a limb and the trunk: in this order
/// a fifth of it is zeros at the beginning of rows, which elimination leaves out.
const ORDER: [usize; 22] = [10, 7, 4, 1, 11, 8, 5, 2, 15, 12, 20, 18, 16, 13, 21, 19, 17, 14, 9, 6, 3, 0];

/// Which unknowns are free.
#[derive(Debug, Clone)]
pub(crate) struct Unknowns<'a> {
    /// Joints that rotate, in the order of their groups of three unknowns; the root is the last. The others keep the rotation they
    /// started with.
    pub joints: Vec<usize>,
    pub border: Border<'a>,
}

impl<'a> Unknowns<'a> {
    /// The root and all `joints` but the hands.
    pub(crate) fn new(joints: impl Iterator<Item = usize>, border: Border<'a>) -> Self {
        let mut is_free = [false; N_JOINTS];
        is_free[0] = true;
        joints.for_each(|joint| is_free[joint] = true);
        Self { joints: ORDER.into_iter().filter(|&joint| is_free[joint]).collect(), border }
    }

    /// Groups of a frame.
    pub(crate) fn n_groups(&self) -> usize {
        self.joints.len() + 1
    }

    /// Group of the translation, the last one.
    pub(crate) fn translation(&self) -> usize {
        self.joints.len()
    }

    /// Group of a joint's rotation; `None` where it is held.
    pub(crate) fn group(&self, joint: usize) -> Option<usize> {
        self.joints.iter().position(|free| *free == joint)
    }

    /// Groups, ascending, and joints of the rotations.
    pub(crate) fn rotations(&self) -> impl Iterator<Item = (usize, usize)> {
        self.joints.iter().copied().enumerate()
    }

    /// By landmark the groups, ascending, and joints of the rotations that move it.
    pub(crate) fn moving(&self, model: &BodyModel) -> Vec<Vec<(usize, usize)>> {
        let of_landmark = |landmark| {
            let moves = moving_joints(landmark);
            self.rotations().filter(|(_, joint)| moves.contains(joint)).collect()
        };
        model.landmarks.iter().map(of_landmark).collect()
    }

    /// The state after a step of the solver: betas added, right increments of the rotations. Bone and keypoint offsets
    /// are not part of the state.
    pub(crate) fn moved(&self, state: &MotionState, step: &BandedStep) -> MotionState {
        let mut moved = state.clone();
        if self.border.shape == Shape::Free {
            moved.betas += step.border.fixed_rows::<N_BETAS>(0);
        }
        for (pose, step) in moved.poses.iter_mut().zip(&step.frames) {
            let increment = |group: usize| step.fixed_rows::<3>(3 * group).into_owned();
            pose.translation += increment(self.translation());
            for (group, joint) in self.rotations() {
                pose.rotations[joint] *= rotation::exp(&increment(group));
            }
        }
        moved
    }
}
