//! Feet that stand, stand still: accelerations of the ankles in the world.
//!
//! Where only turns are smooth, what pelvis, hip and knee shake by adds up at a standing foot: on simulated captures ankles
//! accelerated two to three times as much as in truth, all other joints 0.8 to 1.3 times.

use super::BodyFitConfig;
use super::accelerations::{SECOND_DIFFERENCE, second_difference};
use super::border_jacobian::BorderJacobian;
use super::motion_problem::MotionProblem;
use crate::body::kinematics::{PosedSkeleton, landmark_position};
use crate::body::model::{BodyModel, ShapeDirections, ShapedBody};
use crate::body::skeleton::N_JOINTS;
use crate::optim::block_banded::BlockBanded;
use nalgebra::{Matrix3, Vector3};

/// One place in one frame.
pub(super) struct SteadyPlace {
    /// World, m.
    position: Vector3<f64>,
    /// Groups that move it, ascending, and its derivatives to them.
    by_frame: Vec<(usize, Matrix3<f64>)>,
    /// Its derivative to the border's unknowns.
    by_border: BorderJacobian,
}

/// The landmarks that are steady.
pub(super) fn steady_landmarks(model: &BodyModel, config: &BodyFitConfig) -> Vec<usize> {
    let names: &[&str] = if config.motion_prior { &["left_ankle", "right_ankle"] } else { &[] };
    names.iter().filter_map(|name| model.landmark_index(name)).collect()
}

impl MotionProblem<'_> {
    /// Where the steady landmarks are, m.
    pub(super) fn steady_positions(&self, body: &ShapedBody, skeleton: &PosedSkeleton) -> Vec<Vector3<f64>> {
        self.steady.iter().map(|&landmark| landmark_position(self.model, body, skeleton, landmark)).collect()
    }

    /// The same with derivatives.
    pub(super) fn steady_places(
        &self,
        body: &ShapedBody,
        skeleton: &PosedSkeleton,
        joint_directions: &[ShapeDirections; N_JOINTS],
    ) -> Vec<SteadyPlace> {
        let place = |&landmark: &usize| SteadyPlace {
            position: landmark_position(self.model, body, skeleton, landmark),
            by_frame: self.by_frame(landmark, body, skeleton),
            by_border: self.by_border(landmark, skeleton, joint_directions),
        };
        self.steady.iter().map(place).collect()
    }

    /// Unweighted cost of the accelerations between three successive frames.
    pub(super) fn place_acceleration_cost(&self, t: usize, around: &[Vec<Vector3<f64>>]) -> f64 {
        let cost = |k: usize| {
            let acceleration = second_difference([0, 1, 2].map(|i| around[i][k])) * self.place_scale(t, k);
            self.acceleration_cost(acceleration.norm_squared()).0
        };
        (0..self.steady.len()).map(cost).sum()
    }

    /// Adds the accelerations about frame `t`; returns their unweighted cost.
    pub(super) fn add_place_accelerations(
        &self,
        t: usize,
        around: [&[SteadyPlace]; 3],
        system: &mut BlockBanded,
    ) -> f64 {
        let add =
            |k: usize| self.add_place_acceleration(t, self.place_scale(t, k), around.map(|frame| &frame[k]), system);
        (0..self.steady.len()).map(add).sum()
    }

    fn add_place_acceleration(&self, t: usize, scale: f64, around: [&SteadyPlace; 3], system: &mut BlockBanded) -> f64 {
        let residual = second_difference(around.map(|place| place.position)) * scale;
        let factors = SECOND_DIFFERENCE.map(|c| c * scale);
        let by_frame = around.map(|place| place.by_frame.as_slice());
        let (cost, weight) = self.add_acceleration(t, &residual, factors, by_frame, system);
        let parts = [0, 1, 2].map(|i| (&around[i].by_border, factors[i]));
        let by_border = BorderJacobian::sum(parts);
        for (i, (groups, factor)) in by_frame.iter().zip(factors).enumerate() {
            for (group, jacobian) in *groups {
                let left = jacobian.transpose() * (factor * weight);
                by_border.add_to_border(3 * group, &left, &mut system.border[t - 1 + i]);
            }
        }
        let (gradient, hessian) = (residual * weight, Matrix3::identity() * weight);
        by_border.add_to_corner(&gradient, &hessian, &mut system.corner);
        cost
    }

    fn place_scale(&self, t: usize, k: usize) -> f64 {
        1.0 / (self.frame_interval.powi(2) * self.sizes[t].ankles[k])
    }
}
