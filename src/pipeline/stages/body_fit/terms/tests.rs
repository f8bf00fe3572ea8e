//! The shared check of the terms: gradient against central differences of the cost, each term alone and all together.

use super::super::capsule_overlaps::CapsuleBody;
use super::super::completed_joints::GapCompletion;
use super::super::context::FitContext;
use super::super::motion_problem::MotionProblem;
use super::super::objective::Objective;
use super::super::observations::{ErrorShape, Observations, PixelObservation, PointObservation};
use super::super::test_fixtures::Surroundings;
use super::border_priors::{BoneLengthPrior, KeypointBiasPrior, ShapePrior};
use super::collision::{CollisionTerm, Collisions};
use super::data::DataSource;
use super::term::BorderTerm;
use super::unknowns::{Border, CameraColumns, MotionState, Shape};
use crate::body::bone_offsets::{BoneOffsets, with_bones};
use crate::body::capsules::BodyCapsules;
use crate::body::detector_offsets::OffsetTable;
use crate::body::kinematics::Pose;
use crate::body::model::{Betas, BodyModel};
use crate::body::skeleton::KeypointConvention;
use crate::geometry::{Intrinsics, Rigid, rotation};
use crate::optim::block_banded::{BandedStep, BlockBanded, Corner, Fill};
use crate::pipeline::calibration::PosedCamera;
use crate::residuals::derivative_check::assert_gradient;
use crate::residuals::rotation_likelihood::RotationGaussian;
use nalgebra::{DVector, Matrix3, Vector2, Vector3};

pub(super) const N_FRAMES: usize = 5;
const N_DIRECTIONS: usize = 20;

/// Numbers between -0.5 and 0.5 without a pattern.
pub(super) fn wave(i: usize) -> f64 {
    ((i * 37 % 101) as f64 / 50.0 - 1.0) * 0.5
}

/// Five frames of one person with points and pixels of all landmarks.
pub(super) struct Fixture {
    pub surroundings: Surroundings,
    pub table: Option<OffsetTable>,
    pub observations: Observations,
    pub state: MotionState,
}

impl Fixture {
    pub(super) fn new() -> Self {
        let surroundings = Surroundings::new();
        let model = &surroundings.model;
        let pose = |t: usize| Pose {
            rotations: std::array::from_fn(|j| rotation::exp(&Vector3::from_fn(|a, _| wave(7 * t + 3 * j + a)))),
            translation: Vector3::new(wave(t), wave(t + 5), wave(t + 9)),
        };
        let point = |t: usize, landmark: usize| PointObservation {
            landmark,
            position: Vector3::new(wave(t + landmark), 1.0 + wave(landmark + 3), wave(t + 2 * landmark)),
        };
        let pixel = |t: usize, landmark: usize| PixelObservation {
            landmark,
            camera: 0,
            pixel: Vector2::new(960.0 + 300.0 * wave(t + landmark), 540.0 + 300.0 * wave(landmark + 3)),
            scale_px: 400.0,
            error: match t.is_multiple_of(2) {
                true => ErrorShape::Whitened(nalgebra::Matrix2::new(1.4, 0.3, 0.3, 0.8)),
                false => ErrorShape::Round,
            },
        };
        let camera = PosedCamera {
            intrinsics: Intrinsics::PLAIN,
            camera_from_world: Rigid { translation: Vector3::z() * 4.0, ..Rigid::identity() },
        };
        let landmarks = 0..model.landmarks.len();
        let observations = Observations {
            cameras: vec![camera],
            points: (0..N_FRAMES).map(|t| landmarks.clone().map(|l| point(t, l)).collect()).collect(),
            pixels: (0..N_FRAMES).map(|t| landmarks.clone().map(|l| pixel(t, l)).collect()).collect(),
        };
        let state = MotionState { betas: Betas::from_fn(|k, _| wave(k)), poses: (0..N_FRAMES).map(pose).collect() };
        let table = Some(OffsetTable::new(model, KeypointConvention::Body25));
        Self { surroundings, table, observations, state }
    }

    fn border(&self) -> Border<'_> {
        Border { shape: Shape::Free, has_bones: true, bias: self.table.as_ref(), cameras: CameraColumns::default() }
    }

    /// The model with some bone and keypoint offsets, and increments of them in `border`.
    pub(super) fn model_at(&self, border: &DVector<f64>) -> BodyModel {
        let offset = |first: usize, k: usize| {
            Vector3::from_fn(|axis, _| 0.1 * wave(5 * k + axis)) + border.fixed_rows::<3>(first + 3 * k)
        };
        let bones: BoneOffsets = std::array::from_fn(|k| offset(self.border().bones().start, k));
        let own = with_bones(&self.surroundings.model, &bones);
        let Some(table) = &self.table else { return own };
        let bias: Vec<_> = (0..table.kinds.len()).map(|k| offset(self.border().keypoint_bias().start, k)).collect();
        table.applied(&own, &bias)
    }

    pub(super) fn objective<'a>(&'a self, model: &'a BodyModel, data: DataSource<'a>, shape: Shape) -> Objective<'a> {
        let context = FitContext { model, frame_interval: 1.0 / 25.0, ..self.surroundings.context() };
        Objective::new(&context, context.config, &self.observations, data, shape)
    }

    /// The problem over all unknowns on `model`, with all terms or the one at index `only`.
    fn problem<'a>(&'a self, model: &'a BodyModel, data: DataSource<'a>, only: Option<usize>) -> MotionProblem<'a> {
        let objective = self.objective(model, data, Shape::Free);
        // Typical accelerations: those scaled by speed would follow the model's bones, but are constants of the problem.
        let terms = Objective { has_bones: true, bias: self.table.as_ref(), shape_prior: [3.0, 7.0], ..objective };
        let mut problem = terms.problem();
        keep(&mut problem, only);
        problem
    }
}

/// Checks the gradient of `problem` along directions of all unknowns; `cost_at`: the cost after a step.
pub(super) fn assert_gradient_of(problem: &MotionProblem, state: &MotionState, cost_at: impl Fn(&BandedStep) -> f64) {
    let (n, n_border) = (3 * problem.unknowns.n_groups(), problem.unknowns.border.len());
    let mut system = BlockBanded::zeros(N_FRAMES, problem.unknowns.n_groups(), n_border);
    problem.with_filling(state, |filling| {
        let mut corners = filling.corners();
        filling.within(0..N_FRAMES, &mut system.frames(), &mut corners[0]);
        system.corner = filling.corner(&corners);
    });
    let direction = |d: usize| BandedStep {
        frames: (0..N_FRAMES).map(|t| DVector::from_fn(n, |i, _| wave(11 * t + 13 * i + d))).collect(),
        border: DVector::from_fn(n_border, |i, _| wave(17 * i + d)),
    };
    let directions: Vec<BandedStep> = (0..N_DIRECTIONS).map(direction).collect();
    let slope = |unit: &BandedStep| {
        let by_frame = unit.frames.iter().enumerate().map(|(t, step)| system.gradient(t).dot(step)).sum::<f64>();
        system.corner.gradient.dot(&unit.border) + by_frame
    };
    let slopes: Vec<f64> = directions.iter().map(slope).collect();
    assert!(slopes.iter().any(|slope| *slope != 0.0), "the cost has no slope");
    assert_gradient(&slopes, |amounts| {
        let mut step = BandedStep { frames: vec![DVector::zeros(n); N_FRAMES], border: DVector::zeros(n_border) };
        for (amount, direction) in amounts.iter().zip(&directions) {
            step.frames.iter_mut().zip(&direction.frames).for_each(|(sum, part)| sum.axpy(*amount, part, 1.0));
            step.border.axpy(*amount, &direction.border, 1.0);
        }
        cost_at(&step)
    });
}

/// Leaves one term of the problem, or all for `None`: frame terms come first, then window terms, then the shape prior.
pub(super) fn keep(problem: &mut MotionProblem, only: Option<usize>) {
    let Some(only) = only else { return };
    let (n_frame, n_window) = (problem.frame_terms.len(), problem.window_terms.len());
    let mut index = 0..;
    problem.frame_terms.retain(|_| index.next() == Some(only));
    problem.window_terms.retain(|_| index.next() == Some(only));
    if only != n_frame + n_window {
        (problem.shape_prior.weight, problem.shape_prior.girth_weight) = (0.0, 0.0);
    }
}

/// Data, joint limits, pose prior, smoothness, foot contact and shape, over poses, betas, bone and keypoint offsets.
#[test]
fn gradients_of_motion_terms_match_differences() {
    assert_gradients_of_terms(&Fixture::new());
}

/// Bones are unknowns of the adjustment of cameras, in which keypoints have no offsets.
#[test]
fn gradients_by_bones_alone_match_differences() {
    assert_gradients_of_terms(&Fixture { table: None, ..Fixture::new() });
}

fn assert_gradients_of_terms(fixture: &Fixture) {
    let start = fixture.model_at(&DVector::zeros(fixture.border().len()));
    for data in [DataSource::Points { sigma: 0.5 }, DataSource::Pixels { share: 0.2 }] {
        let all = fixture.problem(&start, data, None);
        let n_terms = all.frame_terms.len() + all.window_terms.len() + 1;
        for only in (0..n_terms).map(Some).chain([None]) {
            let problem = fixture.problem(&start, data, only);
            assert_gradient_of(&problem, &fixture.state, |step| {
                let model = fixture.model_at(&step.border);
                fixture.problem(&model, data, only).cost(&problem.moved(&fixture.state, step))
            });
        }
    }
}

#[test]
fn gradient_of_the_collision_term_matches_differences() {
    let fixture = Fixture::new();
    let (model, capsules) = (&fixture.surroundings.model, BodyCapsules::of(&fixture.surroundings.model));
    let betas = &fixture.state.betas;
    let overlaps = |pose: &Pose| {
        let beside = Pose { translation: pose.translation + Vector3::new(0.25, 0.0, 0.1), ..Pose::rest() };
        let other = CapsuleBody::new(&capsules, (&model.shaped(&Betas::zeros()), &Betas::zeros()), &beside);
        let found = CapsuleBody::new(&capsules, (&model.shaped(betas), betas), pose).overlap(&other, &capsules);
        assert!(found.depth > 0.02 && found.capsules[0].len() > 5, "{}", found.depth);
        found.capsules[0].clone()
    };
    let by_frame: Vec<_> = fixture.state.poses.iter().map(overlaps).collect();
    let collisions = Collisions { capsules: &capsules, by_frame: &by_frame, sigma: 0.01 };
    let mut problem = fixture.objective(model, DataSource::Points { sigma: 0.5 }, Shape::Held).problem();
    problem.frame_terms.push(Box::new(CollisionTerm::new(collisions, &problem.unknowns)));
    let last = problem.frame_terms.len() - 1;
    keep(&mut problem, Some(last));
    assert_gradient_of(&problem, &fixture.state, |step| problem.cost(&problem.moved(&fixture.state, step)));
}

#[test]
fn gradient_of_completed_joints_matches_differences() {
    let fixture = Fixture::new();
    let completed = |joint: usize| {
        let factor = Matrix3::new(3.0, 0.4, 0.1, 0.0, 2.0, -0.3, 0.0, 0.0, 1.0);
        let mean = rotation::exp(&Vector3::new(0.1, wave(joint), 0.2));
        (joint, RotationGaussian { mean, precision: factor.tr_mul(&factor) })
    };
    let of_frame =
        |t: usize| if t.is_multiple_of(2) { vec![completed(3), completed(4), completed(16)] } else { Vec::new() };
    let guided_in = |t: usize| if t.is_multiple_of(3) { vec![completed(17)] } else { Vec::new() };
    let guided = (0..N_FRAMES).map(guided_in).collect();
    let gaps = GapCompletion { hidden: (0..N_FRAMES).map(of_frame).collect(), guided };
    let problem = || {
        let objective = fixture.objective(&fixture.surroundings.model, DataSource::Points { sigma: 0.5 }, Shape::Held);
        Objective { completion: Some(&gaps), ..objective }.problem()
    };
    // Observed landmarks; at the end the likely poses of the other joints, and the completed ones.
    let n_terms = problem().frame_terms.len();
    for term in [0, n_terms - 2, n_terms - 1] {
        let mut problem = problem();
        keep(&mut problem, Some(term));
        assert_gradient_of(&problem, &fixture.state, |step| problem.cost(&problem.moved(&fixture.state, step)));
    }
    // A hidden arm turned to where the detector's errors at its shoulder were smallest.
    let mut observed = problem();
    keep(&mut observed, Some(0));
    let mut turned = MotionState { betas: fixture.state.betas, poses: fixture.state.poses.clone() };
    turned.poses[0].rotations[16] *= rotation::exp(&Vector3::new(0.3, -0.2, 0.5));
    assert_eq!(observed.cost(&turned), observed.cost(&fixture.state));
    turned.poses[1].rotations[16] *= rotation::exp(&Vector3::new(0.3, -0.2, 0.5));
    assert_ne!(observed.cost(&turned), observed.cost(&fixture.state));
}

#[test]
fn gradients_of_border_terms_match_differences() {
    let values: Vec<f64> = (0..12).map(wave).collect();
    let sigmas = vec![Vector3::new(0.02, 0.03, 0.04); 4];
    let girths = Betas::from_fn(|k, _| 0.1 * (k as f64 + 1.0));
    let shape = ShapePrior { weight: 3.0, girth_weight: 7.0, girths };
    let bones = BoneLengthPrior { sigma: 0.2 };
    let bias = KeypointBiasPrior { sigmas };
    for (term, n) in [(&shape as &dyn BorderTerm, 10), (&bones, 12), (&bias, 12)] {
        let values = &values[..n];
        let mut corner = Corner::zeros(n + 2);
        term.add_to(values, 2, &mut corner);
        assert_gradient(&corner.gradient.as_slice()[2..], |d| {
            term.cost(&values.iter().zip(d).map(|(value, d)| value + d).collect::<Vec<_>>())
        });
    }
}
