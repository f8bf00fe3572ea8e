//! Joint limits, natural rest rotations and typical accelerations: a weak prior for joints that no view sees.
//!
//! All values are components of the rotation vector `log(parent_from_joint)`, T-pose frames (x left, y up, z front), given for
//! the midline and the left side; the right side mirrors y and z. Ranges are the clinical ranges of motion of the
//! American Academy of Orthopaedic Surgeons (Joint Motion, 1965), widened by 10 to 20 degrees, since a component of a
//! rotation vector is not a clinical angle when several axes turn together. Rests and spreads are mean and standard
//! deviation over 342 takes of CMU's motion capture, sides pooled, spreads of nearly fixed axes widened to 4 degrees;
//! collars, which those takes do not move, from the shoulder blade's share in raising an arm. Accelerations are typical
//! (median) magnitudes of everyday motion and dance, rad/s^2.

use super::kinematics::Pose;
use super::mocap_skeleton::retargeted;
use super::model::BodyModel;
use super::skeleton::{JOINT_NAMES, N_JOINTS};
use crate::geometry::rotation::{exp, log};
use nalgebra::Vector3;
use rand_distr::{Distribution, StandardNormal};

/// Range, rest and typical acceleration of one joint, radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointRange {
    /// Rotation vector of the natural rest pose.
    pub rest: Vector3<f64>,
    /// Standard deviation about the rest, per component.
    pub spread: Vector3<f64>,
    /// Smallest component that the joint allows.
    pub min: Vector3<f64>,
    /// Largest component that the joint allows.
    pub max: Vector3<f64>,
    /// Typical angular acceleration, rad/s^2.
    pub acceleration: f64,
}

/// One row of the table: rest, spread, min, max per axis in degrees; acceleration in rad/s^2.
type Line = ([f64; 3], [f64; 3], [f64; 3], [f64; 3], f64);

#[rustfmt::skip]
fn line_deg(part: &str) -> Line {
    match part {
        "hip" =>      ([-23.0, 0.0, -5.0], [24.0, 11.0, 10.0], [-135.0, -60.0, -45.0], [40.0, 60.0, 60.0], 12.0),
        "knee" =>     ([40.0, 1.0, 7.0], [26.0, 4.0, 4.0],   [-5.0, -15.0, -15.0],   [155.0, 15.0, 15.0], 12.0),
        "ankle" =>    ([-13.0, -8.0, 0.0], [18.0, 13.0, 19.0], [-40.0, -40.0, -35.0],  [60.0, 40.0, 35.0], 15.0),
        "foot" =>     ([-2.0, 0.0, 0.0], [17.0, 4.0, 4.0],   [-60.0, -10.0, -10.0],  [35.0, 10.0, 10.0], 15.0),
        "spine1" =>   ([8.0, 0.0, 0.0], [12.0, 4.0, 5.0],   [-25.0, -25.0, -25.0],  [50.0, 25.0, 25.0], 7.0),
        "spine2" =>   ([0.0, 0.0, 0.0], [5.0, 4.0, 4.0],   [-20.0, -20.0, -20.0],  [30.0, 20.0, 20.0], 5.0),
        "spine3" =>   ([-4.0, 0.0, 0.0], [4.0, 4.0, 4.0],    [-20.0, -20.0, -20.0],  [25.0, 20.0, 20.0], 5.0),
        "neck" =>     ([-2.0, 0.0, 0.0], [13.0, 14.0, 5.0], [-50.0, -60.0, -35.0],  [50.0, 60.0, 35.0], 8.0),
        "head" =>     ([-2.0, 0.0, 0.0], [7.0, 6.0, 8.0], [-40.0, -45.0, -30.0],  [35.0, 45.0, 30.0], 8.0),
        "collar" =>   ([0.0, 0.0, 0.0],      [5.0, 8.0, 10.0],   [-10.0, -25.0, -20.0],  [10.0, 25.0, 35.0], 5.0),
        "shoulder" => ([15.0, -23.0, -66.0], [28.0, 26.0, 31.0], [-120.0, -150.0, -125.0], [120.0, 70.0, 110.0], 15.0),
        "elbow" =>    ([0.0, -48.0, 23.0], [15.0, 33.0, 17.0], [-130.0, -160.0, -60.0], [110.0, 10.0, 80.0], 15.0),
        "wrist" =>    ([-1.0, 2.0, 16.0], [13.0, 20.0, 15.0], [-60.0, -50.0, -90.0],  [60.0, 50.0, 85.0], 15.0),
        // The pelvis is free; the hands stay at identity.
        _ =>          ([0.0; 3],             [180.0; 3],         [-360.0; 3],            [360.0; 3], 8.0),
    }
}

/// The ranges of all joints in SMPL's order. The pelvis is unlimited.
pub fn joint_ranges() -> [JointRange; N_JOINTS] {
    std::array::from_fn(|j| {
        let name = JOINT_NAMES[j];
        let (part, is_right) = match (name.strip_prefix("left_"), name.strip_prefix("right_")) {
            (_, Some(part)) => (part, true),
            (Some(part), _) => (part, false),
            _ => (name, false),
        };
        let (rest, spread, min, max, acceleration) = line_deg(part);
        let mirrored = |v: [f64; 3], w: [f64; 3]| {
            let v = if is_right { [v[0], -w[1], -w[2]] } else { v };
            Vector3::from(v).map(f64::to_radians)
        };
        JointRange {
            rest: mirrored(rest, rest),
            spread: Vector3::from(spread).map(f64::to_radians),
            min: mirrored(min, max),
            max: mirrored(max, min),
            acceleration,
        }
    })
}

/// The ranges of a body: as [`joint_ranges`], its rests retargeted from the mocap skeleton.
pub fn joint_ranges_of(model: &BodyModel) -> [JointRange; N_JOINTS] {
    let mut ranges = joint_ranges();
    for (joint, range) in ranges.iter_mut().enumerate() {
        range.rest = log(&retargeted(&exp(&range.rest), joint, &model.mocap_from_body));
    }
    ranges
}

/// Draws a pose: joints are normally distributed about their rests, with `spread` times their standard deviations, within
/// their ranges; pelvis and hands are at identity.
pub fn natural_pose(rng: &mut impl rand::Rng, spread: f64) -> Pose {
    let mut pose = Pose::rest();
    for (turn, range) in pose.rotations.iter_mut().zip(joint_ranges()).take(FIRST_HAND).skip(1) {
        let step =
            range.spread.map(|sigma| -> f64 { sigma * spread * Distribution::<f64>::sample(&StandardNormal, rng) });
        *turn = exp(&(range.rest + step).sup(&range.min).inf(&range.max));
    }
    pose
}

/// First of the two joints that have no range.
const FIRST_HAND: usize = 22;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joints_rest_inside_their_ranges_and_sides_mirror() {
        let ranges = joint_ranges();
        for r in &ranges {
            for axis in 0..3 {
                assert!(r.min[axis] < r.rest[axis] && r.rest[axis] < r.max[axis] && r.spread[axis] > 0.0);
            }
        }
        let (left, right) = (&ranges[18], &ranges[19]);
        assert_eq!((left.min.y, left.max.y), (-right.max.y, -right.min.y));
        assert_eq!((left.min.x, left.max.x), (right.min.x, right.max.x));
    }
}
