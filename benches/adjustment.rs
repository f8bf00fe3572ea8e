//! Bundle adjustment on one thread: observations times iterations a second, at 5, 8 and 24 views.
//!
//! `cargo bench --bench adjustment -- [VIEWS...] [--out FOLDER]`. Cameras in a ring, two moving people, independent points (no
//! bone lengths), known lenses without distortion, one robust scale. With `--out`, every problem is written with its solution,
//! so that another solver can be given the same problem (`checks/ceres.py`).

use nalgebra::{Matrix3, Vector2, Vector3};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use std::f64::consts::{PI, TAU};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::Instant;
use wandless::formats::npz::{CompressionMethod, NpzWriter};
use wandless::geometry::{Distortion, Intrinsics, Rigid};
use wandless::optim::robust::GraduatedScale;
use wandless::pipeline::calibration::{Adjusted, CameraFreedom};
use wandless::pipeline::keyframe::{Keyframe, Observation};
use wandless::pipeline::stages::bundle_adjustment::adjust;
use wandless::pipeline::stages::bundle_adjustment::input::{AdjustmentConfig, AdjustmentInput};
use wandless::progress::Progress;

const PEOPLE: usize = 2;
const FRAMES: usize = 300;
const KEYPOINTS: usize = 17;
/// Share of the keypoints that a view detects.
const DETECTED: f64 = 0.9;
/// Share of the detections that are anywhere in the image.
const OUTLIERS: f64 = 0.02;
/// Standard deviation of the other detections, px.
const SIGMA_PX: f64 = 3.0;
/// The last robust scale of the pipeline, standard deviations.
const ROBUST_SCALE: f64 = 4.0;
/// Standard deviations of the start's errors, about as large as those of the detections: camera axes (rad), camera centres and
/// points (m).
const START_TURN: f64 = 0.004;
const START_SHIFT: f64 = 0.02;
/// Runs, of which the fastest counts: others share the machine.
const SAMPLES: usize = 5;

const LENS: Intrinsics = Intrinsics {
    width: 1920,
    height: 1080,
    fx: 1200.0,
    fy: 1200.0,
    cx: 959.5,
    cy: 539.5,
    skew: 0.0,
    dist: Distortion::None,
};

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if !arguments.iter().any(|argument| argument == "--bench") {
        return;
    }
    let views: Vec<usize> = arguments.iter().filter_map(|argument| argument.parse().ok()).collect();
    let out = arguments.iter().position(|argument| argument == "--out").map(|k| PathBuf::from(&arguments[k + 1]));
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("the system can start one thread");
    println!("views  observations  iterations  wall       processor  observation-iterations");
    for views in if views.is_empty() { vec![5, 8, 24] } else { views } {
        let input = problem(views);
        let run = one_thread.install(|| Run::fastest(&input));
        let n_observations = observations(&input).count();
        println!(
            "{views:5}  {n_observations:12}  {:10}  {:7.4} s  {:7.4} s  {:6.3} million/s",
            run.iterations,
            run.wall_s,
            run.processor_s,
            (n_observations * run.iterations) as f64 / run.wall_s * 1e-6,
        );
        if let Some(folder) = &out {
            write(&folder.join(format!("{views}.npz")), &input, &run).expect("the folder can be written");
        }
    }
}

/// A solve, and the time of its iterations alone.
struct Run {
    adjusted: Adjusted,
    cost: f64,
    iterations: usize,
    wall_s: f64,
    processor_s: f64,
}

impl Run {
    /// The times of the fastest run. Setting the problem up and reading the result out are the same with and without
    /// iterations, so the difference is the minimiser's time.
    fn fastest(input: &AdjustmentInput) -> Self {
        let runs: Vec<Self> = (0..SAMPLES).map(|_| Self::of(input, 50)).collect();
        let idle: Vec<Self> = (0..SAMPLES).map(|_| Self::of(input, 0)).collect();
        let least = |runs: &[Self], time: fn(&Self) -> f64| runs.iter().map(time).fold(f64::INFINITY, f64::min);
        let of_iterations = |time: fn(&Self) -> f64| least(&runs, time) - least(&idle, time);
        let (wall_s, processor_s) = (of_iterations(|run| run.wall_s), of_iterations(|run| run.processor_s));
        let last = runs.into_iter().next_back().expect("there is a run");
        Self { wall_s, processor_s, ..last }
    }

    fn of(input: &AdjustmentInput, final_iterations: usize) -> Self {
        let config = AdjustmentConfig {
            scale: GraduatedScale { start: ROBUST_SCALE, end: ROBUST_SCALE, steps: 1 },
            final_iterations,
            uncertainty_block_frames: None,
            ..AdjustmentConfig::default()
        };
        let (start, processor_start) = (Instant::now(), processor_time());
        let (adjusted, report) = adjust(input, &config, &Progress::silent()).expect("it is not canceled");
        let (wall_s, processor_s) = (start.elapsed().as_secs_f64(), processor_time() - processor_start);
        let cost = report.cost_after.expect("bundle adjustment reports its cost");
        Self { adjusted, cost, iterations: report.iterations, wall_s, processor_s }
    }
}

/// Processor time of this thread, s; not a number where the system does not say.
fn processor_time() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|nanos| nanos.parse::<f64>().ok()).map_or(f64::NAN, |nanos| nanos * 1e-9)
}

fn normal(rng: &mut impl Rng, sigma: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal) * sigma)
}

/// The problem of a number of views: the same in every run.
fn problem(n_views: usize) -> AdjustmentInput<'static> {
    let mut rng = ChaCha8Rng::seed_from_u64(n_views as u64);
    let cameras: Vec<Rigid> = (0..n_views).map(|view| camera(view as f64 / n_views as f64 * TAU)).collect();
    let body: Vec<Vector3<f64>> = (0..KEYPOINTS)
        .map(|k| normal(&mut rng, 0.2).component_mul(&Vector3::new(1.0, 1.0, 0.0)) + Vector3::z() * 0.1 * k as f64)
        .collect();
    let mut keyframes = Vec::new();
    for (frame, person) in (0..FRAMES).flat_map(|frame| (0..PEOPLE).map(move |person| (frame, person))) {
        let angle = 0.05 * frame as f64 + person as f64 * PI;
        let place = Vector3::new(angle.cos(), (2.0 * angle).sin(), 0.0) * 2.0;
        let points: Vec<Vector3<f64>> = body.iter().map(|x| x + place + normal(&mut rng, 0.05)).collect();
        let observations = detections(&mut rng, &cameras, &points);
        let points = points.iter().map(|x| Some(x + normal(&mut rng, START_SHIFT))).collect();
        keyframes.push(Keyframe { person, frame, points, observations });
    }
    let mut moved =
        |camera: &Rigid| Some(camera.perturbed_left(&normal(&mut rng, START_SHIFT), &normal(&mut rng, START_TURN)));
    AdjustmentInput {
        intrinsics: vec![LENS; n_views].leak(),
        cameras: cameras.iter().map(&mut moved).collect(),
        keyframes,
        bones: &[],
        camera_freedom: CameraFreedom::Adjusted,
        refine_focal: false,
        refine_delays: false,
        drift_over: None,
        refine_radial: false,
    }
}

/// A camera of a ring of 5 m at a height of 2.5 m, which looks at the middle of the area; z is up.
fn camera(angle: f64) -> Rigid {
    let center = Vector3::new(5.0 * angle.cos(), 5.0 * angle.sin(), 2.5);
    let forward = (Vector3::new(0.0, 0.0, 0.9) - center).normalize();
    let right = forward.cross(&Vector3::z()).normalize();
    let rotation = Matrix3::from_columns(&[right, forward.cross(&right), forward]).transpose();
    Rigid { rotation, translation: -(rotation * center) }
}

/// What the cameras detect of a person, as far as at least two do.
fn detections(rng: &mut impl Rng, cameras: &[Rigid], points: &[Vector3<f64>]) -> Vec<Observation> {
    let mut found = Vec::new();
    for (view, camera) in cameras.iter().enumerate() {
        for (keypoint, point) in points.iter().enumerate() {
            let Some(exact) = LENS.pixel_from_camera(&camera.transform(point)) else { continue };
            let anywhere = Vector2::new(rng.random_range(0.0..1920.0), rng.random_range(0.0..1080.0));
            let pixel = if rng.random_bool(OUTLIERS) { anywhere } else { exact + normal(rng, SIGMA_PX).xy() };
            if rng.random_bool(DETECTED) {
                found.push(Observation { keypoint, view, pixel, sigma_px: SIGMA_PX, velocity: Vector2::zeros() });
            }
        }
    }
    // A single view does not determine a point; the pipeline leaves it out.
    let mut views = [0; KEYPOINTS];
    found.iter().for_each(|observation| views[observation.keypoint] += 1);
    found.retain(|observation| views[observation.keypoint] >= 2);
    found
}

/// Every observation with the index of its point among those of all keyframes.
fn observations<'a>(input: &'a AdjustmentInput) -> impl Iterator<Item = (usize, &'a Observation)> {
    input.keyframes.iter().enumerate().flat_map(|(i, keyframe)| {
        keyframe.observations.iter().map(move |observation| (i * KEYPOINTS + observation.keypoint, observation))
    })
}

/// Start, observations and solution. Poses are `camera_from_world`, 3x4 row by row.
fn write(path: &Path, input: &AdjustmentInput, run: &Run) -> std::io::Result<()> {
    let mut npz = NpzWriter::new(File::create(path)?, CompressionMethod::Stored);
    let (n_views, n_points) = (input.cameras.len(), input.keyframes.len() * KEYPOINTS);
    let poses = |pose: &Rigid| {
        let rows = |row| pose.rotation.row(row).iter().copied().chain([pose.translation[row]]).collect::<Vec<_>>();
        (0..3).flat_map(rows).collect::<Vec<f64>>()
    };
    let coordinates =
        |points: &[Option<Vector3<f64>>]| points.iter().flatten().flat_map(|x| [x.x, x.y, x.z]).collect::<Vec<f64>>();
    let lenses = input.intrinsics.iter().flat_map(|lens| [lens.fx, lens.fy, lens.cx, lens.cy]);
    npz.array("lenses", &[n_views, 4], lenses)?;
    npz.array("start_poses", &[n_views, 3, 4], input.cameras.iter().flatten().flat_map(poses))?;
    npz.array("start_points", &[n_points, 3], input.keyframes.iter().flat_map(|k| coordinates(&k.points)))?;
    let n = observations(input).count();
    npz.array("view", &[n], observations(input).map(|(_, o)| o.view as i64))?;
    npz.array("point", &[n], observations(input).map(|(point, _)| point as i64))?;
    npz.array("pixel", &[n, 2], observations(input).flat_map(|(_, o)| [o.pixel.x, o.pixel.y]))?;
    npz.array("sigma_px", &[n], observations(input).map(|(_, o)| o.sigma_px))?;
    npz.array("robust_scale", &[], [ROBUST_SCALE])?;
    let solved = run.adjusted.cameras.iter().filter_map(|camera| camera.camera_from_world);
    npz.array("poses", &[n_views, 3, 4], solved.flat_map(|pose| poses(&pose)))?;
    npz.array("points", &[n_points, 3], run.adjusted.points.iter().flat_map(|points| coordinates(points)))?;
    npz.array("iterations", &[], [run.iterations as i64])?;
    npz.array("wall_s", &[], [run.wall_s])?;
    npz.array("processor_s", &[], [run.processor_s])?;
    npz.array("cost", &[], [run.cost])?;
    npz.finish()?.sync_all()
}
