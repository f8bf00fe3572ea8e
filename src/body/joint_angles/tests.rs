//! Known poses of the default body.

use super::*;
use crate::body::skeleton::JOINT_NAMES;
use crate::body::{Betas, default_body};
use crate::geometry::rotation::exp;

/// Angles in degrees by name, of local rotations about SMPL's axes (x left, y up, z front) from the T-pose.
fn angles_deg(turns: &[(&str, Vector3<f64>)]) -> impl Fn(&str) -> f64 + use<> {
    let mut rotations = [Matrix3::identity(); N_JOINTS];
    for (name, degrees) in turns {
        let joint = JOINT_NAMES.iter().position(|joint| joint == name).unwrap();
        rotations[joint] = exp(&degrees.map(f64::to_radians));
    }
    let angles = joint_angles(&default_body().shaped(&Betas::zeros()).rest_joints, &rotations);
    move |name: &str| angles[angle_names().iter().position(|known| known == name).unwrap()].to_degrees()
}

/// The part of an angle that a turn adds to the T-pose, degrees.
fn assert_adds(turns: &[(&str, Vector3<f64>)], name: &str, expected: f64, tolerance: f64) {
    let added = angles_deg(turns)(name) - angles_deg(&[])(name);
    assert!((added - expected).abs() < tolerance, "{name}: {added} instead of {expected}");
}

#[test]
fn flexions_are_positive_and_agree_on_both_sides() {
    // SMPL's x points left: a positive turn about it bends the trunk forwards and the thigh backwards.
    for (side, ending) in [("left", "l"), ("right", "r")] {
        let joint = |part: &str| format!("{side}_{part}");
        let x = |degrees: f64| Vector3::new(degrees, 0.0, 0.0);
        assert_adds(&[(&joint("hip"), x(-40.0))], &format!("hip_flexion_{ending}"), 40.0, 1.0);
        assert_adds(&[(&joint("knee"), x(60.0))], &format!("knee_flexion_{ending}"), 60.0, 1.0);
        assert_adds(&[(&joint("ankle"), x(-20.0))], &format!("ankle_dorsiflexion_{ending}"), 20.0, 1.0);
        let inwards = Vector3::new(0.0, 0.0, if side == "left" { -15.0 } else { 15.0 });
        assert_adds(&[(&joint("hip"), inwards)], &format!("hip_adduction_{ending}"), 15.0, 0.5);
        let forwards = Vector3::new(0.0, if side == "left" { -70.0 } else { 70.0 }, 0.0);
        assert_adds(&[(&joint("elbow"), forwards)], &format!("elbow_flexion_{ending}"), 70.0, 2.0);
    }
    assert_adds(&[("spine1", Vector3::new(30.0, 0.0, 0.0))], "trunk_extension", -30.0, 1e-6);
    assert_adds(&[("spine1", Vector3::new(0.0, 25.0, 0.0))], "trunk_rotation_left", 25.0, 1e-6);
    assert_adds(&[("neck", Vector3::new(0.0, 0.0, 20.0))], "neck_bending_right", 20.0, 1e-6);
}

#[test]
fn shoulders_have_elevation_and_its_plane() {
    let t_pose = angles_deg(&[]);
    for ending in ["l", "r"] {
        assert!((t_pose(&format!("shoulder_elevation_{ending}")) - 90.0).abs() < 10.0, "arms to the side");
        assert!(t_pose(&format!("shoulder_elevation_plane_{ending}")).abs() < 10.0);
    }
    let forwards = angles_deg(&[("right_shoulder", Vector3::new(0.0, 90.0, 0.0))]);
    assert!((forwards("shoulder_elevation_plane_r") - 90.0).abs() < 10.0);
    let hanging = angles_deg(&[("right_shoulder", Vector3::new(0.0, 0.0, 70.0))]);
    assert!((hanging("shoulder_elevation_r") - (t_pose("shoulder_elevation_r") - 70.0)).abs() < 2.0);
}

#[test]
fn mirrored_poses_have_exchanged_angles() {
    let turn = |joint: usize| Vector3::new(joint as f64, 1.3 * joint as f64, 2.1 * joint as f64).map(f64::sin) * 0.5;
    let rest = default_body().shaped(&Betas::repeat(0.3)).rest_joints;
    let rotations: [Matrix3<f64>; N_JOINTS] = std::array::from_fn(|joint| exp(&turn(joint)));
    let angles = joint_angles(&rest, &rotations);
    let mirrored = joint_angles(&mirrored_points(&rest), &mirrored_rotations(&rotations));
    for k in 0..SIDE.len() {
        let (right, left) = (AXIAL.len() + k, AXIAL.len() + SIDE.len() + k);
        assert!((angles[right] - mirrored[left]).abs() < 1e-9 && (angles[left] - mirrored[right]).abs() < 1e-9);
    }
    assert!((angles[3] - mirrored[3]).abs() < 1e-9 && (angles[4] + mirrored[4]).abs() < 1e-9);
}

#[test]
fn sigmas_grow_with_those_of_joints() {
    let rest = default_body().shaped(&Betas::zeros()).rest_joints;
    let angles = joint_angles(&rest, &[Matrix3::identity(); N_JOINTS]);
    let [exact, uncertain] = [0.0, 0.02].map(|sigma| angle_sigmas(&angles, &rest, &[sigma; N_JOINTS]));
    assert!(exact.iter().zip(&uncertain).all(|(a, b)| a < b && *a > 0.0));
    let knee = angle_names().iter().position(|name| name == "knee_flexion_r").unwrap();
    let lengths = [rest[2] - rest[5], rest[5] - rest[8]].map(|bone| bone.norm());
    let directions = lengths.map(|length| 0.35 * 0.02 * (2.0f64 / 3.0).sqrt() / length);
    let expected = unexplained_deg()[knee].to_radians().hypot(directions[0].hypot(directions[1]));
    assert!((uncertain[knee] - expected).abs() < 1e-12);
}

/// Raised arms were stated to be as certain about their axis as their direction: four of five intervals missed the truth.
#[test]
fn a_raised_straight_arm_hides_its_rotation() {
    let rest = default_body().shaped(&Betas::zeros()).rest_joints;
    let at = |name: &str| angle_names().iter().position(|known| known == name).unwrap();
    let sigma_deg = |elevation: f64, flexion: f64, name: &str| {
        let mut angles = [0.0; N_ANGLES];
        angles[at("shoulder_elevation_r")] = f64::to_radians(elevation);
        angles[at("elbow_flexion_r")] = f64::to_radians(flexion);
        angle_sigmas(&angles, &rest, &[0.01; N_JOINTS])[at(name)].to_degrees()
    };
    let rotation = |elevation, flexion| sigma_deg(elevation, flexion, "shoulder_internal_rotation_r");
    assert!((5.0..8.0).contains(&rotation(90.0, 80.0)), "{}", rotation(90.0, 80.0));
    assert!(rotation(90.0, 15.0) > 2.0 * rotation(90.0, 80.0) && rotation(90.0, 5.0) == rotation(90.0, 1.0));
    let plane = sigma_deg(10.0, 30.0, "shoulder_elevation_plane_r");
    assert!(
        plane > 10.0 && rotation(10.0, 30.0) > plane,
        "hanging arms: plane {plane}, rotation {}",
        rotation(10.0, 30.0)
    );
}
