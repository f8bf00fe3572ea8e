//! The Gauss-Newton system of a person's motion.

use super::motion_problem::{MotionProblem, MotionState, TRANSLATION_GROUP};
use super::steady_places::SteadyPlace;
use crate::body::kinematics::{Pose, PosedSkeleton, joints_by_betas, landmark_by_rotation, posed};
use crate::body::model::{Betas, ShapedBody};
use crate::optim::block_banded::{BlockBanded, Corner};
use crate::residuals::pose_likelihood::PoseCost;
use nalgebra::{DMatrix, DVector, Matrix3};
use rayon::prelude::*;

/// The part of the system that one frame's evidence and joint angles give.
struct FrameSystem {
    cost: f64,
    diagonal: DMatrix<f64>,
    border: DMatrix<f64>,
    gradient: DVector<f64>,
    steady: Vec<SteadyPlace>,
}

impl FrameSystem {
    /// `rows[i]`: first row of the i-th joint of the cost.
    fn add_poses(&mut self, poses: &PoseCost, rows: &[usize]) {
        for (i, &row) in rows.iter().enumerate() {
            let mut gradient = self.gradient.fixed_rows_mut::<3>(row);
            gradient += poses.gradient.fixed_rows::<3>(3 * i);
            for (k, &column) in rows.iter().enumerate().take(i + 1) {
                let mut block = self.diagonal.fixed_view_mut::<3, 3>(row, column);
                block += poses.hessian.fixed_view::<3, 3>(3 * i, 3 * k);
            }
        }
    }
}

impl MotionProblem<'_> {
    /// Cost and Gauss-Newton system at `state`.
    pub(super) fn linearised(&self, state: &MotionState) -> (f64, BlockBanded) {
        let n_border = self.n_border();
        let mut system = BlockBanded::zeros(state.poses.len(), self.active.len() + 1, n_border);
        let body = self.model.shaped(&state.betas);
        let run_system = |(run, poses): (usize, &[Pose])| {
            let mut corner = Corner::zeros(n_border);
            let frame = |(i, pose)| self.frame_system(RUN * run + i, (&body, &state.betas, pose), &mut corner);
            let frames: Vec<FrameSystem> = poses.iter().enumerate().map(frame).collect();
            (frames, corner)
        };
        let runs: Vec<(Vec<FrameSystem>, Corner)> = state.poses.par_chunks(RUN).enumerate().map(run_system).collect();

        let weight = self.time_weight();
        let mut cost = 0.5 * self.shape_prior * state.betas.norm_squared();
        let mut steady = Vec::with_capacity(state.poses.len());
        for (frames, of_run) in runs {
            system.corner.hessian += of_run.hessian * weight;
            system.corner.gradient += of_run.gradient * weight;
            for frame in frames {
                let t = steady.len();
                cost += weight * frame.cost;
                system.diagonal[t] = frame.diagonal * weight;
                system.border[t] = frame.border * weight;
                system.gradient[t] = frame.gradient * weight;
                steady.push(frame.steady);
            }
        }
        for k in 0..self.n_betas() {
            system.corner.hessian[(k, k)] += self.shape_prior;
            system.corner.gradient[k] += self.shape_prior * state.betas[k];
        }
        for t in 1..state.poses.len().saturating_sub(1) {
            cost += weight * self.add_smoothness(state, t, &mut system);
            let around = [&steady[t - 1], &steady[t], &steady[t + 1]].map(Vec::as_slice);
            cost += weight * self.add_place_accelerations(t, around, &mut system);
        }
        for &t in self.held {
            (0..system.diagonal[t].nrows()).for_each(|i| system.diagonal[t][(i, i)] += HOLD);
        }
        (cost, system)
    }

    fn frame_system(
        &self,
        t: usize,
        (body, betas, pose): (&ShapedBody, &Betas, &Pose),
        corner: &mut Corner,
    ) -> FrameSystem {
        let (n, n_border) = (3 * (self.active.len() + 1), self.n_border());
        let mut system = FrameSystem {
            cost: 0.0,
            diagonal: DMatrix::zeros(n, n),
            border: DMatrix::zeros(n, n_border),
            gradient: DVector::zeros(n),
            steady: Vec::new(),
        };
        let skeleton = posed(body, pose);
        let joint_directions = joints_by_betas(self.model, &skeleton);
        for place in self.place_costs(t, body, &skeleton) {
            system.cost += place.cost;
            let jacobians = self.by_frame(place.landmark, body, &skeleton);
            let by_border = self.by_border(place.landmark, &skeleton, &joint_directions);
            by_border.add_to_corner(&place.gradient, &place.hessian, corner);
            for (i, (row, a)) in jacobians.iter().enumerate() {
                let mut gradient = system.gradient.fixed_rows_mut::<3>(3 * row);
                gradient += a.tr_mul(&place.gradient);
                let left = a.tr_mul(&place.hessian);
                by_border.add_to_border(3 * row, &left, &mut system.border);
                for (column, b) in &jacobians[..=i] {
                    let mut block = system.diagonal.fixed_view_mut::<3, 3>(3 * row, 3 * column);
                    block += left * b;
                }
            }
        }
        system.steady = self.steady_places(body, &skeleton, &joint_directions);
        for (i, &joint) in self.active.iter().enumerate().skip(1) {
            let angle = self.angle_cost(pose, joint);
            system.cost += angle.cost;
            let mut gradient = system.gradient.fixed_rows_mut::<3>(3 * (i + 1));
            gradient += angle.gradient;
            let mut block = system.diagonal.fixed_view_mut::<3, 3>(3 * (i + 1), 3 * (i + 1));
            block += angle.hessian;
        }
        if let (Some(likely), Some(poses)) = (&self.likely, self.pose_cost(pose)) {
            system.cost += poses.cost;
            system.add_poses(&poses, &self.rows_of(&likely.joints));
        }
        if let Some(contacts) = self.contacts {
            let FrameSystem { diagonal, gradient, .. } = &mut system;
            system.cost += contacts.add_to(t, (betas, &skeleton), &self.active, diagonal, gradient);
        }
        // A frame that nobody saw and nothing holds must not make the system singular.
        for i in 0..n {
            system.diagonal[(i, i)] += FLOOR;
        }
        system
    }

    /// First row of each joint's unknowns in a frame.
    fn rows_of(&self, joints: &[usize]) -> Vec<usize> {
        let row = |joint: &usize| self.active.iter().position(|a| a == joint).map(|i| 3 * (i + 1));
        joints.iter().filter_map(row).collect()
    }

    /// Derivatives of a landmark's place to the groups of its frame that move it, ascending.
    pub(super) fn by_frame(
        &self,
        landmark: usize,
        body: &ShapedBody,
        skeleton: &PosedSkeleton,
    ) -> Vec<(usize, Matrix3<f64>)> {
        let by_rotation = |&(group, joint): &(usize, usize)| {
            (group, landmark_by_rotation(self.model, body, skeleton, landmark, joint))
        };
        let by_translation = std::iter::once((TRANSLATION_GROUP, Matrix3::identity()));
        by_translation.chain(self.moved_by[landmark].iter().map(by_rotation)).collect()
    }
}

/// Frames that are made one after another: as many share one corner.
const RUN: usize = 16;

/// Added to the diagonal of a frame that is held: a step there is a millionth of what it would be.
const HOLD: f64 = 1e15;

/// Added to every frame's diagonal (squared residual per rad^2 or m^2): 1e6 times weaker than one keypoint.
const FLOOR: f64 = 1e-4;

#[cfg(test)]
mod tests {
    use super::super::BodyFitConfig;
    use super::super::evidence::{Evidence, PointEvidence};
    use super::super::motion_problem::{DataTerm, Shape};
    use super::*;
    use crate::body::anthropometry::N_BETAS;
    use crate::body::bone_offsets::{BoneOffsets, with_bones};
    use crate::body::default_body;
    use crate::body::detector_offsets::OffsetTable;
    use crate::body::model::BodyModel;
    use crate::body::skeleton::KeypointConvention;
    use crate::geometry::rotation;
    use crate::optim::block_banded::BandedStep;
    use nalgebra::Vector3;

    /// The gradient against central differences of the cost along some directions: data, angles, accelerations, betas, bones
    /// and the detector's offsets.
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
        let table = OffsetTable::new(&model, KeypointConvention::Body25);
        let offsets: Vec<Vector3<f64>> =
            (0..table.kinds.len()).map(|k| Vector3::from_fn(|a, _| 0.1 * wave(5 * k + a))).collect();
        fn problem_at<'a>(
            model: &'a BodyModel,
            evidence: &'a Evidence,
            config: &'a BodyFitConfig,
            table: &'a OffsetTable,
        ) -> MotionProblem<'a> {
            MotionProblem::new(model, evidence, config, DataTerm::Points { sigma: 0.5 }, Shape::Free, 1.0 / 25.0)
                .with_free_offsets(table, 3.0)
        }
        let bones: BoneOffsets = std::array::from_fn(|k| Vector3::from_fn(|a, _| 0.1 * wave(9 * k + a)));
        let detector_model = with_bones(&table.applied(&model, &offsets), &bones);
        let problem = problem_at(&detector_model, &evidence, &config, &table);
        let (cost, system) = problem.linearised(&state);
        assert!((cost - problem.cost(&state)).abs() < 1e-9 * cost);
        let n = system.gradient[0].len();
        for direction in 0..20 {
            let step = |h: f64| BandedStep {
                frames: (0..5).map(|t| DVector::from_fn(n, |i, _| h * wave(11 * t + 13 * i + direction))).collect(),
                border: DVector::from_fn(problem.n_border(), |i, _| h * wave(17 * i + direction)),
            };
            let unit = step(1.0);
            let slope = system.corner.gradient.dot(&unit.border)
                + system.gradient.iter().zip(&unit.frames).map(|(g, s)| g.dot(s)).sum::<f64>();
            let at = |h: f64| {
                let step = step(h);
                let by_bones = step.border.rows(N_BETAS, 3 * bones.len());
                let bones: BoneOffsets = std::array::from_fn(|k| bones[k] + by_bones.fixed_rows::<3>(3 * k));
                let by_offsets = step.border.rows(problem.first_offset(), 3 * offsets.len());
                let moved = |(k, o): (usize, &Vector3<f64>)| o + by_offsets.fixed_rows::<3>(3 * k);
                let model = table.applied(&model, &offsets.iter().enumerate().map(moved).collect::<Vec<_>>());
                let model = with_bones(&model, &bones);
                problem_at(&model, &evidence, &config, &table).cost(&problem.moved(&state, &step))
            };
            let difference = (at(1e-6) - at(-1e-6)) / 2e-6;
            assert!((difference - slope).abs() < 1e-5 * (1.0 + slope.abs()), "{difference} and {slope}");
        }
    }
}
