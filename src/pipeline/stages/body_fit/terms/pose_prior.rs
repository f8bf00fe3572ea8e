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
    /// The Gaussian over all of its joints, then its marginals.
    gaussians: Vec<Marginal>,
    /// Which of them each frame has; the first where this is shorter.
    of_frame: Vec<usize>,
    weights: PoseWeights,
}

/// The Gaussian over some joints.
struct Marginal {
    poses: PoseGaussian,
    /// Group of each of its joints.
    groups: Vec<usize>,
}

impl PosePrior {
    /// `completed`: by frame the joints that the motion prior completes, to which the Gaussian over the others is indifferent:
    /// likely single poses would draw them from the motion's course to the mean pose.
    pub(crate) fn new(
        model: &BodyModel,
        config: &BodyFitConfig,
        unknowns: &Unknowns,
        completed: &[Vec<usize>],
    ) -> Self {
        let without = |left_out: &[usize]| {
            let joints: Vec<usize> =
                unknowns.joints.iter().copied().filter(|joint| !left_out.contains(joint)).collect();
            let poses =
                PoseGaussian::over(MotionPrior::embedded().basis(), &joints).retargeted_to(&model.mocap_from_body);
            let groups = poses.joints.iter().filter_map(|&joint| unknowns.group(joint)).collect();
            Marginal { poses, groups }
        };
        let mut left_out: Vec<&[usize]> = vec![&[]];
        let mut of_frame = Vec::with_capacity(completed.len());
        for joints in completed {
            let known = left_out.iter().position(|known| known == joints);
            of_frame.push(known.unwrap_or(left_out.len()));
            left_out.extend(known.is_none().then_some(joints.as_slice()));
        }
        Self { gaussians: left_out.into_iter().map(without).collect(), of_frame, weights: config.pose_weights }
    }

    /// The joints that it describes.
    pub(crate) fn joints(&self) -> &[usize] {
        &self.gaussians[0].poses.joints
    }

    /// The Gaussian of a frame; `None` where all of its joints are completed.
    fn at(&self, frame: usize) -> Option<&Marginal> {
        let marginal = &self.gaussians[self.of_frame.get(frame).copied().unwrap_or(0)];
        (!marginal.groups.is_empty()).then_some(marginal)
    }
}

impl FrameTerm for PosePrior {
    fn cost(&self, frame: &PosedFrame) -> f64 {
        self.at(frame.index).map_or(0.0, |own| pose_cost(&frame.pose.rotations, &own.poses, &self.weights))
    }

    fn add_to(&self, frame: &LinearisedFrame, system: &mut FramePanel, _: &mut Corner) {
        let Some(Marginal { poses, groups }) = self.at(frame.posed.index) else { return };
        let found = pose_derivatives(&frame.posed.pose.rotations, poses, &self.weights);
        for (i, &row) in groups.iter().enumerate() {
            system.add_gradient(3 * row, &found.gradient(i));
            for (&column, block) in groups.iter().zip(found.hessian(i, 0..i + 1)) {
                // Only the lower triangle is read.
                match row >= column {
                    true => system.add_own(3 * row, 3 * column, &block),
                    false => system.add_own(3 * column, 3 * row, &block.transpose()),
                }
            }
        }
    }
}
