//! Seeded synthetic truth: walking stick people in a ring of cameras.

use super::input::Bone;
use super::*;
use crate::geometry::similarity::{ScaleMode, similarity_from_points};
use crate::geometry::{Intrinsics, Rigid, rotation};
use crate::pipeline::calibration::CameraFreedom;
use crate::pipeline::camera_clock::take_time;
use crate::pipeline::keyframe::{Keyframe, Observation};
use nalgebra::{Matrix3, Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Parent and length of each keypoint of the stick person; keypoint 0 is the root.
const STICKS: [(usize, f64); 14] = [
    (0, 0.50), // neck
    (1, 0.25), // head
    (1, 0.20), // left shoulder
    (3, 0.30),
    (4, 0.26),
    (1, 0.20), // right shoulder
    (6, 0.30),
    (7, 0.26),
    (0, 0.13), // left hip
    (9, 0.43),
    (10, 0.42),
    (0, 0.13), // right hip
    (12, 0.43),
    (13, 0.42),
];

struct StickScene {
    intrinsics: Vec<Intrinsics>,
    cameras: Vec<Rigid>,
    /// [keyframe][keypoint]
    points: Vec<Vec<Vector3<f64>>>,
    people_and_frames: Vec<(usize, usize)>,
    bones: Vec<Bone>,
}

/// How the observations differ from the truth.
#[derive(Clone, Copy)]
struct Noise {
    sigma_px: f64,
    /// Share of observations displaced by up to 200 px.
    outliers: f64,
    /// Correlation of one frame's noise with the next one's.
    persistence: f64,
}

const NOISE: Noise = Noise { sigma_px: 3.0, outliers: 0.05, persistence: 0.0 };

fn gauss(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

fn gauss3(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| gauss(rng))
}

fn look_at(center: Vector3<f64>, target: Vector3<f64>) -> Rigid {
    let z = (target - center).normalize();
    let x = z.cross(&Vector3::y()).normalize(); // world y is up, image y down
    let rotation = Matrix3::from_rows(&[x.transpose(), z.cross(&x).transpose(), z.transpose()]);
    Rigid { rotation, translation: -(rotation * center) }
}

fn stick_person(person: usize, frame: usize) -> Vec<Vector3<f64>> {
    let t = frame as f64 / 25.0;
    let (phase, radius) = (person as f64 * 2.4, 0.7 + 0.5 * person as f64);
    let heading = 0.6 * t + phase;
    let turn = rotation::exp(&(Vector3::y() * heading));
    let mut points = vec![Vector3::new(radius * heading.cos(), 0.95 + 0.03 * (7.0 * t).sin(), radius * heading.sin())];
    for (k, &(parent, length)) in STICKS.iter().enumerate() {
        let side = if (2..5).contains(&k) || (8..11).contains(&k) { 1.0 } else { -1.0 };
        let swing = 0.6 * side * (5.0 * t + phase + 0.3 * k as f64).sin();
        let direction = match k {
            0 | 1 => Vector3::new(0.1 * swing, 1.0, 0.1),
            2 | 5 | 8 | 11 => Vector3::new(side, -0.2, 0.1 * swing),
            _ => Vector3::new(0.15 * side, -1.0, swing),
        };
        points.push(points[parent] + turn * direction.normalize() * length * (1.0 - 0.08 * person as f64));
    }
    points
}

fn scene(n_cameras: usize, n_people: usize, n_frames: usize) -> StickScene {
    let lens = Intrinsics {
        width: 1920,
        height: 1080,
        fx: 1000.0,
        fy: 1000.0,
        cx: 960.0,
        cy: 540.0,
        skew: 0.0,
        dist: [-0.1, 0.02, 0.001, -0.001, 0.0].into(),
    };
    let camera = |v: usize| {
        let angle = v as f64 / n_cameras as f64 * std::f64::consts::TAU + 0.3 * (v % 2) as f64;
        look_at(Vector3::new(4.5 * angle.cos(), 1.8 + 0.3 * (v % 3) as f64, 4.5 * angle.sin()), Vector3::y())
    };
    let people_and_frames: Vec<_> = (0..n_people).flat_map(|p| (0..n_frames).map(move |f| (p, f))).collect();
    StickScene {
        intrinsics: vec![lens; n_cameras],
        cameras: (0..n_cameras).map(camera).collect(),
        points: people_and_frames.iter().map(|&(p, f)| stick_person(p, f)).collect(),
        people_and_frames,
        bones: STICKS.iter().enumerate().map(|(k, &(parent, _))| Bone { a: parent, b: k + 1, sigma: 0.02 }).collect(),
    }
}

/// Noisy observations of the whole scene and points perturbed by `point_sigma` (m).
fn observe(scene: &StickScene, noise: Noise, point_sigma: f64, seed: u64) -> Vec<Keyframe> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let n_views = scene.cameras.len();
    let mut drift = vec![Vector2::zeros(); n_views * (STICKS.len() + 1)];
    let innovation = (1.0 - noise.persistence * noise.persistence).sqrt();
    let mut keyframes = Vec::new();
    for (&(person, frame), truth) in scene.people_and_frames.iter().zip(&scene.points) {
        let mut observations = Vec::new();
        for view in 0..n_views {
            for (keypoint, point) in truth.iter().enumerate() {
                let drift = &mut drift[view * (STICKS.len() + 1) + keypoint];
                let fresh = Vector2::new(gauss(&mut rng), gauss(&mut rng));
                *drift = if frame == 0 { fresh } else { *drift * noise.persistence + fresh * innovation };
                let gross = Vector2::new(rng.random_range(-200.0..200.0), rng.random_range(-200.0..200.0));
                let (is_gross, is_missed) = (rng.random_bool(noise.outliers), rng.random_bool(0.3));
                let in_camera = scene.cameras[view].transform(point);
                let pixel = scene.intrinsics[view].pixel_from_camera(&in_camera).unwrap();
                let error = *drift * noise.sigma_px + if is_gross { gross } else { Vector2::zeros() };
                if !is_missed {
                    observations.push(Observation {
                        keypoint,
                        view,
                        pixel: pixel + error,
                        sigma_px: 3.0,
                        velocity: Vector2::zeros(),
                    });
                }
            }
        }
        let points = truth.iter().map(|x| Some(x + gauss3(&mut rng) * point_sigma)).collect();
        keyframes.push(Keyframe { person, frame, points, observations });
    }
    keyframes
}

/// Cameras `angle_deg` and `position_m` off, in random directions.
fn perturbed(cameras: &[Rigid], angle_deg: f64, position_m: f64, seed: u64) -> Vec<Option<Rigid>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut off = |camera: &Rigid| {
        let turn = rotation::exp(&(gauss3(&mut rng).normalize() * angle_deg.to_radians()));
        let center = camera.center() + gauss3(&mut rng).normalize() * position_m;
        let rotation = turn * camera.rotation;
        Some(Rigid { rotation, translation: -(rotation * center) })
    };
    cameras.iter().map(&mut off).collect()
}

fn input(scene: &StickScene, cameras: Vec<Option<Rigid>>, keyframes: Vec<Keyframe>) -> AdjustmentInput<'_> {
    AdjustmentInput {
        intrinsics: &scene.intrinsics,
        cameras,
        keyframes,
        bones: &scene.bones,
        camera_freedom: CameraFreedom::Adjusted,
        refine_focal: false,
        refine_delays: false,
        drift_over: None,
        refine_radial: false,
    }
}

fn solve(input: &AdjustmentInput) -> (Adjusted, StageReport) {
    adjust(input, &AdjustmentConfig::default(), &Progress::silent()).unwrap()
}

/// Errors of centre (m) and orientation (rad) per camera, after the similarity that aligns the centres.
fn camera_errors(found: &[Option<Rigid>], truth: &[Rigid]) -> Vec<(f64, f64)> {
    let pairs: Vec<(Rigid, Rigid)> = found.iter().zip(truth).filter_map(|(f, t)| Some(((*f)?, *t))).collect();
    let source: Vec<_> = pairs.iter().map(|(f, _)| f.center()).collect();
    let target: Vec<_> = pairs.iter().map(|(_, t)| t.center()).collect();
    let truth_from_found = similarity_from_points(&source, &target, ScaleMode::Free).unwrap();
    let error = |(found, truth): &(Rigid, Rigid)| {
        let moved = truth_from_found.move_camera(found);
        let angle = rotation::log(&(moved.rotation * truth.rotation.transpose())).norm();
        ((moved.center() - truth.center()).norm(), angle)
    };
    pairs.iter().map(error).collect()
}

fn poses(adjusted: &Adjusted) -> Vec<Option<Rigid>> {
    adjusted.cameras.iter().map(|c| c.camera_from_world).collect()
}

fn worst(errors: &[(f64, f64)]) -> (f64, f64) {
    errors.iter().fold((0.0, 0.0), |w, e| (e.0.max(w.0), e.1.max(w.1)))
}

/// Median error of the points after the similarity that aligns the cameras' centres.
fn point_error(adjusted: &Adjusted, scene: &StickScene) -> f64 {
    let source: Vec<_> = adjusted.cameras.iter().map(|c| c.camera_from_world.unwrap().center()).collect();
    let target: Vec<_> = scene.cameras.iter().map(Rigid::center).collect();
    let truth_from_found = similarity_from_points(&source, &target, ScaleMode::Free).unwrap();
    let found = adjusted.points.iter().flatten().flatten();
    let errors = found.zip(scene.points.iter().flatten()).map(|(f, t)| (truth_from_found.transform(f) - t).norm());
    median(&mut errors.collect::<Vec<_>>()).unwrap()
}

#[test]
fn recovers_cameras_from_a_rough_start_and_bones_help() {
    let scene = scene(5, 2, 60);
    let mut point_errors = Vec::new();
    for bones in [&[][..], &scene.bones] {
        let start = perturbed(&scene.cameras, 5.0, 0.3, 1);
        let input = AdjustmentInput { bones, ..input(&scene, start, observe(&scene, NOISE, 0.15, 1)) };
        let (adjusted, report) = solve(&input);
        let (position, angle) = worst(&camera_errors(&poses(&adjusted), &scene.cameras));
        // Three times the median over seeds; a single point is known to 13 mm (3 px at 1000 px and 4.5 m).
        assert!(position < 0.02, "{position} m");
        assert!(angle.to_degrees() < 0.3, "{} degrees", angle.to_degrees());
        assert_eq!(report.termination, "converged");
        point_errors.push(point_error(&adjusted, &scene));
    }
    assert!(point_errors[1] < 0.95 * point_errors[0], "{point_errors:?} m");
}

#[test]
fn uncertainty_covers_the_error_under_correlated_noise() {
    let scene = scene(4, 2, 300);
    let noise = Noise { persistence: 0.9, ..NOISE };
    let (mut squared_error, mut variance, mut n_within, mut n) = ([0.0; 2], [0.0; 2], 0, 0);
    for seed in 0..16 {
        let start = perturbed(&scene.cameras, 0.5, 0.03, seed);
        let input = AdjustmentInput { bones: &[], ..input(&scene, start, observe(&scene, noise, 0.02, seed)) };
        let (adjusted, _) = solve(&input);
        for (camera, error) in adjusted.cameras.iter().zip(camera_errors(&poses(&adjusted), &scene.cameras)) {
            let uncertainty = camera.uncertainty.unwrap();
            squared_error[0] += error.0.powi(2);
            squared_error[1] += error.1.powi(2);
            variance[0] += uncertainty.sigma_position.powi(2);
            variance[1] += uncertainty.sigma_angle.powi(2);
            n_within += usize::from(error.0 < 2.0 * uncertainty.sigma_position);
            n += 1;
        }
    }
    // 16 runs of some six independent freedoms fix the ratio to about 20 %; blocks of one frame give 8.
    for (e, v) in squared_error.iter().zip(variance) {
        assert!((0.6..1.6).contains(&(e / v)), "squared errors are {} of the stated variance", e / v);
    }
    assert!(n_within as f64 >= 0.88 * n as f64, "{n_within} of {n} within two sigma");
}

#[test]
fn unplaced_cameras_and_unobserved_points_do_not_change() {
    let scene = scene(5, 1, 30);
    let mut start = perturbed(&scene.cameras, 1.0, 0.05, 3);
    start[2] = None;
    let mut keyframes = observe(&scene, NOISE, 0.05, 3);
    let nowhere = Some(Vector3::new(7.0, 7.0, 7.0));
    keyframes[0].points[4] = nowhere;
    keyframes[0].observations.retain(|o| o.keypoint != 4);
    keyframes[1].points[5] = None;
    let broken = Observation {
        keypoint: 99,
        view: 77,
        pixel: Vector2::new(f64::NAN, 0.0),
        sigma_px: 0.0,
        velocity: Vector2::zeros(),
    };
    keyframes[2].observations.push(broken);
    let (adjusted, _) = solve(&input(&scene, start, keyframes));
    assert_eq!(adjusted.cameras[2].camera_from_world, None);
    assert_eq!((adjusted.points[0][4], adjusted.points[1][5]), (nowhere, None));
    let truth: Vec<Rigid> = (0..5).filter(|&v| v != 2).map(|v| scene.cameras[v]).collect();
    let found: Vec<_> = poses(&adjusted).into_iter().filter(Option::is_some).collect();
    let (position, _) = worst(&camera_errors(&found, &truth));
    assert!(position < 0.05, "{position} m"); // one second of one person
}

#[test]
fn one_and_two_threads_give_the_same_bits() {
    let scene = scene(4, 2, 40);
    let input = input(&scene, perturbed(&scene.cameras, 3.0, 0.2, 5), observe(&scene, NOISE, 0.1, 5));
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| solve(&input))
    };
    assert_eq!(run(1), run(2));
}

#[test]
fn gauge_keeps_one_pose_and_one_distance() {
    let scene = scene(4, 1, 40);
    let start = perturbed(&scene.cameras, 3.0, 0.2, 5);
    let (adjusted, _) = solve(&input(&scene, start.clone(), observe(&scene, NOISE, 0.1, 5)));
    let found = poses(&adjusted);
    let anchors: Vec<usize> = (0..4).filter(|&v| found[v] == start[v]).collect();
    assert_eq!(anchors.len(), 1, "exactly one camera stays");
    let distance =
        |poses: &[Option<Rigid>], v: usize| (poses[v].unwrap().center() - poses[anchors[0]].unwrap().center()).norm();
    let kept = (0..4).filter(|&v| v != anchors[0] && (distance(&found, v) - distance(&start, v)).abs() < 1e-9);
    assert_eq!(kept.count(), 1, "exactly one distance stays");
}

#[test]
fn held_cameras_stay_and_points_converge() {
    let scene = scene(4, 1, 30);
    let truth: Vec<_> = scene.cameras.iter().copied().map(Some).collect();
    let keyframes = observe(&scene, NOISE, 0.3, 9);
    let held = AdjustmentInput { camera_freedom: CameraFreedom::Held, ..input(&scene, truth.clone(), keyframes) };
    let (adjusted, _) = solve(&held);
    assert_eq!(poses(&adjusted), truth);
    assert!(adjusted.cameras.iter().all(|c| c.uncertainty.is_none()));
    assert!(point_error(&adjusted, &scene) < 0.02); // one point alone: 13 mm
}

#[test]
fn finds_a_wrong_focal_length() {
    let mut scene = scene(5, 2, 60);
    let keyframes = observe(&scene, NOISE, 0.05, 4);
    scene.intrinsics[1].fx /= 1.06;
    scene.intrinsics[1].fy /= 1.06;
    let start = perturbed(&scene.cameras, 0.5, 0.03, 4);
    let (adjusted, _) = solve(&AdjustmentInput { refine_focal: true, ..input(&scene, start, keyframes) });
    let factors: Vec<f64> = adjusted.cameras.iter().map(|c| c.focal_factor).collect();
    let others = (factors.iter().sum::<f64>() - factors[1]) / 4.0;
    // Focal length trades against distance: 1300 points a camera leave some 0.7 %.
    assert!((factors[1] / others - 1.06).abs() < 0.02, "{factors:?}");
}

#[test]
fn finds_a_distortion_that_was_left_out() {
    let mut scene = scene(5, 2, 60);
    scene.intrinsics[1] = scene.intrinsics[1].with_radial(-0.3);
    let keyframes = observe(&scene, NOISE, 0.05, 4);
    scene.intrinsics[1] = scene.intrinsics[1].with_radial(0.3);
    let start = perturbed(&scene.cameras, 0.5, 0.03, 4);
    let (adjusted, _) =
        solve(&AdjustmentInput { refine_focal: true, refine_radial: true, ..input(&scene, start, keyframes) });
    for (v, camera) in adjusted.cameras.iter().enumerate() {
        let off = camera.radial + if v == 1 { 0.3 } else { 0.0 };
        let sigma = camera.uncertainty.unwrap().sigma_radial.unwrap();
        assert!(off.abs() < 4.0 * sigma && sigma < 0.05, "view {v}: {} +- {sigma}", camera.radial);
    }
}

#[test]
fn finds_delays_from_moving_points() {
    let scene = scene(4, 2, 60);
    let delays = [0.5, -0.4, 0.0, 0.8];
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let mut keyframes = observe(&scene, NOISE, 0.05, 8);
    for o in keyframes.iter_mut().flat_map(|keyframe| &mut keyframe.observations) {
        o.velocity = Vector2::new(gauss(&mut rng), gauss(&mut rng)) * 8.0;
        o.pixel += o.velocity * delays[o.view];
    }
    let start = perturbed(&scene.cameras, 1.0, 0.05, 8);
    let (adjusted, _) = solve(&AdjustmentInput { refine_delays: true, ..input(&scene, start, keyframes) });
    for (v, camera) in adjusted.cameras.iter().enumerate() {
        let found = camera.delay - adjusted.cameras[0].delay;
        let sigma = camera.uncertainty.unwrap().sigma_delay.unwrap();
        // 1200 points a camera of 3 px noise that move by 8 px a frame: 3 / (8 * sqrt(1200)) = 0.011, less what points
        // and cameras take of it.
        assert!((found - (delays[v] - delays[0])).abs() < 0.06, "view {v}: {found}");
        assert!(v == 0 || (0.005..0.04).contains(&sigma), "view {v}: {sigma}");
    }
}

/// A camera whose delay grows from -1 to 1 frame over the take.
#[test]
fn finds_drifts_of_clocks_from_moving_points() {
    let scene = scene(4, 2, 60);
    let (delays, drifts) = ([0.5, -0.4, 0.0, 0.8], [0.0, 0.0, 1.0, -0.3]);
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let mut keyframes = observe(&scene, NOISE, 0.05, 8);
    for keyframe in &mut keyframes {
        let time = take_time(keyframe.frame, 60);
        for o in &mut keyframe.observations {
            o.velocity = Vector2::new(gauss(&mut rng), gauss(&mut rng)) * 8.0;
            o.pixel += o.velocity * (delays[o.view] + drifts[o.view] * time);
        }
    }
    let start = perturbed(&scene.cameras, 1.0, 0.05, 8);
    let free = AdjustmentInput { refine_delays: true, drift_over: Some(60), ..input(&scene, start, keyframes) };
    let (adjusted, _) = solve(&free);
    let first = &adjusted.cameras[0];
    for (v, camera) in adjusted.cameras.iter().enumerate() {
        let (delay, drift) = (camera.delay - first.delay, camera.drift - first.drift);
        assert!((delay - (delays[v] - delays[0])).abs() < 0.06, "view {v}: {delay}");
        let sigma = camera.uncertainty.unwrap().sigma_drift.unwrap();
        // The square root of three times a delay's: times are spread evenly from -1 to 1.
        assert!((drift - drifts[v]).abs() < 0.1, "view {v}: {drift}");
        assert!(v == 0 || (0.008..0.07).contains(&sigma), "view {v}: {sigma}");
    }
}

#[test]
fn empty_input_and_cancellation_end_cleanly() {
    let scene = scene(3, 1, 5);
    let start: Vec<_> = scene.cameras.iter().copied().map(Some).collect();
    let (adjusted, _) = solve(&input(&scene, start.clone(), Vec::new()));
    assert_eq!(poses(&adjusted), start);
    solve(&input(&scene, Vec::new(), observe(&scene, NOISE, 0.0, 1)));

    let canceled = Progress::new(|_| {}, std::sync::Arc::new(true.into()));
    let input = input(&scene, start, observe(&scene, NOISE, 0.0, 1));
    assert_eq!(adjust(&input, &AdjustmentConfig::default(), &canceled), Err(Canceled));
}
