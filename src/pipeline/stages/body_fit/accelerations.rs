//! What changes of motion cost: the pelvis's accelerations and those of every turn.

use super::motion_problem::{MotionProblem, MotionState, TRANSLATION_GROUP};
use crate::geometry::rotation;
use crate::optim::block_banded::BlockBanded;
use crate::residuals::joint_acceleration::turn_change;
use nalgebra::{Matrix3, Vector3};

/// Of three successive places over the squared frame interval: the acceleration in the middle.
pub(super) const SECOND_DIFFERENCE: [f64; 3] = [1.0, -2.0, 1.0];

pub(super) fn second_difference([a, b, c]: [Vector3<f64>; 3]) -> Vector3<f64> {
    a - b * 2.0 + c
}

impl MotionProblem<'_> {
    /// The pelvis's acceleration about frame `t` over its size.
    fn pelvis_acceleration(&self, state: &MotionState, t: usize) -> Vector3<f64> {
        second_difference([t - 1, t, t + 1].map(|i| state.poses[i].translation)) * self.pelvis_scale(t)
    }

    fn pelvis_scale(&self, t: usize) -> f64 {
        1.0 / (self.frame_interval.powi(2) * self.sizes[t].pelvis)
    }

    /// Angular acceleration over its size, one unit per radian of turn change.
    fn angular_scale(&self, t: usize, joint: usize) -> f64 {
        1.0 / (self.frame_interval.powi(2) * self.sizes[t].turns[joint])
    }

    /// Charbonnier at the knee k over an acceleration's square e^2 in its own size: `rho = k^2 (r - 1)`, weight `1 / r`,
    /// `r = sqrt(1 + e^2 / k^2)`.
    pub(super) fn acceleration_cost(&self, squared: f64) -> (f64, f64) {
        let knee_squared = self.config.acceleration_knee.powi(2);
        let root = (1.0 + squared / knee_squared).sqrt();
        (knee_squared * (root - 1.0), 1.0 / root)
    }

    /// Unweighted cost of the accelerations about frame `t`.
    pub(super) fn smoothness_cost(&self, state: &MotionState, t: usize) -> f64 {
        let joint_cost = |&joint: &usize| {
            let [a, b, c] = [t - 1, t, t + 1].map(|i| &state.poses[i].rotations[joint]);
            let before = rotation::log(&(a.transpose() * b));
            let change = rotation::log(&(b.transpose() * c)) - before;
            self.acceleration_cost((change * self.angular_scale(t, joint)).norm_squared()).0
        };
        self.acceleration_cost(self.pelvis_acceleration(state, t).norm_squared()).0
            + self.active.iter().map(joint_cost).sum::<f64>()
    }

    /// Adds the accelerations about frame `t`; returns their unweighted cost.
    pub(super) fn add_smoothness(&self, state: &MotionState, t: usize, system: &mut BlockBanded) -> f64 {
        let factors = SECOND_DIFFERENCE.map(|c| c * self.pelvis_scale(t));
        let still: &[(usize, Matrix3<f64>)] = &[(TRANSLATION_GROUP, Matrix3::identity())];
        let (mut cost, _) = self.add_acceleration(t, &self.pelvis_acceleration(state, t), factors, [still; 3], system);
        for (i, &joint) in self.active.iter().enumerate() {
            let [a, b, c] = [t - 1, t, t + 1].map(|i| &state.poses[i].rotations[joint]);
            let change = turn_change(a, b, c);
            let scale = self.angular_scale(t, joint);
            let jacobians = change.jacobians.map(|jacobian| [(i + 1, jacobian)]);
            let by_frame = jacobians.each_ref().map(<[_; 1]>::as_slice);
            cost += self.add_acceleration(t, &(change.value * scale), [scale; 3], by_frame, system).0;
        }
        cost
    }

    /// Adds an acceleration over its size, `residual`, about frame `t`. Its derivatives are `factors` times those of
    /// `by_frame`, each by group. Returns its unweighted cost, and the weight that its square has in the system.
    pub(super) fn add_acceleration(
        &self,
        t: usize,
        residual: &Vector3<f64>,
        factors: [f64; 3],
        by_frame: [&[(usize, Matrix3<f64>)]; 3],
        system: &mut BlockBanded,
    ) -> (f64, f64) {
        let (cost, robust) = self.acceleration_cost(residual.norm_squared());
        let weight = robust * self.time_weight();
        for (i, (groups, factor)) in by_frame.iter().zip(factors).enumerate() {
            for (row, jacobian) in *groups {
                let left = jacobian.transpose() * (factor * weight);
                let mut gradient = system.gradient[t - 1 + i].fixed_rows_mut::<3>(3 * row);
                gradient += left * residual;
                for (k, (earlier, factor)) in by_frame.iter().zip(factors).enumerate().take(i + 1) {
                    for (column, other) in *earlier {
                        system.add_block([t - 1 + i, t - 1 + k], [*row, *column], left * other * factor);
                    }
                }
            }
        }
        (cost, weight)
    }
}
