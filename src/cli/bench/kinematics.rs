//! How fast one core poses a body with all its landmarks and their derivatives.

use crate::body::joint_ranges::natural_pose;
use crate::body::kinematics::{Pose, landmark_by_rotation, landmark_position, moving_joints, posed};
use crate::body::skeleton::KeypointConvention;
use crate::body::{Betas, default_body};
use nalgebra::{Matrix3, Vector3};
use rand::SeedableRng;
use std::hint::black_box;
use std::time::{Duration, Instant};

/// Poses a second of one core: forward kinematics, the 26 landmarks of Halpe, their derivatives to every rotation that
/// moves them (that to the translation is the identity).
pub(super) fn poses_a_second() -> f64 {
    let model = default_body();
    let body = model.shaped(&Betas::zeros());
    let landmarks: Vec<usize> = model.landmarks_of(KeypointConvention::Halpe26).into_iter().flatten().collect();
    let moved_by: Vec<Vec<usize>> = landmarks.iter().map(|&l| moving_joints(&model.landmarks[l])).collect();
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(0);
    let poses: Vec<Pose> = (0..256).map(|_| natural_pose(&mut rng, 0.5)).collect();
    let mut places = vec![Vector3::zeros(); landmarks.len()];
    let mut derivatives: Vec<Vec<Matrix3<f64>>> = moved_by.iter().map(|j| vec![Matrix3::zeros(); j.len()]).collect();
    let (begun, mut n) = (Instant::now(), 0);
    while begun.elapsed() < Duration::from_secs(1) {
        for pose in &poses {
            let skeleton = posed(&body, black_box(pose));
            for (i, &landmark) in landmarks.iter().enumerate() {
                places[i] = landmark_position(&model, &body, &skeleton, landmark);
                for (derivative, &joint) in derivatives[i].iter_mut().zip(&moved_by[i]) {
                    *derivative = landmark_by_rotation(&model, &body, &skeleton, landmark, joint);
                }
            }
            black_box((&mut places, &mut derivatives));
        }
        n += poses.len();
    }
    n as f64 / begun.elapsed().as_secs_f64()
}
