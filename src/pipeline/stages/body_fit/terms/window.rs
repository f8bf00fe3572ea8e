//! Three successive frames, on which terms of accelerations depend, and the Gauss-Newton blocks of an acceleration.

use super::landmark_jacobian::LinearLandmarks;
use crate::body::kinematics::Pose;
use crate::optim::block_banded::FramePanel;
use crate::residuals::acceleration::{LinearRotationStep, acceleration_cost};
use nalgebra::{Matrix3, Vector3};

/// Three successive frames. `L`: of a landmark's position, `T`: of a joint's step from frame to frame, each with or without derivatives.
pub(crate) struct Window<'a, L, T> {
    /// Index of the middle frame.
    pub middle: usize,
    pub poses: [&'a Pose; 3],
    /// By frame the landmarks whose paths terms look at, in the order of the problem's list of them: their positions (world, m),
    /// or [`LinearLandmarks`].
    pub tracked: [&'a L; 3],
    /// Steps of the free rotations to the middle frame and from there, by group.
    pub turns: [&'a [T]; 2],
}

/// With positions and steps alone, for the cost.
pub(crate) type PosedWindow<'a> = Window<'a, Vec<Vector3<f64>>, Vector3<f64>>;

/// With derivatives.
pub(crate) type LinearisedWindow<'a> = Window<'a, LinearLandmarks, LinearRotationStep>;

impl<'a, L, T> Window<'a, L, T> {
    /// The window about frame `middle` of a motion. `turns`: from each frame to the next.
    pub(crate) fn new(middle: usize, poses: &'a [Pose], tracked: &'a [L], turns: &'a [Vec<T>]) -> Self {
        let frames = [middle - 1, middle, middle + 1];
        let (poses, tracked) = (frames.map(|t| &poses[t]), frames.map(|t| &tracked[t]));
        Self { middle, poses, tracked, turns: [&turns[middle - 1], &turns[middle]] }
    }
}

/// How accelerations are weighted, whatever accelerates.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RobustAcceleration {
    /// Where the cost turns from quadratic to linear, in standard deviations.
    pub knee: f64,
    pub time_weight: f64,
}

impl RobustAcceleration {
    /// Cost of an acceleration over its standard deviation.
    pub(crate) fn cost(&self, residual: &Vector3<f64>) -> f64 {
        acceleration_cost(residual.norm_squared(), self.knee).cost
    }

    /// The weight of the square of an acceleration over its standard deviation.
    pub(crate) fn weight(&self, residual: &Vector3<f64>) -> f64 {
        acceleration_cost(residual.norm_squared(), self.knee).weight * self.time_weight
    }

    /// Adds an acceleration over its standard deviation, `residual`, to its three frames; `jacobians`: its derivatives by three
    /// unknowns from `first` on of each.
    pub(crate) fn add_to(
        &self,
        residual: &Vector3<f64>,
        first: usize,
        jacobians: &[Matrix3<f64>; 3],
        panels: &mut [FramePanel],
    ) {
        let weight = self.weight(residual);
        for (i, jacobian) in jacobians.iter().enumerate() {
            let left = jacobian.transpose() * weight;
            panels[i].add_gradient(first, &(left * residual));
            for (k, earlier) in jacobians.iter().enumerate().take(i + 1) {
                panels[k].add_block(i - k, [first; 2], &(left * earlier));
            }
        }
    }
}
