//! The term of whitened pixels: its gradient and its Gauss-Newton system, over motion, shape, offsets and cameras.

use super::super::motion_problem::MotionProblem;
use super::super::objective::Objective;
use super::super::observations::Observations;
use super::camera_unknowns::{CameraUnknowns, FOCAL};
use super::data::DataSource;
use super::noise_process::{NoiseProcess, PathNoise};
use super::tests::{Fixture, N_FRAMES, assert_gradient_of, keep, wave};
use super::unknowns::{Border, CameraColumns, MotionState, Shape};
use super::whitened_pixels::scores::Movements;
use super::whitened_pixels::{Positions, WhitenedPixels};
use crate::body::BodyModel;
use crate::body::kinematics::{landmark_position, posed};
use crate::geometry::{Rigid, rotation};
use crate::optim::block_banded::BlockBanded;
use crate::pipeline::calibration::PosedCamera;
use crate::residuals::derivative_check::assert_gradient;
use nalgebra::{DMatrix, DVector, Matrix3xX, Vector3};

/// No frame or window term of the fixture has this index: only the paths are left.
const PATHS_ALONE: Option<usize> = Some(usize::MAX);

const ROBUST_SCALE: f64 = 4.0;

fn whitened(fixture: &Fixture, observations: &Observations) -> WhitenedPixels {
    let n = fixture.surroundings.model.landmarks.len();
    let process = NoiseProcess { autocorrelation: 0.8, decay: 0.9 };
    let noise = PathNoise { processes: vec![process; n], shares: vec![0.2; n], weights: vec![1.0; n] };
    WhitenedPixels::new(observations, &noise, ROBUST_SCALE)
}

/// Observations of the fixture in two cameras; the second misses every third landmark in the middle frames.
fn two_views(fixture: &Fixture) -> Observations {
    let mut observations = fixture.observations.clone();
    let turned =
        Rigid { rotation: rotation::exp(&Vector3::new(0.1, 1.2, -0.05)), translation: Vector3::new(0.1, -0.2, 4.5) };
    observations.cameras.push(PosedCamera { camera_from_world: turned, ..observations.cameras[0] });
    for (t, pixels) in observations.pixels.iter_mut().enumerate() {
        let is_seen = |landmark: usize| !(1..3).contains(&t) || !landmark.is_multiple_of(3);
        let mut second: Vec<_> = pixels.iter().copied().filter(|pixel| is_seen(pixel.landmark)).collect();
        for pixel in &mut second {
            pixel.camera = 1;
            pixel.pixel += nalgebra::Vector2::new(40.0 * wave(pixel.landmark), 30.0);
        }
        pixels.extend(second);
        pixels.sort_by_key(|pixel| pixel.landmark);
    }
    observations
}

/// [`two_views`] with pixels where the body is.
fn exact_views(fixture: &Fixture) -> Observations {
    let mut observations = two_views(fixture);
    let body = fixture.surroundings.model.shaped(&fixture.state.betas);
    for (pixels, pose) in observations.pixels.iter_mut().zip(&fixture.state.poses) {
        let skeleton = posed(&body, pose);
        for pixel in pixels {
            let camera = &observations.cameras[pixel.camera];
            let position = landmark_position(&fixture.surroundings.model, &body, &skeleton, pixel.landmark);
            let in_camera = camera.camera_from_world.transform(&position);
            pixel.pixel = camera.intrinsics.pixel_from_camera(&in_camera).unwrap();
        }
    }
    observations
}

/// The observed landmarks of the fixture's motion.
fn positions_of(fixture: &Fixture, pixels: &WhitenedPixels) -> Positions {
    let body = fixture.surroundings.model.shaped(&fixture.state.betas);
    let at = |pose| {
        let skeleton = posed(&body, pose);
        let position = |&landmark: &usize| landmark_position(&fixture.surroundings.model, &body, &skeleton, landmark);
        pixels.landmarks.iter().map(position).collect::<Vec<_>>()
    };
    fixture.state.poses.iter().map(at).collect()
}

/// Some movements of all observed landmarks in two directions.
fn some_movements(pixels: &WhitenedPixels, seed: usize) -> Vec<Vec<Matrix3xX<f64>>> {
    let moves = |seed: usize| Matrix3xX::from_fn(2, |i, k| wave(seed + 5 * i + 11 * k));
    let of_frame = |t| (0..pixels.landmarks.len()).map(|l| moves(seed + 17 * t + 3 * l)).collect();
    (0..N_FRAMES).map(of_frame).collect()
}

/// Landmarks and cameras moved by `d` in the directions of `landmarks` and `of_cameras`.
fn moved_by(
    d: &DVector<f64>,
    (positions, cameras): (&Positions, &[PosedCamera]),
    (landmarks, of_cameras): (&[Vec<Matrix3xX<f64>>], &DMatrix<f64>),
) -> (Positions, Vec<PosedCamera>) {
    let point = |(point, by): (&Vector3<f64>, &Matrix3xX<f64>)| point + by * d;
    let of_frame =
        |(points, by): (&Vec<Vector3<f64>>, &Vec<Matrix3xX<f64>>)| points.iter().zip(by).map(point).collect();
    let step = of_cameras * d;
    let mut cameras = cameras.to_vec();
    for (k, camera) in cameras.iter_mut().enumerate() {
        let part = |i: usize| step.fixed_rows::<3>(6 * k + i).into_owned();
        camera.camera_from_world = camera.camera_from_world.perturbed_left(&part(0), &part(3));
    }
    (positions.iter().zip(landmarks).map(of_frame).collect(), cameras)
}

fn problem<'a>(
    fixture: &'a Fixture,
    model: &'a BodyModel,
    observations: &'a Observations,
    pixels: &'a WhitenedPixels,
    cameras: CameraColumns,
) -> MotionProblem<'a> {
    let objective = fixture.objective(model, DataSource::Paths(pixels), Shape::Free);
    let bias = fixture.table.as_ref();
    let mut problem = Objective { has_bones: true, bias, observations, cameras, ..objective }.problem();
    keep(&mut problem, PATHS_ALONE);
    problem
}

#[test]
fn gradient_of_whitened_pixels_matches_differences() {
    let fixture = Fixture::new();
    let observations = two_views(&fixture);
    let columns = CameraColumns { n_cameras: 2, unknowns: CameraUnknowns { focal: true } };
    let border = Border { shape: Shape::Free, has_bones: true, bias: fixture.table.as_ref(), cameras: columns };
    let (pixels, cameras) = (whitened(&fixture, &observations), border.camera_columns());
    let start = fixture.model_at(&DVector::zeros(border.len()));
    let all = problem(&fixture, &start, &observations, &pixels, columns);
    assert_gradient_of(&all, &fixture.state, |step| {
        let mut moved = observations.clone();
        for (k, camera) in moved.cameras.iter_mut().enumerate() {
            let first = cameras.start + columns.unknowns.len() * k;
            let part = |i: usize| step.border.fixed_rows::<3>(first + i).into_owned();
            camera.intrinsics = camera.intrinsics.with_focal_factor(step.border[first + FOCAL].exp());
            camera.camera_from_world = camera.camera_from_world.perturbed_left(&part(0), &part(3));
        }
        let model = fixture.model_at(&step.border);
        problem(&fixture, &model, &moved, &pixels, columns).cost(&all.moved(&fixture.state, step))
    });
}

/// Scores are the parts of the gradient along given movements of landmarks and cameras.
#[test]
fn scores_of_channels_add_up_to_the_gradient() {
    let fixture = Fixture::new();
    let observations = two_views(&fixture);
    let pixels = whitened(&fixture, &observations);
    let (positions, landmarks) = (positions_of(&fixture, &pixels), some_movements(&pixels, 0));
    let of_cameras = DMatrix::from_fn(12, 2, |i, k| wave(7 * i + k));
    let movements = Movements { landmarks: &landmarks, cameras: &of_cameras, of_camera: CameraUnknowns::default() };
    let scores = pixels.scores(&observations.cameras, &positions, &movements);
    assert_eq!(scores.len(), 4 * pixels.landmarks.len());
    let sum = scores.iter().fold(DVector::zeros(2), |sum, score| sum + score);
    assert_gradient(sum.as_slice(), |d| {
        let at = (&positions, observations.cameras.as_slice());
        let (moved, cameras) = moved_by(&DVector::from_column_slice(d), at, (&landmarks, &of_cameras));
        pixels.cost(&cameras, &moved)
    });
}

/// With pixels where the body is, scores are linear in what moves: the leverage is made of their differences.
#[test]
fn what_unknowns_absorb_matches_differences_of_scores() {
    let fixture = Fixture::new();
    let observations = exact_views(&fixture);
    let pixels = whitened(&fixture, &observations);
    let (positions, at) = (positions_of(&fixture, &pixels), observations.cameras.as_slice());
    let landmarks = [some_movements(&pixels, 0), some_movements(&pixels, 400)];
    let of_cameras = [0, 90].map(|first| DMatrix::from_fn(12, 2, |i, k| wave(7 * i + k + first)));
    let movements = |k: usize| Movements {
        landmarks: &landmarks[k],
        cameras: &of_cameras[k],
        of_camera: CameraUnknowns::default(),
    };
    let (directions, draws) = (movements(0), movements(1));
    // Of each channel's scores by the directions, along one column of some movements.
    let differences = |moving: &Movements, column: usize| {
        let scores = |size: f64| {
            let mut d = DVector::zeros(2);
            d[column] = size;
            let (moved, cameras) = moved_by(&d, (&positions, at), (moving.landmarks, moving.cameras));
            pixels.scores(&cameras, &moved, &directions)
        };
        let pairs = scores(1e-5).into_iter().zip(scores(-1e-5));
        pairs.map(|(after, before)| (after - before) / 2e-5).collect::<Vec<_>>()
    };
    let errors: f64 =
        [0, 1].iter().flat_map(|&k| differences(&directions, k).into_iter().map(move |score| score[k])).sum();
    let absorbed: f64 = [0, 1].iter().flat_map(|&k| differences(&draws, k)).map(|score| score.norm_squared()).sum();
    let expected = 1.0 - absorbed / 2.0 / errors;
    let found = pixels.unabsorbed((at, &positions), &directions, &draws);
    assert!((found - expected).abs() < 1e-6 * expected.abs(), "{found} instead of {expected}");
}

/// With pixels where the body is, the Gauss-Newton system is exact: a step from nearby leaves a thousandth of the cost.
/// Without its blocks between frames it would leave most of it.
#[test]
fn one_step_from_nearby_removes_the_cost_of_paths() {
    let fixture = Fixture::new();
    let observations = exact_views(&fixture);
    let pixels = whitened(&fixture, &observations);
    let objective = fixture.objective(&fixture.surroundings.model, DataSource::Paths(&pixels), Shape::Held);
    let mut problem = Objective { observations: &observations, ..objective }.problem();
    keep(&mut problem, PATHS_ALONE);
    assert!(problem.cost(&fixture.state) < 1e-12);

    let mut nearby: MotionState = fixture.state.clone();
    for (t, pose) in nearby.poses.iter_mut().enumerate() {
        pose.translation += Vector3::from_fn(|axis, _| 1e-3 * wave(3 * t + axis));
        for (j, turned) in pose.rotations.iter_mut().enumerate() {
            *turned *= rotation::exp(&Vector3::from_fn(|axis, _| 2e-3 * wave(5 * j + 7 * t + axis)));
        }
    }
    let before = problem.cost(&nearby);
    let mut system = BlockBanded::default();
    problem.eliminate(&nearby, 0.0, &mut system).unwrap();
    let step = system.solved(0.0).unwrap();
    assert_eq!(step.frames.len(), N_FRAMES);
    let after = problem.cost(&problem.moved(&nearby, &step));
    assert!(after < 1e-3 * before, "{before} -> {after}");
}
