//! Walls at the ends of the joints' ranges, and a pull towards the natural rest pose.

use super::super::config::BodyFitConfig;
use super::frame::{LinearisedFrame, PosedFrame};
use super::term::FrameTerm;
use super::unknowns::Unknowns;
use crate::body::joint_ranges::JointRange;
use crate::body::skeleton::N_JOINTS;
use crate::optim::block_banded::{Corner, FramePanel};
use crate::residuals::joint_angles::{JointAngleCost, JointAngleWeights, joint_angle_cost};

/// Limits of all free joints but the root.
pub(crate) struct JointLimits {
    ranges: [JointRange; N_JOINTS],
    /// Group, joint, weights.
    joints: Vec<(usize, usize, JointAngleWeights)>,
}

impl JointLimits {
    /// `with_prior`: joints that the pose prior describes and that are therefore not pulled towards rest.
    pub(crate) fn new(
        config: &BodyFitConfig,
        ranges: &[JointRange; N_JOINTS],
        unknowns: &Unknowns,
        with_prior: &[usize],
    ) -> Self {
        let weights = |joint: usize| JointAngleWeights {
            rest: if with_prior.contains(&joint) { 0.0 } else { config.rest_weight },
            limit_width: config.limit_width_deg.to_radians(),
        };
        let limited = unknowns.rotations().filter(|(_, joint)| *joint != 0);
        let joints = limited.map(|(group, joint)| (group, joint, weights(joint))).collect();
        Self { ranges: *ranges, joints }
    }

    fn costs(&self, frame: &PosedFrame) -> impl Iterator<Item = (usize, JointAngleCost)> {
        let cost = |&(group, joint, weights): &(usize, usize, JointAngleWeights)| {
            (group, joint_angle_cost(&frame.pose.rotations[joint], &self.ranges[joint], &weights))
        };
        self.joints.iter().map(cost)
    }
}

impl FrameTerm for JointLimits {
    fn cost(&self, frame: &PosedFrame) -> f64 {
        self.costs(frame).map(|(_, angle)| angle.cost).sum()
    }

    fn add_to(&self, frame: &LinearisedFrame, system: &mut FramePanel, _: &mut Corner) {
        for (group, angle) in self.costs(&frame.posed).filter(|(_, angle)| *angle != JointAngleCost::default()) {
            system.add_gradient(3 * group, &angle.gradient);
            system.add_own(3 * group, 3 * group, &angle.hessian);
        }
    }
}
