//! The least-squares problem of one person's motion: unknowns, cost, and its Gauss-Newton system.
//!
//! The cost is an integral over time: every frame counts `dt * 30 Hz`, so that one motion filmed at 25, 30 or 60 Hz
//! has one optimum. A detector's error drifts over some frames, hence more frames a second are not more information.

use super::BodyFitConfig;
use super::block_banded::{BandedStep, BlockBanded};
use super::evidence::Evidence;
use crate::body::anthropometry::N_BETAS;
use crate::body::joint_ranges::{JointRange, joint_ranges};
use crate::body::kinematics::{
    Pose, PosedSkeleton, joints_by_betas, landmark_by_betas, landmark_by_rotation, landmark_position, moving_joints,
    posed,
};
use crate::body::model::{Betas, BodyModel, ShapedBody};
use crate::body::skeleton::N_JOINTS;
use crate::geometry::rotation;
use crate::residuals::joint_acceleration::turn_change;
use crate::residuals::joint_angles::{JointAngleWeights, joint_angle_cost};
use nalgebra::{Matrix3, SVector, Vector3};
use rayon::prelude::*;

/// The unknowns.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MotionState {
    pub betas: Betas,
    /// One per frame.
    pub poses: Vec<Pose>,
}

/// Which evidence is fitted, and how precise it is taken to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum DataTerm {
    /// Triangulated points, standard deviation in m per axis.
    Points { sigma: f64 },
    /// Pixels, standard deviation per axis as a share of [`super::evidence::PixelEvidence::scale_px`].
    Pixels { share: f64 },
}

/// Whether the shape moves with the pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Shape {
    Free,
    Held,
}

/// One person's motion over a run of frames.
pub(super) struct MotionProblem<'a> {
    pub model: &'a BodyModel,
    pub evidence: &'a Evidence,
    pub config: &'a BodyFitConfig,
    pub data: DataTerm,
    pub shape: Shape,
    /// s.
    pub frame_interval: f64,
    /// The joints that turn, ascending; the root is the first.
    active: Vec<usize>,
    /// `moved_by[landmark]`: `(group, joint)` of the active joints that move it.
    moved_by: Vec<Vec<(usize, usize)>>,
    ranges: [JointRange; N_JOINTS],
}

/// Position of the translation's three unknowns in a frame; joint `active[i]` has group `i + 1`.
const TRANSLATION_GROUP: usize = 0;

/// Rate at which a frame counts once.
const REFERENCE_RATE_HZ: f64 = 30.0;

/// A cost over the position of one landmark, to second order.
#[derive(Clone, Copy)]
struct PlaceCost {
    landmark: usize,
    cost: f64,
    gradient: Vector3<f64>,
    hessian: Matrix3<f64>,
}

/// The part of the system that one frame's evidence and joint angles give.
struct FrameSystem {
    cost: f64,
    diagonal: nalgebra::DMatrix<f64>,
    border: nalgebra::DMatrix<f64>,
    gradient: nalgebra::DVector<f64>,
    corner: nalgebra::SMatrix<f64, N_BETAS, N_BETAS>,
    border_gradient: SVector<f64, N_BETAS>,
}

impl<'a> MotionProblem<'a> {
    /// The problem over all frames of `evidence`.
    ///
    /// Only joints that move a landmark with evidence turn; the others (the hands always) stay where they started.
    pub(super) fn new(
        model: &'a BodyModel,
        evidence: &'a Evidence,
        config: &'a BodyFitConfig,
        data: DataTerm,
        shape: Shape,
        frame_interval: f64,
    ) -> Self {
        let moving: Vec<Vec<usize>> = model.landmarks.iter().map(moving_joints).collect();
        let mut turns = [false; N_JOINTS];
        turns[0] = true;
        let of_points = evidence.points.iter().flatten().map(|p| p.landmark);
        for landmark in of_points.chain(evidence.pixels.iter().flatten().map(|p| p.landmark)) {
            moving[landmark].iter().for_each(|&j| turns[j] = true);
        }
        let active: Vec<usize> = (0..FIRST_HAND).filter(|&j| turns[j]).collect();
        let group_of = |joint: &usize| active.iter().position(|a| a == joint).map(|g| (g + 1, *joint));
        let moved_by = moving.iter().map(|joints| joints.iter().filter_map(group_of).collect()).collect();
        Self { model, evidence, config, data, shape, frame_interval, active, moved_by, ranges: joint_ranges() }
    }

    fn time_weight(&self) -> f64 {
        self.frame_interval * REFERENCE_RATE_HZ
    }

    /// The state after a step of the solver: betas added, right increments of the rotations.
    pub(super) fn moved(&self, state: &MotionState, step: &BandedStep) -> MotionState {
        let mut moved = state.clone();
        moved.betas += Betas::from_fn(|k, _| step.border.get(k).copied().unwrap_or(0.0));
        for (pose, step) in moved.poses.iter_mut().zip(&step.frames) {
            let group = |g: usize| step.fixed_rows::<3>(3 * g).into_owned();
            pose.translation += group(TRANSLATION_GROUP);
            for (i, &joint) in self.active.iter().enumerate() {
                pose.rotations[joint] *= rotation::exp(&group(i + 1));
            }
        }
        moved
    }

    /// The whole cost.
    pub(super) fn cost(&self, state: &MotionState) -> f64 {
        let body = self.model.shaped(&state.betas);
        let frame_cost = |(t, pose): (usize, &Pose)| {
            let skeleton = posed(&body, pose);
            let data: f64 = self.place_costs(t, &body, &skeleton).iter().map(|p| p.cost).sum();
            data + self.active[1..].iter().map(|&j| self.angle_cost(pose, j).cost).sum::<f64>()
        };
        let frames: Vec<f64> = state.poses.par_iter().enumerate().map(frame_cost).collect();
        let smooth: f64 = (1..state.poses.len().saturating_sub(1)).map(|t| self.smoothness_cost(state, t)).sum();
        0.5 * state.betas.norm_squared() + self.time_weight() * (frames.iter().sum::<f64>() + smooth)
    }

    /// Cost and Gauss-Newton system at `state`.
    pub(super) fn linearised(&self, state: &MotionState) -> (f64, BlockBanded) {
        let n_border = if self.shape == Shape::Free { N_BETAS } else { 0 };
        let mut system = BlockBanded::zeros(state.poses.len(), self.active.len() + 1, n_border);
        let body = self.model.shaped(&state.betas);
        let weight = self.time_weight();
        let frames: Vec<FrameSystem> =
            state.poses.par_iter().enumerate().map(|(t, pose)| self.frame_system(t, &body, pose)).collect();
        let mut cost = 0.5 * state.betas.norm_squared();
        for k in 0..n_border {
            system.corner[(k, k)] += 1.0;
            system.border_gradient[k] += state.betas[k];
        }
        for (t, frame) in frames.into_iter().enumerate() {
            cost += weight * frame.cost;
            system.diagonal[t] = frame.diagonal * weight;
            system.gradient[t] = frame.gradient * weight;
            if n_border > 0 {
                system.border[t] = frame.border * weight;
                system.corner += frame.corner * weight;
                system.border_gradient += frame.border_gradient * weight;
            }
        }
        for t in 1..state.poses.len().saturating_sub(1) {
            cost += weight * self.add_smoothness(state, t, &mut system);
        }
        (cost, system)
    }

    fn frame_system(&self, t: usize, body: &ShapedBody, pose: &Pose) -> FrameSystem {
        let n = 3 * (self.active.len() + 1);
        let mut system = FrameSystem {
            cost: 0.0,
            diagonal: nalgebra::DMatrix::zeros(n, n),
            border: nalgebra::DMatrix::zeros(n, N_BETAS),
            gradient: nalgebra::DVector::zeros(n),
            corner: nalgebra::SMatrix::zeros(),
            border_gradient: SVector::zeros(),
        };
        let skeleton = posed(body, pose);
        let joint_directions = joints_by_betas(self.model, &skeleton);
        for place in self.place_costs(t, body, &skeleton) {
            system.cost += place.cost;
            let by_rotation = |&(group, joint): &(usize, usize)| {
                (group, landmark_by_rotation(self.model, body, &skeleton, place.landmark, joint))
            };
            let jacobians: Vec<(usize, Matrix3<f64>)> = std::iter::once((TRANSLATION_GROUP, Matrix3::identity()))
                .chain(self.moved_by[place.landmark].iter().map(by_rotation))
                .collect();
            let by_betas = landmark_by_betas(&self.model.landmarks[place.landmark], &skeleton, &joint_directions);
            let pulled = place.hessian * by_betas;
            system.corner += by_betas.tr_mul(&pulled);
            system.border_gradient += by_betas.tr_mul(&place.gradient);
            for (i, (row, a)) in jacobians.iter().enumerate() {
                let mut gradient = system.gradient.fixed_rows_mut::<3>(3 * row);
                gradient += a.tr_mul(&place.gradient);
                let mut border = system.border.fixed_view_mut::<3, N_BETAS>(3 * row, 0);
                border += a.tr_mul(&pulled);
                let left = a.tr_mul(&place.hessian);
                for (column, b) in &jacobians[..=i] {
                    let mut block = system.diagonal.fixed_view_mut::<3, 3>(3 * row, 3 * column);
                    block += left * b;
                }
            }
        }
        for (i, &joint) in self.active.iter().enumerate().skip(1) {
            let angle = self.angle_cost(pose, joint);
            system.cost += angle.cost;
            let mut gradient = system.gradient.fixed_rows_mut::<3>(3 * (i + 1));
            gradient += angle.gradient;
            let mut block = system.diagonal.fixed_view_mut::<3, 3>(3 * (i + 1), 3 * (i + 1));
            block += angle.hessian;
        }
        // A frame that nobody saw and nothing holds must not make the system singular.
        for i in 0..n {
            system.diagonal[(i, i)] += FLOOR;
        }
        system
    }

    fn angle_cost(&self, pose: &Pose, joint: usize) -> crate::residuals::joint_angles::JointAngleCost {
        let weights =
            JointAngleWeights { rest: self.config.rest_weight, limit_width: self.config.limit_width_deg.to_radians() };
        joint_angle_cost(&pose.rotations[joint], &self.ranges[joint], &weights)
    }

    /// Cost over the position of every landmark with evidence at frame `t`.
    fn place_costs(&self, t: usize, body: &ShapedBody, skeleton: &PosedSkeleton) -> Vec<PlaceCost> {
        let mut places: Vec<PlaceCost> = Vec::new();
        let mut slot = vec![usize::MAX; self.model.landmarks.len()];
        let mut add = |landmark: usize, cost_at: &dyn Fn(&Vector3<f64>) -> PlaceCost| {
            let position = landmark_position(self.model, body, skeleton, landmark);
            let cost = cost_at(&position);
            if slot[landmark] == usize::MAX {
                slot[landmark] = places.len();
                places.push(cost);
            } else {
                let sum = &mut places[slot[landmark]];
                sum.cost += cost.cost;
                sum.gradient += cost.gradient;
                sum.hessian += cost.hessian;
            }
        };
        let robust_scale = self.config.robust_scale;
        match self.data {
            DataTerm::Points { sigma } => {
                for point in &self.evidence.points[t] {
                    add(point.landmark, &|position| {
                        let miss = (position - point.position) / sigma;
                        let (cost, weight) = geman_mcclure(miss.norm_squared(), robust_scale);
                        PlaceCost {
                            landmark: point.landmark,
                            cost,
                            gradient: miss * (weight / sigma),
                            hessian: Matrix3::identity() * (weight / (sigma * sigma)),
                        }
                    });
                }
            }
            DataTerm::Pixels { share } => {
                for pixel in &self.evidence.pixels[t] {
                    let camera = &self.evidence.cameras[pixel.camera];
                    let sigma_px = share * pixel.scale_px;
                    add(pixel.landmark, &|position| {
                        let in_camera = camera.camera_from_world.transform(position);
                        let Some((projected, by_point)) = camera.intrinsics.project_with_jacobian(&in_camera) else {
                            // Behind the camera: as bad as an outlier can be, and no direction to improve in.
                            let cost = 0.5 * robust_scale * robust_scale;
                            let (gradient, hessian) = (Vector3::zeros(), Matrix3::zeros());
                            return PlaceCost { landmark: pixel.landmark, cost, gradient, hessian };
                        };
                        let miss = (projected - pixel.pixel) / sigma_px;
                        let by_world = by_point * camera.camera_from_world.rotation / sigma_px;
                        let (cost, weight) = geman_mcclure(miss.norm_squared(), robust_scale);
                        PlaceCost {
                            landmark: pixel.landmark,
                            cost,
                            gradient: by_world.tr_mul(&miss) * weight,
                            hessian: by_world.tr_mul(&by_world) * weight,
                        }
                    });
                }
            }
        }
        places
    }

    fn translation_acceleration(&self, state: &MotionState, t: usize) -> Vector3<f64> {
        let at = |i: usize| state.poses[i].translation;
        (at(t - 1) - at(t) * 2.0 + at(t + 1)) / (self.frame_interval.powi(2) * self.config.translation_acceleration)
    }

    /// Angular acceleration over its typical size, one unit per radian of turn change.
    fn angular_scale(&self, joint: usize) -> f64 {
        1.0 / (self.frame_interval.powi(2) * self.ranges[joint].acceleration * self.config.angular_acceleration_factor)
    }

    fn smoothness_cost(&self, state: &MotionState, t: usize) -> f64 {
        let joint_cost = |&joint: &usize| {
            let [a, b, c] = [t - 1, t, t + 1].map(|i| &state.poses[i].rotations[joint]);
            let before = rotation::log(&(a.transpose() * b));
            let change = rotation::log(&(b.transpose() * c)) - before;
            charbonnier((change * self.angular_scale(joint)).norm_squared()).0
        };
        charbonnier(self.translation_acceleration(state, t).norm_squared()).0
            + self.active.iter().map(joint_cost).sum::<f64>()
    }

    /// Adds the accelerations about frame `t`; returns their unweighted cost.
    fn add_smoothness(&self, state: &MotionState, t: usize, system: &mut BlockBanded) -> f64 {
        let scale = 1.0 / (self.frame_interval.powi(2) * self.config.translation_acceleration);
        let jacobians = [1.0, -2.0, 1.0].map(|c| Matrix3::identity() * (c * scale));
        let mut cost =
            self.add_acceleration(t, TRANSLATION_GROUP, &self.translation_acceleration(state, t), &jacobians, system);
        for (i, &joint) in self.active.iter().enumerate() {
            let [a, b, c] = [t - 1, t, t + 1].map(|i| &state.poses[i].rotations[joint]);
            let change = turn_change(a, b, c);
            let scale = self.angular_scale(joint);
            let jacobians = change.jacobians.map(|j| j * scale);
            cost += self.add_acceleration(t, i + 1, &(change.value * scale), &jacobians, system);
        }
        cost
    }

    fn add_acceleration(
        &self,
        t: usize,
        group: usize,
        residual: &Vector3<f64>,
        jacobians: &[Matrix3<f64>; 3],
        system: &mut BlockBanded,
    ) -> f64 {
        let (cost, robust) = charbonnier(residual.norm_squared());
        let weight = robust * self.time_weight();
        for (i, jacobian) in jacobians.iter().enumerate() {
            let left = jacobian.transpose() * weight;
            let mut gradient = system.gradient[t - 1 + i].fixed_rows_mut::<3>(3 * group);
            gradient += left * residual;
            let mut block = system.diagonal[t - 1 + i].fixed_view_mut::<3, 3>(3 * group, 3 * group);
            block += left * jacobian;
        }
        let [a, b, c] = jacobians;
        system.next[t - 1][group] += b.transpose() * a * weight;
        system.next[t][group] += c.transpose() * b * weight;
        system.after_next[t - 1][group] += c.transpose() * a * weight;
        cost
    }
}

/// First of the two hand joints, which have no keypoints of their own to turn by.
const FIRST_HAND: usize = 22;

/// Added to every frame's diagonal (squared residual per rad^2 or m^2): 1e6 times weaker than one keypoint.
const FLOOR: f64 = 1e-4;

/// Geman-McClure: `rho = s^2 e^2 / (e^2 + s^2) / 2` and the weight `(s^2 / (s^2 + e^2))^2` (method.md 9.4).
fn geman_mcclure(squared: f64, scale: f64) -> (f64, f64) {
    let s2 = scale * scale;
    let share = s2 / (s2 + squared);
    (0.5 * squared * share, share * share)
}

/// Charbonnier at scale 1: `rho = sqrt(1 + e^2) - 1`, weight `1 / sqrt(1 + e^2)`. Real accelerations are small most of
/// the time and large at contacts; a squared cost would round those off.
fn charbonnier(squared: f64) -> (f64, f64) {
    let root = (1.0 + squared).sqrt();
    (root - 1.0, 1.0 / root)
}
