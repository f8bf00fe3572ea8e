//! The pose prior: how likely a pose is among recorded ones.

use super::super::config::BodyFitConfig;
use super::frame::{LinearisedFrame, PosedFrame};
use super::term::FrameTerm;
use super::unknowns::Unknowns;
use crate::body::model::BodyModel;
use crate::motion_prior::MotionPrior;
use crate::motion_prior::pose_gaussian::PoseGaussian;
use crate::optim::block_banded::{Corner, FramePanel};
use crate::residuals::pose_likelihood::{PoseWeights, pose_cost, pose_derivatives};

/// The motion prior's Gaussian over the rotations of the free joints, in the body's own skeleton.
pub(crate) struct PosePrior {
    poses: PoseGaussian,
    /// Group of each of the Gaussian's joints.
    groups: Vec<usize>,
    weights: PoseWeights,
    /// Frames that it leaves to other terms; none where it is shorter.
    left_out: Vec<bool>,
}

impl PosePrior {
    pub(crate) fn new(model: &BodyModel, config: &BodyFitConfig, unknowns: &Unknowns) -> Self {
        let mocap = PoseGaussian::over(MotionPrior::embedded().basis(), &unknowns.joints);
        let poses = mocap.retargeted_to(&model.mocap_from_body);
        let groups = poses.joints.iter().filter_map(|&joint| unknowns.group(joint)).collect();
        Self { poses, groups, weights: config.pose_weights, left_out: Vec::new() }
    }

    /// The same without the frames in which the motion prior completes joints: likely single poses would draw them from the
    /// motion's course to the mean pose.
    pub(crate) fn without(self, left_out: Vec<bool>) -> Self {
        Self { left_out, ..self }
    }

    fn leaves_out(&self, frame: usize) -> bool {
        self.left_out.get(frame).is_some_and(|left_out| *left_out)
    }

    /// The joints that it describes.
    pub(crate) fn joints(&self) -> &[usize] {
        &self.poses.joints
    }
}

impl FrameTerm for PosePrior {
    fn cost(&self, frame: &PosedFrame) -> f64 {
        if self.leaves_out(frame.index) {
            return 0.0;
        }
        pose_cost(&frame.pose.rotations, &self.poses, &self.weights)
    }

    fn add_to(&self, frame: &LinearisedFrame, system: &mut FramePanel, _: &mut Corner) {
        if self.leaves_out(frame.posed.index) {
            return;
        }
        let found = pose_derivatives(&frame.posed.pose.rotations, &self.poses, &self.weights);
        for (i, &row) in self.groups.iter().enumerate() {
            system.add_gradient(3 * row, &found.gradient.fixed_rows::<3>(3 * i).into_owned());
            for (k, &column) in self.groups.iter().enumerate().take(i + 1) {
                system.add_own(3 * row, 3 * column, &found.hessian.fixed_view::<3, 3>(3 * i, 3 * k).into_owned());
            }
        }
    }
}
