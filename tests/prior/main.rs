//! Tests of the motion prior: shipped weights, training, motion files.

#![allow(clippy::unwrap_used)] // a test may

mod files;
mod shipped;
mod training;

use nalgebra::Vector3;
use wandless::geometry::rotation;
use wandless::motion_prior::chart::LocalRotations;
use wandless::motion_prior::motion_file::{MotionPose, MotionTake};

/// A person who waves both arms and bends the knees, at frame rate `fps`; takes differ by `phase`.
fn waving(n_frames: usize, fps: f64, phase: f64) -> MotionTake {
    let pose = |f: usize| {
        let time = f as f64 / fps;
        let swing = |rate: f64, size: f64| size * (rate * time + phase).sin();
        let mut rotations: LocalRotations = [nalgebra::Matrix3::identity(); 24];
        let mut turn = |joint: usize, w: [f64; 3]| rotations[joint] = rotation::exp(&Vector3::from(w));
        turn(16, [0.0, swing(3.0, 0.3), -1.0 + swing(2.0, 0.4)]);
        turn(17, [0.0, swing(2.5, 0.3), 1.0 + swing(2.2, 0.4)]);
        turn(18, [0.0, -0.6 + swing(2.0, 0.4), 0.0]);
        turn(19, [0.0, 0.6 + swing(1.7, 0.4), 0.0]);
        turn(4, [0.4 + swing(1.5, 0.3), 0.0, 0.0]);
        turn(5, [0.4 - swing(1.5, 0.3), 0.0, 0.0]);
        turn(1, [-0.3 + swing(1.5, 0.2), 0.0, 0.0]);
        turn(2, [-0.3 - swing(1.5, 0.2), 0.0, 0.0]);
        for joint in [3, 6, 9, 12, 15, 7, 8, 10, 11, 20, 21] {
            turn(joint, [swing(1.0 + 0.1 * joint as f64, 0.1), swing(0.7, 0.05), swing(1.3, 0.05)]);
        }
        MotionPose { rotations, pelvis: Vector3::new(0.0, 0.9, 0.0) }
    };
    MotionTake { rest_joints: None, poses: (0..n_frames).map(pose).collect(), fps }
}

fn rotations(take: &MotionTake) -> Vec<LocalRotations> {
    take.poses.iter().map(|pose| pose.rotations).collect()
}

fn pelvis(take: &MotionTake) -> Vec<Vector3<f64>> {
    take.poses.iter().map(|pose| pose.pelvis).collect()
}
