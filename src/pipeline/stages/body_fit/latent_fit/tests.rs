//! The fit of latent motions against differences and synthetic truth.

use super::*;
use crate::body::kinematics::{Pose, landmark_position, posed};
use crate::body::model::{Betas, BodyModel};
use crate::geometry::{Intrinsics, rotation};
use crate::motion_prior::MotionPrior;
use crate::optim::block_banded::BandedStep;
use crate::pipeline::stages::body_fit::BodyFitConfig;
use crate::pipeline::stages::body_fit::observations::PixelObservation;
use crate::pipeline::stages::body_fit::test_fixtures::{Surroundings, seen};
use nalgebra::{DVector, Matrix3, Vector2, Vector3};

const DT: f64 = 1.0 / 25.0;

/// Four cameras around the origin, three metres away.
fn cameras() -> Vec<PosedCamera> {
    let camera = |i: usize| {
        let turn = rotation::exp(&Vector3::new(0.0, 0.4 + i as f64 * std::f64::consts::FRAC_PI_2, 0.0));
        let flip = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
        let camera_from_world = Rigid { rotation: flip * turn, translation: Vector3::new(0.0, 0.9, 3.5) };
        PosedCamera {
            intrinsics: Intrinsics {
                width: 1280,
                height: 720,
                fx: 700.0,
                fy: 700.0,
                cx: 640.0,
                cy: 360.0,
                ..Intrinsics::PLAIN
            },
            camera_from_world,
        }
    };
    (0..4).map(camera).collect()
}

/// A motion drawn from the linear code, turning on the spot.
fn truth(model: &BodyModel, n_frames: usize) -> MotionState {
    let pose = |(t, rotations): (usize, [Matrix3<f64>; 24])| {
        let mut pose = Pose { rotations, translation: Vector3::new(0.2, 0.9 + 0.01 * (t as f64).sin(), 0.1) };
        pose.translation -= model.rest_joints[0];
        pose.rotations[0] = rotation::exp(&Vector3::new(0.05, 0.03 * t as f64, 0.0));
        pose
    };
    let drawn = MotionPrior::embedded().drawn(n_frames, 5).into_iter().enumerate().map(pose).collect();
    MotionState { betas: Betas::from_fn(|k, _| 0.4 * (k as f64 - 4.0) / 5.0), poses: drawn }
}

/// The pixels of all landmarks, with errors that differ from one to the next.
fn observations(model: &BodyModel, truth: &MotionState) -> Observations {
    let (body, cameras) = (model.shaped(&truth.betas), cameras());
    let frame = |(t, pose): (usize, &Pose)| {
        let skeleton = posed(&body, pose);
        let mut pixels = Vec::new();
        for landmark in 0..model.landmarks.len() {
            let position = landmark_position(model, &body, &skeleton, landmark);
            for (camera, posed) in cameras.iter().enumerate() {
                let exact = posed.intrinsics.pixel_from_camera(&posed.camera_from_world.transform(&position)).unwrap();
                let error = Vector2::new((7 * t + landmark) as f64, (3 * landmark + camera) as f64).map(f64::sin);
                let pixel = exact + error * 2.0;
                pixels.push(PixelObservation { pixel, scale_px: 300.0, ..seen(landmark, camera) });
            }
        }
        pixels
    };
    let pixels: Vec<_> = truth.poses.iter().enumerate().map(frame).collect();
    Observations { cameras, points: vec![Vec::new(); pixels.len()], pixels }
}

/// The motion with every code and root off.
fn disturbed(mut state: MotionState) -> MotionState {
    for (t, pose) in state.poses.iter_mut().enumerate() {
        pose.rotations[0] *= rotation::exp(&Vector3::new(0.03, -0.02, 0.01 * (t as f64).cos()));
        pose.rotations[16] *= rotation::exp(&Vector3::new(0.1, 0.0, -0.2));
        pose.translation.x += 0.02;
    }
    MotionState { betas: Betas::zeros(), ..state }
}

fn with_problem<T>(test: impl FnOnce(&LatentProblem, &BodyModel) -> T) -> T {
    let mut surroundings = Surroundings::new();
    surroundings.config = BodyFitConfig { window_frames: 20, halo_secs: 8.0 / 30.0, ..BodyFitConfig::default() };
    let context = FitContext { frame_interval: DT, ..surroundings.context() };
    let priors = CameraPriors::of_poses(&context.config.known_cameras);
    test(&problem(&context, true, Some(&priors)), context.model)
}

/// The decoder computes in single precision: steps are long, and a hundredth of the largest derivative is allowed.
#[test]
fn gradient_through_the_decoder_matches_differences() {
    with_problem(|problem, model| {
        let truth = truth(model, 12);
        let observations = observations(model, &truth);
        let start = member(problem, &observations, &disturbed(truth), 0..12, 0.01);
        let system = problem.system(&start, &cameras());
        for t in [0, 5, 11] {
            let gradient = system.gradient(t);
            let largest = gradient.amax();
            for unknown in (0..38).filter(|unknown| unknown % 3 != 1) {
                let step = 1e-3;
                let cost = |h: f64| {
                    let mut frames = vec![DVector::zeros(39); 12];
                    frames[t][unknown] = h;
                    let motion = problem.decoder.moved(&start.motion, &frames, None);
                    problem.cost(&Member { motion, ..start.clone() }, &cameras())
                };
                let found = (cost(step) - cost(-step)) / (2.0 * step);
                let given = gradient[unknown];
                assert!((found - given).abs() < 0.01 * largest, "frame {t}, unknown {unknown}: {given} and {found}");
            }
        }
        let by_border = &system.corner.gradient;
        for unknown in 0..by_border.len() {
            let cost = |h: f64| {
                let mut border = DVector::zeros(by_border.len());
                border[unknown] = h;
                let step = BandedStep { frames: vec![DVector::zeros(39); 12], border };
                problem.cost_after(&start, &cameras(), &step)
            };
            let found = (cost(1e-5) - cost(-1e-5)) / 2e-5;
            let tolerance = 1e-3 * by_border.amax();
            assert!((found - by_border[unknown]).abs() < tolerance, "{unknown}: {} and {found}", by_border[unknown]);
        }
    });
}

#[test]
fn a_disturbed_motion_comes_back() {
    with_problem(|problem, model| {
        let truth = truth(model, 40);
        let observations = observations(model, &truth);
        let mut members = vec![member(problem, &observations, &disturbed(truth.clone()), 0..40, 0.01)];
        let mut cameras = cameras();
        problem.minimised(&mut members, &mut cameras).unwrap();
        let found = &members[0].motion.state;
        // Errors of 2 px at 5 mm a pixel, averaged over cameras and frames; the start is 50 mm off.
        assert!(mean_error(model, found, &truth) < 0.012, "{}", mean_error(model, found, &truth));
        let start = MotionState { betas: truth.betas, ..disturbed(truth.clone()) };
        let held = super::problem(problem.context, false, None);
        let cut = in_windows(&held, &observations, &start, 0.01, &observations.cameras).unwrap().state;
        assert!(mean_error(model, &cut, &truth) < 0.012, "{}", mean_error(model, &cut, &truth));
    });
}

/// Mean distance of the joints relative to the pelvis, m.
fn mean_error(model: &BodyModel, found: &MotionState, truth: &MotionState) -> f64 {
    let joints = |state: &MotionState, t: usize| posed(&model.shaped(&state.betas), &state.poses[t]).joints;
    let n_frames = truth.poses.len();
    let off = |t: usize| {
        let (found, truth) = (joints(found, t), joints(truth, t));
        (1..22).map(|j| ((found[j] - found[0]) - (truth[j] - truth[0])).norm()).sum::<f64>() / 21.0
    };
    (0..n_frames).map(off).sum::<f64>() / n_frames as f64
}
