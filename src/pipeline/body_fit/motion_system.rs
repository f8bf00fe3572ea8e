//! The Gauss-Newton system of a person's motion.

use super::block_banded::BlockBanded;
use super::motion_problem::{MotionProblem, MotionState, Shape, TRANSLATION_GROUP, charbonnier};
use crate::body::anthropometry::N_BETAS;
use crate::body::kinematics::{Pose, joints_by_betas, landmark_by_betas, landmark_by_rotation, posed};
use crate::body::model::ShapedBody;
use crate::residuals::joint_acceleration::turn_change;
use nalgebra::{Matrix3, SVector, Vector3};
use rayon::prelude::*;

/// The part of the system that one frame's evidence and joint angles give.
struct FrameSystem {
    cost: f64,
    diagonal: nalgebra::DMatrix<f64>,
    border: nalgebra::DMatrix<f64>,
    gradient: nalgebra::DVector<f64>,
    corner: nalgebra::SMatrix<f64, N_BETAS, N_BETAS>,
    border_gradient: SVector<f64, N_BETAS>,
}

impl MotionProblem<'_> {
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

/// Added to every frame's diagonal (squared residual per rad^2 or m^2): 1e6 times weaker than one keypoint.
const FLOOR: f64 = 1e-4;

#[cfg(test)]
mod tests {
    use super::super::BodyFitConfig;
    use super::super::block_banded::BandedStep;
    use super::super::evidence::{Evidence, PointEvidence};
    use super::super::motion_problem::DataTerm;
    use super::*;
    use crate::body::default_body;
    use crate::body::model::Betas;
    use crate::geometry::rotation;
    use nalgebra::DVector;

    /// The gradient against central differences of the cost along some directions: data, angles, accelerations, betas.
    #[test]
    fn the_gradient_is_that_of_the_cost() {
        let model = default_body();
        let wave = |i: usize| ((i * 37 % 101) as f64 / 50.0 - 1.0) * 0.5;
        let pose = |t: usize| Pose {
            rotations: std::array::from_fn(|j| rotation::exp(&Vector3::from_fn(|a, _| wave(7 * t + 3 * j + a)))),
            translation: Vector3::new(wave(t), wave(t + 5), wave(t + 9)),
        };
        let state = MotionState { betas: Betas::from_fn(|k, _| wave(k)), poses: (0..5).map(pose).collect() };
        let point = |t: usize, l: usize| PointEvidence {
            landmark: l,
            position: Vector3::new(wave(t + l), 1.0 + wave(l + 3), wave(t + 2 * l)),
        };
        let evidence = Evidence {
            cameras: Vec::new(),
            points: (0..5).map(|t| (0..model.landmarks.len()).map(|l| point(t, l)).collect()).collect(),
            pixels: vec![Vec::new(); 5],
        };
        let config = BodyFitConfig::default();
        let problem =
            MotionProblem::new(&model, &evidence, &config, DataTerm::Points { sigma: 0.5 }, Shape::Free, 1.0 / 25.0);
        let (cost, system) = problem.linearised(&state);
        assert!((cost - problem.cost(&state)).abs() < 1e-9 * cost);
        let n = system.gradient[0].len();
        for direction in 0..20 {
            let step = |h: f64| BandedStep {
                frames: (0..5).map(|t| DVector::from_fn(n, |i, _| h * wave(11 * t + 13 * i + direction))).collect(),
                border: DVector::from_fn(N_BETAS, |i, _| h * wave(17 * i + direction)),
            };
            let unit = step(1.0);
            let slope = system.border_gradient.dot(&unit.border)
                + system.gradient.iter().zip(&unit.frames).map(|(g, s)| g.dot(s)).sum::<f64>();
            let at = |h: f64| problem.cost(&problem.moved(&state, &step(h)));
            let difference = (at(1e-6) - at(-1e-6)) / 2e-6;
            assert!((difference - slope).abs() < 1e-5 * (1.0 + slope.abs()), "{difference} and {slope}");
        }
    }
}
