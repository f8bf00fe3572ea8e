//! Tests of the posed mesh and of the landmarks.

use nalgebra::{Matrix3, Matrix4, Vector3};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use std::collections::BTreeSet;
use wandless::body::kinematics::{
    Pose, joints_by_betas, landmark_by_betas, landmark_by_rotation, landmark_position, posed,
};
use wandless::body::skeleton::{JOINT_NAMES, KeypointConvention, N_JOINTS, PARENTS};
use wandless::body::skinning::skinned;
use wandless::body::{Betas, BodyModel, default_body};
use wandless::geometry::rotation::exp;

pub(crate) fn random_pose(rng: &mut rand_chacha::ChaCha8Rng, size: f64) -> Pose {
    let mut vector = || Vector3::from_fn(|_, _| -> f64 { StandardNormal.sample(rng) }) * size;
    Pose { rotations: std::array::from_fn(|_| exp(&vector())), translation: vector() }
}

/// The definition, with 4 x 4 matrices: `v = sum_j w_j G_j G_j(rest)^-1 (T + S beta) + t`.
fn slow_vertex(model: &BodyModel, betas: &Betas, pose: &Pose, i: usize) -> Vector3<f64> {
    let surface = &model.surface;
    let joint = |j: usize| {
        let row = surface.regressor[j].iter();
        row.map(|v| (surface.vertices[v.vertex] + surface.shape_directions[v.vertex] * betas) * v.weight)
            .sum::<Vector3<f64>>()
    };
    let global = |j: usize| {
        let mut chain = vec![j];
        while let Some(parent) = PARENTS[*chain.last().unwrap()] {
            chain.push(parent);
        }
        chain.iter().rev().fold(Matrix4::identity(), |global, &k| {
            let from_parent = PARENTS[k].map_or_else(Vector3::zeros, joint);
            let turn = pose.rotations[k].to_homogeneous();
            global * Matrix4::new_translation(&(joint(k) - from_parent)) * turn
        })
    };
    let rest = surface.vertices[i] + surface.shape_directions[i] * betas;
    let moved = |s: &wandless::body::surface::JointWeight| {
        (global(s.joint) * (rest - joint(s.joint)).push(1.0)).xyz() * s.weight
    };
    surface.skin[i].iter().map(moved).sum::<Vector3<f64>>() + pose.translation
}

/// Includes a pose blend shape.
#[test]
fn skinning_agrees_with_its_definition() {
    let model = default_body();
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(10);
    let pose = random_pose(&mut rng, 0.5);
    let betas = Betas::from_fn(|_, _| StandardNormal.sample(&mut rng));
    let vertices = skinned(&model, &betas, &pose);
    for i in (0..vertices.len()).step_by(97) {
        assert!((vertices[i] - slow_vertex(&model, &betas, &pose, i)).norm() < 1e-9);
    }
    let mut bent = model.clone();
    let surface = std::sync::Arc::make_mut(&mut bent.surface);
    surface.pose_directions = vec![0.0; surface.vertices.len() * 3 * 207];
    let (vertex, axis, feature) = (100, 2, 9 * 3 + 5); // knee of the left leg: row 1, column 2
    surface.pose_directions[(vertex * 3 + axis) * 207 + feature] = 0.25;
    surface.vertices[vertex].z -= 0.25 * pose.rotations[4][(1, 2)];
    let again = skinned(&bent, &betas, &pose);
    assert!((0..vertices.len()).all(|i| (again[i] - vertices[i]).norm() < 1e-9));
}

#[test]
fn the_mesh_turns_about_the_rest_pelvis() {
    let model = default_body();
    let mut pose = Pose::rest();
    pose.rotations[0] = exp(&(Vector3::y() * std::f64::consts::PI));
    let pelvis = model.rest_joints[0];
    for (turned, rest) in skinned(&model, &Betas::zeros(), &pose).iter().zip(&model.surface.vertices) {
        let expected = Vector3::new(2.0 * pelvis.x - rest.x, rest.y, 2.0 * pelvis.z - rest.z);
        assert!((turned - expected).norm() < 1e-9);
    }
}

fn bent(bends: &[(&str, Vector3<f64>)]) -> Pose {
    let mut pose = Pose::rest();
    for (name, vector_deg) in bends {
        let joint = JOINT_NAMES.iter().position(|n| n == name).unwrap();
        pose.rotations[joint] = exp(&vector_deg.map(f64::to_radians));
    }
    pose
}

/// Elbow, knee, hip by 90 degrees, arms down, a seat, a squat.
pub(crate) fn standard_poses() -> [(&'static str, Pose); 6] {
    let x = |deg: f64| Vector3::new(deg, 0.0, 0.0);
    let down = |side: f64| Vector3::new(0.0, 0.0, -75.0 * side);
    let legs = |hip: f64, knee: f64| {
        bent(&[("left_hip", x(-hip)), ("right_hip", x(-hip)), ("left_knee", x(knee)), ("right_knee", x(knee))])
    };
    [
        ("elbow", bent(&[("left_elbow", Vector3::new(0.0, -90.0, 0.0))])),
        ("knee", bent(&[("left_knee", x(90.0))])),
        ("hip", bent(&[("left_hip", x(-90.0))])),
        ("arms down", bent(&[("left_shoulder", down(1.0)), ("right_shoulder", down(-1.0))])),
        ("seat", legs(90.0, 90.0)),
        ("squat", legs(110.0, 130.0)),
    ]
}

#[test]
fn bending_keeps_the_volume() {
    let model = default_body();
    let rest = model.surface.volume(&model.surface.vertices);
    for (name, pose) in standard_poses() {
        let change = model.surface.volume(&skinned(&model, &Betas::zeros(), &pose)) / rest - 1.0;
        println!("{name}: {:+.1} %", change * 100.0);
        assert!(change.abs() <= 0.10, "{name}: {change}");
    }
}

/// 100 random poses and shapes, every keypoint of every convention.
#[test]
fn landmarks_are_exact_to_the_full_mesh() {
    let model = default_body();
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(4);
    let mut worst = 0.0_f64;
    for _ in 0..100 {
        let pose = random_pose(&mut rng, 0.6);
        let betas = Betas::from_fn(|_, _| StandardNormal.sample(&mut rng));
        let (body, vertices) = (model.shaped(&betas), skinned(&model, &betas, &pose));
        let skeleton = posed(&body, &pose);
        for convention in KeypointConvention::ALL {
            for (name, landmark) in convention.names().iter().zip(model.landmarks_of(convention)) {
                let place = landmark_position(&model, &body, &skeleton, landmark.unwrap());
                let Some(point) = model.surface.points.iter().find(|p| p.name == *name) else { continue };
                let on_mesh: Vector3<f64> = point.vertices.iter().map(|v| vertices[v.vertex] * v.weight).sum();
                worst = worst.max((place - on_mesh).norm());
            }
        }
    }
    println!("landmarks off the mesh by {worst:.1e} m at most");
    assert!(worst <= 1e-9);
}

/// All derivatives of every keypoint of every convention, relative to the keypoint's largest, over 100
/// random poses and shapes. Central differences with a step of 1e-5 are accurate to 1e-9.
#[test]
fn landmark_derivatives_are_exact() {
    let model = default_body();
    let named = KeypointConvention::ALL.into_iter().flat_map(|c| model.landmarks_of(c)).flatten();
    let landmarks: BTreeSet<usize> = named.collect();
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(44);
    let mut worst = 0.0_f64;
    for _ in 0..100 {
        let pose = random_pose(&mut rng, 0.6);
        let betas = Betas::from_fn(|_, _| StandardNormal.sample(&mut rng));
        let places = |pose: &Pose, betas: &Betas| -> Vec<Vector3<f64>> {
            let body = model.shaped(betas);
            let skeleton = posed(&body, pose);
            landmarks.iter().map(|&l| landmark_position(&model, &body, &skeleton, l)).collect()
        };
        // [unknown][landmark]: 24 turns about three axes, 10 betas, 3 of the translation.
        let difference = |at: &dyn Fn(f64) -> Vec<Vector3<f64>>| -> Vec<Vector3<f64>> {
            at(1e-5).iter().zip(at(-1e-5)).map(|(a, b)| (a - b) / 2e-5).collect()
        };
        let mut measured = Vec::new();
        for (joint, axis) in (0..N_JOINTS).flat_map(|joint| (0..3).map(move |axis| (joint, axis))) {
            measured.push(difference(&|h| {
                let mut turned = pose;
                turned.rotations[joint] *= exp(&Vector3::ith(axis, h));
                places(&turned, &betas)
            }));
        }
        measured.extend((0..10).map(|k| difference(&|h| places(&pose, &(betas + Betas::ith(k, h))))));
        measured.extend((0..3).map(|axis| {
            difference(&|h| {
                let mut moved = pose;
                moved.translation[axis] += h;
                places(&moved, &betas)
            })
        }));
        let body = model.shaped(&betas);
        let skeleton = posed(&body, &pose);
        let by_betas = joints_by_betas(&model, &skeleton);
        for (i, &landmark) in landmarks.iter().enumerate() {
            let of_joint = |j: usize| landmark_by_rotation(&model, &body, &skeleton, landmark, j);
            let mut exact: Vec<Vector3<f64>> = (0..N_JOINTS).flat_map(|j| columns(of_joint(j).as_slice())).collect();
            exact.extend(columns(landmark_by_betas(&model.landmarks[landmark], &skeleton, &by_betas).as_slice()));
            exact.extend(columns(Matrix3::identity().as_slice()));
            let size = exact.iter().map(Vector3::norm).fold(0.0, f64::max);
            let error = exact.iter().zip(&measured).map(|(e, m)| (e - m[i]).norm()).fold(0.0, f64::max);
            worst = worst.max(error / size);
        }
    }
    println!("derivatives of {} landmarks off by {worst:.1e} at most", landmarks.len());
    assert!(worst <= 1e-6);
}

fn columns(values: &[f64]) -> Vec<Vector3<f64>> {
    values.chunks_exact(3).map(Vector3::from_column_slice).collect()
}

#[test]
fn landmarks_lie_at_their_measured_positions() {
    let model = default_body();
    let body = model.shaped(&Betas::zeros());
    let skeleton = posed(&body, &Pose::rest());
    assert!(skeleton.rotations.iter().all(|r| *r == Matrix3::identity()) && skeleton.joints.len() == N_JOINTS);
    for (name, x, y, z) in [
        ("head_top", 0.0, 1.692, 0.0),
        ("nose", 0.0, 1.543, 0.120),
        ("left_eye", 0.0315, 1.581, 0.085),
        ("right_ear", -0.070, 1.5635, 0.0),
        ("left_big_toe", 0.0765, 0.015, 0.189),
        ("right_small_toe", -0.1365, 0.012, 0.155),
        ("left_heel", 0.0865, 0.020, -0.060),
        ("left_hip", 0.0865, 0.873, 0.0),
        ("right_wrist", -0.7034, 1.3543, 0.0),
    ] {
        let place = landmark_position(&model, &body, &skeleton, model.landmark_index(name).unwrap());
        assert!((place - Vector3::new(x, y, z)).norm() < 0.002, "{name}: {place:?}");
    }
}
