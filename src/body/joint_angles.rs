//! Joint angles in the conventions of the International Society of Biomechanics.
//!
//! Segment axes: x forward, y from the distal to the proximal joint, z to the right (Wu et al. 2002, J Biomech 35; Wu et al.
//! 2005, J Biomech 38). Angles of a joint are those of `proximal_from_distal`:
//!
//! - `R_z R_x R_y` (Grood and Suntay 1983, J Biomech Eng 105): flexion about the proximal segment's z, then about the floating
//!   x, then about the distal segment's own y; all joints but the shoulder
//! - `R_y R_x R_y'`: the shoulder's plane of elevation (0: to the side, 90 degrees: forward), elevation and axial rotation
//!   (Wu et al. 2005, 2.4.7)
//!
//! The left side is mirrored, so that signs have the same meaning on both sides. The pelvis refers to the world (y up) with
//! the same sequence: x, y and z of the world stand for forward, up and right, as in OpenSim.
//!
//! Known limits. Segment axes come from the body model's joints in its T-pose, not from palpated landmarks: pelvis, thorax,
//! head and feet have the body's own axes there, and limbs lie along their bones. Zero is that pose with hanging arms and the
//! palms at the thighs; offsets to landmark-based axes of some degrees are constant. Keypoints of a detector scarcely show
//! rotations about a bone: their standard deviations are large.

mod sigmas;

use crate::body::kinematics::mirrored_rotations;
use crate::body::skeleton::{JOINT_COUNTERPARTS, N_JOINTS, PARENTS};
use crate::geometry::euler::{EulerAngles, yxy_angles, zxy_angles};
use nalgebra::{Matrix3, Vector3};

pub use sigmas::{angle_sigmas, unexplained_deg};

/// Number of angles.
pub const N_ANGLES: usize = AXIAL.len() + 2 * SIDE.len();

/// Angles of the trunk and the head.
const AXIAL: [&str; 9] = [
    "pelvis_tilt",
    "pelvis_list",
    "pelvis_rotation",
    "trunk_extension",
    "trunk_bending_right",
    "trunk_rotation_left",
    "neck_extension",
    "neck_bending_right",
    "neck_rotation_left",
];

/// Angles of a side.
const SIDE: [&str; 17] = [
    "hip_flexion",
    "hip_adduction",
    "hip_internal_rotation",
    "knee_flexion",
    "knee_adduction",
    "knee_internal_rotation",
    "ankle_dorsiflexion",
    "ankle_inversion",
    "ankle_internal_rotation",
    "shoulder_elevation_plane",
    "shoulder_elevation",
    "shoulder_internal_rotation",
    "elbow_flexion",
    "elbow_carrying",
    "forearm_pronation",
    "wrist_flexion",
    "wrist_radial_deviation",
];

/// Names of the angles in order, those of a side with the ending `_r` or `_l`.
pub fn angle_names() -> [String; N_ANGLES] {
    std::array::from_fn(|i| match i.checked_sub(AXIAL.len()) {
        None => AXIAL[i].to_owned(),
        Some(k) if k < SIDE.len() => format!("{}_r", SIDE[k]),
        Some(k) => format!("{}_l", SIDE[k - SIDE.len()]),
    })
}

/// Joints that the right side's segments start and end at.
mod right {
    pub(super) const THIGH: [usize; 2] = [2, 5];
    pub(super) const SHANK: [usize; 2] = [5, 8];
    pub(super) const FOOT: [usize; 2] = [8, 11];
    pub(super) const UPPER_ARM: [usize; 2] = [17, 19];
    pub(super) const FOREARM: [usize; 2] = [19, 21];
    pub(super) const HAND: [usize; 2] = [21, 23];
}

const PELVIS: usize = 0;
const THORAX: usize = 9;
const HEAD: usize = 15;

/// All angles of a pose, rad, in the order of [`angle_names`].
///
/// `rest_joints`: of the person's shape, m. `rotations`: local rotations `parent_from_joint` in SMPL's order, of a world
/// with y up.
pub fn joint_angles(rest_joints: &[Vector3<f64>; N_JOINTS], rotations: &[Matrix3<f64>; N_JOINTS]) -> [f64; N_ANGLES] {
    let mut world_from_joint = *rotations;
    for (joint, parent) in PARENTS.iter().enumerate() {
        if let Some(parent) = *parent {
            world_from_joint[joint] = world_from_joint[parent] * rotations[joint];
        }
    }
    let right = side_angles(rest_joints, &world_from_joint);
    let left = side_angles(&mirrored_points(rest_joints), &mirrored_rotations(&world_from_joint));
    let mut all = axial_angles(&world_from_joint).into_iter().chain(right).chain(left);
    std::array::from_fn(|_| all.next().unwrap_or(f64::NAN)) // as many as names
}

/// ISB's axes of a segment without a bone of its own, as columns in the body's axes at rest (x left, y up, z front).
fn body_axes() -> Matrix3<f64> {
    Matrix3::from_columns(&[Vector3::z(), Vector3::y(), -Vector3::x()])
}

/// The same of a limb's segment: y against its bone, x as near to the front as that allows.
fn bone_axes(rest_joints: &[Vector3<f64>; N_JOINTS], [proximal, distal]: [usize; 2]) -> Matrix3<f64> {
    let y = (rest_joints[proximal] - rest_joints[distal]).normalize();
    let x = (Vector3::z() - y * y.z).normalize();
    Matrix3::from_columns(&[x, y, x.cross(&y)])
}

fn axial_angles(world_from_joint: &[Matrix3<f64>; N_JOINTS]) -> [f64; AXIAL.len()] {
    let [pelvis, thorax, head] = [PELVIS, THORAX, HEAD].map(|joint| world_from_joint[joint] * body_axes());
    let [a, b, c] = [pelvis, pelvis.transpose() * thorax, thorax.transpose() * head].map(|r| zxy_angles(&r));
    [a.outer, a.middle, a.inner, b.outer, b.middle, b.inner, c.outer, c.middle, c.inner]
}

fn side_angles(
    rest_joints: &[Vector3<f64>; N_JOINTS],
    world_from_joint: &[Matrix3<f64>; N_JOINTS],
) -> [f64; SIDE.len()] {
    let bone = |segment: [usize; 2]| world_from_joint[segment[0]] * bone_axes(rest_joints, segment);
    let [thigh, shank, upper_arm, forearm, hand] =
        [right::THIGH, right::SHANK, right::UPPER_ARM, right::FOREARM, right::HAND].map(bone);
    let [pelvis, thorax, foot] = [PELVIS, THORAX, right::FOOT[0]].map(|joint| world_from_joint[joint] * body_axes());
    let between = |proximal: &Matrix3<f64>, distal: &Matrix3<f64>| zxy_angles(&(proximal.transpose() * distal));
    let (hip, knee, ankle) = (between(&pelvis, &thigh), between(&thigh, &shank), between(&shank, &foot));
    let shoulder = yxy_angles(&(thorax.transpose() * upper_arm));
    let (elbow, wrist) = (between(&upper_arm, &forearm), between(&forearm, &hand));
    let [[hip_z, hip_x, hip_y], [knee_z, knee_x, knee_y], [ankle_z, ankle_x, ankle_y]] = [hip, knee, ankle].map(parts);
    let [[elbow_z, elbow_x, elbow_y], [wrist_z, wrist_x, _]] = [elbow, wrist].map(parts);
    [
        hip_z, hip_x, hip_y, -knee_z, knee_x, knee_y, ankle_z, ankle_x, ankle_y, shoulder.outer, -shoulder.middle,
        shoulder.inner, elbow_z, elbow_x, elbow_y, wrist_x, wrist_z,
    ]
}

fn parts(angles: EulerAngles) -> [f64; 3] {
    [angles.outer, angles.middle, angles.inner]
}

fn mirrored_points(points: &[Vector3<f64>; N_JOINTS]) -> [Vector3<f64>; N_JOINTS] {
    JOINT_COUNTERPARTS.map(|joint| {
        let p = points[joint];
        Vector3::new(-p.x, p.y, p.z)
    })
}

#[cfg(test)]
mod tests;
