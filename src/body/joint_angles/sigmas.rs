//! Standard deviations of joint angles.

use super::{AXIAL, N_ANGLES, SIDE, right};
use crate::body::skeleton::{JOINT_COUNTERPARTS, N_JOINTS};
use nalgebra::Vector3;

/// Standard deviations of the trunk's and the head's angles that positions of joints do not explain, degrees; in the order of
/// the angles. Root mean square errors of `wandless bench bodies` (8 captures, 16 people) less the part of the positions; at
/// least 0.3.
const AXIAL_DEG: [f64; AXIAL.len()] = [1.6, 1.1, 0.3, 3.6, 0.3, 1.4, 0.5, 0.3, 0.3];
/// The same of a side. Those of forearm and wrist are errors on captured motion, where no keypoint shows them; the
/// simulated people hardly move these joints.
const SIDE_DEG: [f64; SIDE.len()] =
    [2.2, 0.3, 1.8, 0.6, 0.8, 0.3, 3.0, 3.7, 3.7, 2.2, 1.8, 3.8, 1.2, 2.9, 30.0, 30.0, 30.0];
/// Share of a joint's standard deviation that counts for a segment's direction. The rest is common to neighbouring joints and
/// shifts the segment: with independent errors 99.9 % of the angles of the same captures were within their 95 % intervals.
const INDEPENDENT_SHARE: f64 = 0.35;

/// Places of the shoulder's angles among those of a side.
const SHOULDER_PLANE: usize = 9;
const SHOULDER_ELEVATION: usize = 10;
const SHOULDER_ROTATION: usize = 11;
const ELBOW_FLEXION: usize = 12;
/// Least sine by which an uncertainty is divided: that of 10 degrees.
const LEAST_SIN: f64 = 0.17;
/// Error of a raised upper arm's rotation about itself, degrees, with the forearm across it: no keypoint but the wrist shows it,
/// by a lever that is the sine of the elbow's flexion. It grows with the squared sine of the elevation, since hanging arms swing
/// alike. From the same captures: 6 to 7 degrees with bent and 10 with nearly straight elbows, 4 with hanging arms.
const RAISED_TWIST_DEG: f64 = 4.8;

/// Joints whose distance shows the direction of a segment: hips for the pelvis, shoulders for the thorax.
const PELVIS: [usize; 2] = [1, 2];
const THORAX: [usize; 2] = [16, 17];
const HEAD: [usize; 2] = [12, 15];

/// The part of an angle's standard deviation that positions of joints do not explain, degrees.
pub fn unexplained_deg() -> [f64; N_ANGLES] {
    let mut all = AXIAL_DEG.into_iter().chain(SIDE_DEG).chain(SIDE_DEG);
    std::array::from_fn(|_| all.next().unwrap_or(f64::NAN)) // as many as angles
}

/// Standard deviations of the angles of a pose, rad.
///
/// `sigma^2 = sigma_0^2 + d_proximal^2 + d_distal^2`, where a segment of length L between joints with the standard deviations
/// `s_a` and `s_b` (three axes together) has the direction's `d = 0.35 sqrt((s_a^2 + s_b^2) / 3) / L`, since errors of
/// neighbouring joints are mostly common, and `sigma_0` is [`unexplained_deg`].
///
/// The shoulder's plane of elevation is uncertain by `sigma / sin(elevation)`. Of its axial rotation the arm shows
/// `rotation + cos(elevation) plane`, so `sigma^2 = sigma_twist^2 + cos(elevation)^2 sigma_plane^2`: with hanging arms only
/// their sum is determined.
///
/// `angles`: of the pose, rad. `rest_joints`: m. `joint_sigmas`: m.
pub fn angle_sigmas(
    angles: &[f64; N_ANGLES],
    rest_joints: &[Vector3<f64>; N_JOINTS],
    joint_sigmas: &[f64; N_JOINTS],
) -> [f64; N_ANGLES] {
    let direction = |[a, b]: [usize; 2]| {
        let length = (rest_joints[a] - rest_joints[b]).norm().max(f64::MIN_POSITIVE);
        INDEPENDENT_SHARE * ((joint_sigmas[a].powi(2) + joint_sigmas[b].powi(2)) / 3.0).sqrt() / length
    };
    let [pelvis, thorax, head] = [PELVIS, THORAX, HEAD].map(direction);
    let axial = [(0.0, pelvis), (pelvis, thorax), (thorax, head)];
    let positional = |segments: &[(f64, f64)], k: usize| segments[k].0.hypot(segments[k].1);
    let unexplained = unexplained_deg().map(f64::to_radians);
    let mut sigmas = [0.0; N_ANGLES];
    for k in 0..AXIAL.len() {
        sigmas[k] = unexplained[k].hypot(positional(&axial, k / 3));
    }
    for (side, is_left) in [false, true].into_iter().enumerate() {
        let of_side = |segment: [usize; 2]| {
            direction(if is_left { segment.map(|joint| JOINT_COUNTERPARTS[joint]) } else { segment })
        };
        let [thigh, shank, foot] = [right::THIGH, right::SHANK, right::FOOT].map(of_side);
        let [upper_arm, forearm, hand] = [right::UPPER_ARM, right::FOREARM, right::HAND].map(of_side);
        let segments = [
            (pelvis, thigh),
            (thigh, shank),
            (shank, foot),
            (thorax, upper_arm),
            (upper_arm, forearm),
            (forearm, hand),
        ];
        let start = AXIAL.len() + side * SIDE.len();
        for k in 0..SIDE.len() {
            sigmas[start + k] = unexplained[start + k].hypot(positional(&segments, k / 3));
        }
        let (sin_elevation, cos_elevation) = angles[start + SHOULDER_ELEVATION].sin_cos();
        let lever = angles[start + ELBOW_FLEXION].sin().abs().max(LEAST_SIN);
        let raised = RAISED_TWIST_DEG.to_radians() * sin_elevation.powi(2) / lever;
        sigmas[start + SHOULDER_PLANE] /= sin_elevation.abs().max(LEAST_SIN);
        let twist = sigmas[start + SHOULDER_ROTATION].hypot(raised);
        sigmas[start + SHOULDER_ROTATION] = twist.hypot(cos_elevation * sigmas[start + SHOULDER_PLANE]);
    }
    sigmas
}
