//! The joints of a window that the motion prior completes.

use super::terms::unknowns::MotionState;
use crate::body::kinematics::Pose;
use crate::body::skeleton::chain_to_root;
use crate::motion_prior::observed::SPINE;
use crate::residuals::rotation_likelihood::RotationGaussian;
use std::ops::Range;

/// What the motion prior states about the joints of a window that no camera shows, and those that one alone does.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct GapCompletion {
    /// By frame: joint that no keypoint shows, and the Gaussian over its rotation on the body.
    pub hidden: Vec<Vec<(usize, RotationGaussian)>>,
    /// The same of joints that one camera alone shows.
    pub guided: Vec<Vec<(usize, RotationGaussian)>>,
}

impl GapCompletion {
    /// Of some of the frames.
    pub(super) fn of(&self, frames: Range<usize>) -> Self {
        Self { hidden: self.hidden[frames.clone()].to_vec(), guided: self.guided[frames].to_vec() }
    }

    /// The motion with the mean rotations of the completed and guided joints.
    pub(super) fn applied_to(&self, mut state: MotionState) -> MotionState {
        for (frame, pose) in state.poses.iter_mut().enumerate() {
            self.stated(frame).for_each(|(joint, gaussian)| pose.rotations[*joint] = gaussian.mean);
        }
        state
    }

    /// All that is stated of a frame.
    pub(crate) fn stated(&self, frame: usize) -> impl Iterator<Item = &(usize, RotationGaussian)> {
        [&self.hidden, &self.guided].into_iter().filter_map(move |frames| frames.get(frame)).flatten()
    }

    /// A frame's pose with the mean rotations of the joints that no keypoint shows; `None` without such joints. Keypoints of the
    /// trunk turn with the spine, also where it is completed.
    pub(crate) fn with_hidden(&self, frame: usize, pose: &Pose) -> Option<Pose> {
        let joints = self.hidden.get(frame).filter(|joints| !joints.is_empty())?;
        let mut completed = *pose;
        let limbs = joints.iter().filter(|(joint, _)| !SPINE.contains(joint));
        limbs.for_each(|(joint, gaussian)| completed.rotations[*joint] = gaussian.mean);
        Some(completed)
    }

    /// Whether no keypoint shows a joint in a frame.
    pub(crate) fn hides(&self, frame: usize, joint: usize) -> bool {
        let is_completed = |joints: &Vec<(usize, _)>| joints.iter().any(|(completed, _)| *completed == joint);
        !SPINE.contains(&joint) && self.hidden.get(frame).is_some_and(is_completed)
    }

    /// Whether no keypoint shows the person in a frame.
    pub(super) fn hides_person(&self, frame: usize) -> bool {
        self.hides(frame, 0)
    }

    /// Whether no keypoint shows a joint between the root and this one, so that it lies where the completion has it.
    pub(super) fn hides_before(&self, frame: usize, joint: usize) -> bool {
        chain_to_root(joint).skip(1).any(|ancestor| self.hides(frame, ancestor))
    }

    /// By frame: the completed joints.
    pub(super) fn completed_joints(&self) -> Vec<Vec<usize>> {
        self.hidden.iter().map(|joints| joints.iter().map(|(joint, _)| *joint).collect()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    /// A hidden left elbow and a hidden spine.
    #[test]
    fn joints_behind_hidden_ones_lie_where_these_are_completed() {
        let vague = RotationGaussian { mean: Matrix3::identity(), precision: Matrix3::zeros() };
        let completion =
            GapCompletion { hidden: vec![vec![(18, vague), (SPINE[0], vague)]], guided: vec![vec![(17, vague)]] };
        let behind: Vec<usize> = (0..24).filter(|joint| completion.hides_before(0, *joint)).collect();
        assert_eq!(behind, [20, 22], "wrist and hand");
        assert!(!completion.hides_before(1, 20), "a frame of which nothing is stated");
        let without_root = GapCompletion { hidden: vec![vec![(0, vague)]], guided: Vec::new() };
        assert!(without_root.hides_person(0) && !completion.hides_person(0));
    }
}
