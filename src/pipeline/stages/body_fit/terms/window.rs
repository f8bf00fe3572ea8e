//! Three successive frames, on which terms of accelerations depend.

use super::landmark_jacobian::LandmarkJacobian;
use crate::body::kinematics::Pose;
use nalgebra::Vector3;

/// Three successive frames.
pub(crate) struct Window<'a, L> {
    /// Index of the middle frame.
    pub middle: usize,
    pub poses: [&'a Pose; 3],
    /// By frame the landmarks whose paths terms look at, in the order of the problem's list of them.
    pub tracked: [&'a [L]; 3],
}

impl<'a, L> Window<'a, L> {
    /// The window about frame `middle` of a motion.
    pub(crate) fn new(middle: usize, poses: &'a [Pose], tracked: &'a [Vec<L>]) -> Self {
        let frames = [middle - 1, middle, middle + 1];
        Self { middle, poses: frames.map(|t| &poses[t]), tracked: frames.map(|t| tracked[t].as_slice()) }
    }
}

/// A landmark in one frame with derivatives.
pub(crate) struct TrackedLandmark {
    /// World, m.
    pub position: Vector3<f64>,
    pub jacobian: LandmarkJacobian,
}
