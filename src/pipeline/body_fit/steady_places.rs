//! Feet that stand, stand still: accelerations of the ankles in the world.
//!
//! Where only turns are smooth, what pelvis, hip and knee shake by adds up at a standing foot: on simulated captures ankles
//! accelerated two to three times as much as in truth, all other joints 0.8 to 1.3 times.

use super::BodyFitConfig;
use super::motion_problem::{MotionProblem, TRANSLATION_GROUP};
use crate::body::kinematics::{PosedSkeleton, joints_by_betas, landmark_by_rotation, landmark_position};
use crate::body::model::{BodyModel, ShapedBody};
use crate::optim::block_banded::BlockBanded;
use nalgebra::{DMatrix, Matrix3, Vector3};

/// One place in one frame.
pub(super) struct SteadyPlace {
    /// World, m.
    position: Vector3<f64>,
    /// Groups that move it, ascending, and its derivatives to them.
    by_frame: Vec<(usize, Matrix3<f64>)>,
    /// Its derivative to the border's unknowns.
    by_border: DMatrix<f64>,
}

/// The landmarks that are steady.
pub(super) fn steady_landmarks(model: &BodyModel, config: &BodyFitConfig) -> Vec<usize> {
    let names: &[&str] = if config.motion_prior { &["left_ankle", "right_ankle"] } else { &[] };
    names.iter().filter_map(|name| model.landmark_index(name)).collect()
}

const SECOND_DIFFERENCE: [f64; 3] = [1.0, -2.0, 1.0];

impl MotionProblem<'_> {
    /// Where the steady landmarks are, m.
    pub(super) fn steady_positions(&self, body: &ShapedBody, skeleton: &PosedSkeleton) -> Vec<Vector3<f64>> {
        self.steady.iter().map(|&landmark| landmark_position(self.model, body, skeleton, landmark)).collect()
    }

    /// The same with derivatives.
    pub(super) fn steady_places(&self, body: &ShapedBody, skeleton: &PosedSkeleton) -> Vec<SteadyPlace> {
        let directions = joints_by_betas(self.model, skeleton);
        let place = |&landmark: &usize| {
            let by_rotation = |&(group, joint): &(usize, usize)| {
                (group, landmark_by_rotation(self.model, body, skeleton, landmark, joint))
            };
            let by_translation = std::iter::once((TRANSLATION_GROUP, Matrix3::identity()));
            SteadyPlace {
                position: landmark_position(self.model, body, skeleton, landmark),
                by_frame: by_translation.chain(self.moved_by[landmark].iter().map(by_rotation)).collect(),
                by_border: self.by_border(landmark, skeleton, &directions).dense(self.n_border()),
            }
        };
        self.steady.iter().map(place).collect()
    }

    /// Unweighted cost of the accelerations between three successive frames.
    pub(super) fn place_acceleration_cost(&self, around: &[Vec<Vector3<f64>>]) -> f64 {
        let cost = |k: usize| {
            let acceleration = self.place_acceleration([0, 1, 2].map(|i| around[i][k]));
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
        (0..self.steady.len()).map(|k| self.add_place_acceleration(t, around.map(|frame| &frame[k]), system)).sum()
    }

    fn add_place_acceleration(&self, t: usize, around: [&SteadyPlace; 3], system: &mut BlockBanded) -> f64 {
        let residual = self.place_acceleration(around.map(|place| place.position));
        let (cost, robust) = self.acceleration_cost(residual.norm_squared());
        let weight = robust * self.time_weight();
        let factors = SECOND_DIFFERENCE.map(|c| c * self.place_scale());
        let by_border: DMatrix<f64> = around.iter().zip(factors).map(|(place, factor)| &place.by_border * factor).sum();
        for (i, (place, factor)) in around.iter().zip(factors).enumerate() {
            for (group, jacobian) in &place.by_frame {
                let left = jacobian.transpose() * (factor * weight);
                let mut gradient = system.gradient[t - 1 + i].fixed_rows_mut::<3>(3 * group);
                gradient += left * residual;
                let mut border = system.border[t - 1 + i].fixed_rows_mut::<3>(3 * group);
                border += left * &by_border;
                for (k, (earlier, factor)) in around.iter().zip(factors).enumerate().take(i + 1) {
                    for (column, other) in &earlier.by_frame {
                        add_block(system, [t - 1 + i, t - 1 + k], [*group, *column], left * other * factor);
                    }
                }
            }
        }
        system.corner += by_border.tr_mul(&by_border) * weight;
        system.border_gradient += by_border.tr_mul(&residual) * weight;
        cost
    }

    /// An acceleration over its size.
    fn place_acceleration(&self, [a, b, c]: [Vector3<f64>; 3]) -> Vector3<f64> {
        (a - b * 2.0 + c) * self.place_scale()
    }

    fn place_scale(&self) -> f64 {
        1.0 / (self.frame_interval.powi(2) * self.config.ankle_acceleration)
    }
}

/// Adds to the block of a frame with itself or with one that is earlier by one or two.
fn add_block(system: &mut BlockBanded, frames: [usize; 2], [row, column]: [usize; 2], block: Matrix3<f64>) {
    let [later, earlier] = frames;
    match later - earlier {
        0 => {
            let mut place = system.diagonal[later].fixed_view_mut::<3, 3>(3 * row, 3 * column);
            place += block;
        }
        1 => system.next[earlier].add(row, column, block),
        _ => system.after_next[earlier].add(row, column, block),
    }
}
