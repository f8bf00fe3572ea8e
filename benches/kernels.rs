//! Kernels on one thread: camera projection, body kinematics, and the denoiser of the motion prior.

use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use nalgebra::{Matrix3, Vector2, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use wandless::body::joint_ranges::natural_pose;
use wandless::body::kinematics::{Pose, landmark_by_rotation, landmark_position, moving_joints, posed};
use wandless::body::skeleton::KeypointConvention;
use wandless::body::skinning::skinned;
use wandless::body::{Betas, default_body};
use wandless::geometry::{Distortion, Intrinsics};
use wandless::motion_prior::MotionPrior;
use wandless::motion_prior::observed::ObservedMotion;

fn main() {
    divan::main();
}

const OPENCV5: Distortion = Distortion::OpenCv5([-0.28, 0.09, 0.0012, -0.0008, -0.012]);
const FISHEYE: Distortion = Distortion::Fisheye4([-0.031, 0.012, -0.006, 0.001]);

fn lens(dist: Distortion) -> Intrinsics {
    Intrinsics { width: 1920, height: 1080, fx: 1200.0, fy: 1200.0, cx: 960.0, cy: 540.0, skew: 0.0, dist }
}

/// Projection of a camera point with its Jacobian.
#[divan::bench(args = [Distortion::None, OPENCV5, FISHEYE])]
fn project_with_jacobian(bencher: Bencher, dist: Distortion) {
    let (lens, point) = (lens(dist), Vector3::new(0.4, -0.3, 3.0));
    bencher.bench(|| black_box(&lens).project_with_jacobian(black_box(&point)));
}

/// Undistortion of a pixel.
#[divan::bench(args = [Distortion::None, OPENCV5, FISHEYE])]
fn normalized_from_pixel(bencher: Bencher, dist: Distortion) {
    let (lens, pixel) = (lens(dist), Vector2::new(1400.0, 200.0));
    bencher.bench(|| black_box(&lens).normalized_from_pixel(black_box(&pixel)));
}

/// Forward kinematics, the 26 Halpe landmarks and their derivatives by every rotation that moves them.
#[divan::bench]
fn kinematics_with_26_landmarks(bencher: Bencher) {
    let model = default_body();
    let body = model.shaped(&Betas::zeros());
    let landmarks: Vec<usize> = model.landmarks_of(KeypointConvention::Halpe26).into_iter().flatten().collect();
    let moved_by: Vec<Vec<usize>> = landmarks.iter().map(|&l| moving_joints(&model.landmarks[l])).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let poses: Vec<Pose> = (0..256).map(|_| natural_pose(&mut rng, 0.5)).collect();
    let mut positions = vec![Vector3::zeros(); landmarks.len()];
    let mut derivatives: Vec<Vec<Matrix3<f64>>> = moved_by.iter().map(|j| vec![Matrix3::zeros(); j.len()]).collect();
    bencher.counter(ItemsCount::new(poses.len())).bench_local(|| {
        for pose in &poses {
            let skeleton = posed(&body, black_box(pose));
            for (i, &landmark) in landmarks.iter().enumerate() {
                positions[i] = landmark_position(&model, &body, &skeleton, landmark);
                for (derivative, &joint) in derivatives[i].iter_mut().zip(&moved_by[i]) {
                    *derivative = landmark_by_rotation(&model, &body, &skeleton, landmark, joint);
                }
            }
            black_box((&mut positions, &mut derivatives));
        }
    });
}

/// Linear blend skinning of all vertices.
#[divan::bench]
fn skinning(bencher: Bencher) {
    let (model, betas) = (default_body(), Betas::zeros());
    let pose = natural_pose(&mut ChaCha8Rng::seed_from_u64(0), 0.5);
    bencher.bench(|| skinned(black_box(&model), &betas, black_box(&pose)));
}

/// The denoiser on the motions of 4 people x 300 frames, each with a hidden arm.
#[divan::bench(sample_count = 10, sample_size = 1)]
fn motion_prior_denoiser(bencher: Bencher) {
    let (people, frames) = (4, 300);
    let prior = MotionPrior::embedded();
    let mut motion = ObservedMotion::exact(prior.drawn(frames, 1), vec![Vector3::zeros(); frames]);
    motion.hide(&[16, 18, 20], 100..160);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("the system can start one thread");
    bencher.counter(ItemsCount::new(people * frames)).bench_local(|| {
        pool.install(|| (0..people).for_each(|_| drop(black_box(prior.completed(black_box(&motion))))));
    });
}
