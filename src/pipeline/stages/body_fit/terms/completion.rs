//! Joints that no camera, or one alone, shows for a while: Gaussians about what the motion prior states from the rest of the motion.

use super::super::completed_joints::GapCompletion;
use super::frame::{LinearisedFrame, PosedFrame};
use super::term::FrameTerm;
use super::unknowns::Unknowns;
use crate::optim::block_banded::{Corner, FramePanel};
use crate::residuals::rotation_likelihood::{RotationGaussian, rotation_cost, rotation_derivatives};

/// The term of the completed and guided joints that are unknowns.
pub(crate) struct Completion {
    /// By frame: joint, its group, and the Gaussian over its rotation.
    frames: Vec<Vec<(usize, usize, RotationGaussian)>>,
}

impl Completion {
    pub(crate) fn new(gaps: &GapCompletion, unknowns: &Unknowns) -> Self {
        let of_frame = |frame: usize| {
            gaps.stated(frame)
                .filter_map(|&(joint, gaussian)| Some((joint, unknowns.group(joint)?, gaussian)))
                .collect()
        };
        Self { frames: (0..gaps.hidden.len()).map(of_frame).collect() }
    }
}

impl FrameTerm for Completion {
    fn cost(&self, frame: &PosedFrame) -> f64 {
        let rotations = &frame.pose.rotations;
        self.frames[frame.index].iter().map(|(joint, _, gaussian)| rotation_cost(&rotations[*joint], gaussian)).sum()
    }

    fn add_to(&self, frame: &LinearisedFrame, system: &mut FramePanel, _: &mut Corner) {
        for (joint, group, gaussian) in &self.frames[frame.posed.index] {
            let found = rotation_derivatives(&frame.posed.pose.rotations[*joint], gaussian);
            system.add_gradient(3 * group, &found.gradient);
            system.add_own(3 * group, 3 * group, &found.hessian);
        }
    }
}
