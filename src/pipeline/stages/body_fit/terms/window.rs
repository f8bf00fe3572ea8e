//! Three successive frames, on which terms of accelerations depend, and the Gauss-Newton blocks of an acceleration.

use super::landmark_jacobian::LandmarkJacobian;
use crate::body::kinematics::Pose;
use crate::optim::block_banded::BlockBanded;
use crate::residuals::acceleration::acceleration_cost;
use nalgebra::{Matrix3, Vector3};

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

    /// Adds the acceleration `residual` about frame `middle`, over its standard deviation. Its derivatives are `factors` times
    /// those of `by_frame`, each by group. Returns the weight that its square has in the system.
    pub(crate) fn add_to(
        &self,
        middle: usize,
        residual: &Vector3<f64>,
        factors: [f64; 3],
        by_frame: [&[(usize, Matrix3<f64>)]; 3],
        system: &mut BlockBanded,
    ) -> f64 {
        let weight = acceleration_cost(residual.norm_squared(), self.knee).weight * self.time_weight;
        for (i, (groups, factor)) in by_frame.iter().zip(factors).enumerate() {
            for (row, jacobian) in *groups {
                let left = jacobian.transpose() * (factor * weight);
                system.frame(middle - 1 + i).add_gradient(3 * row, &(left * residual));
                for (k, (earlier, factor)) in by_frame.iter().zip(factors).enumerate().take(i + 1) {
                    for (column, other) in *earlier {
                        system.add_block([middle - 1 + i, middle - 1 + k], [*row, *column], &(left * other * factor));
                    }
                }
            }
        }
        weight
    }
}
