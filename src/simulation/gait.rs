//! Poses from stance and posture: stepping legs, swinging arms, feet on the floor.

use super::landmarks::Rule;
use super::skeleton::{SimulatedSkeleton, joint};
use crate::body::skeleton::N_JOINTS;
use crate::geometry::rotation;
use crate::motion_prior::motion_file::MotionPose;
use nalgebra::{Matrix3, Vector2, Vector3};
use std::f64::consts::{FRAC_PI_2, PI};

/// Posture of the body apart from stepping; angles in rad, depths 0 to 1. Also used for rates of change.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Posture {
    /// Depth of a squat on both feet.
    pub crouch: f64,
    /// Depth of sitting down; thighs are level at 1.
    pub sit: f64,
    /// Forward lean of the trunk.
    pub lean: f64,
    /// Rotation of the trunk to the left.
    pub trunk_yaw: f64,
    /// Bend of the trunk to the right.
    pub trunk_roll: f64,
    /// Rotation of the head to the left.
    pub head_yaw: f64,
    /// Pitch of the head, down positive.
    pub head_pitch: f64,
    /// Left arm, right arm.
    pub arms: [Arm; 2],
}

/// Posture of an arm; all angles are 0 when it hangs straight down.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Arm {
    /// Forward elevation of the upper arm, rad.
    pub flexion: f64,
    /// Sideways elevation of the upper arm, rad.
    pub abduction: f64,
    /// Bend of the elbow, rad.
    pub elbow: f64,
    /// Amount of swinging with the steps, 0 to 1.
    pub swing: f64,
}

impl Posture {
    /// Combines two postures component by component.
    pub(super) fn zip(&self, other: &Self, f: impl Fn(f64, f64) -> f64) -> Self {
        let arm = |a: &Arm, b: &Arm| Arm {
            flexion: f(a.flexion, b.flexion),
            abduction: f(a.abduction, b.abduction),
            elbow: f(a.elbow, b.elbow),
            swing: f(a.swing, b.swing),
        };
        Self {
            crouch: f(self.crouch, other.crouch),
            sit: f(self.sit, other.sit),
            lean: f(self.lean, other.lean),
            trunk_yaw: f(self.trunk_yaw, other.trunk_yaw),
            trunk_roll: f(self.trunk_roll, other.trunk_roll),
            head_yaw: f(self.head_yaw, other.head_yaw),
            head_pitch: f(self.head_pitch, other.head_pitch),
            arms: [arm(&self.arms[0], &other.arms[0]), arm(&self.arms[1], &other.arms[1])],
        }
    }
}

/// A person's position on the floor and phase of the stride.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stance {
    /// Midpoint between the ankles, world (x, z), m.
    pub position: Vector2<f64>,
    /// Heading, rad from +z towards +x.
    pub heading: f64,
    /// Phase of the stride, rad; at 0 the left heel strikes, at pi the right one.
    pub phase: f64,
    /// Length of a step, m.
    pub step: f64,
    /// Amount of stepping, 0 to 1.
    pub activity: f64,
}

/// Length of a step (m) at a ground speed (m/s); the cadence then grows with the square root of speed, as in real gait.
pub fn step_length(speed: f64) -> f64 {
    0.62 * speed.max(0.1).sqrt()
}

/// The pose of a skeleton in a stance and a posture, its lowest sole on the floor y = 0.
pub fn pose(skeleton: &SimulatedSkeleton, stance: &Stance, posture: &Posture) -> MotionPose {
    let mut rotations = [Matrix3::identity(); N_JOINTS];
    let pelvis_lean = 0.5 * posture.crouch;
    turn_trunk(&mut rotations, stance, posture, pelvis_lean);
    for (side, name) in [Side::Left, Side::Right].into_iter().zip(["left", "right"]) {
        bend_leg(&mut rotations, side, stance, posture, pelvis_lean);
        bend_arm(&mut rotations, side, stance, &posture.arms[usize::from(name == "right")]);
    }
    stand(skeleton, rotations, &stance.position)
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Side {
    Left,
    Right,
}

impl Side {
    /// The joint of this side, given the left one, which the right one follows in SMPL's order.
    fn joint(self, left: usize) -> usize {
        left + usize::from(self == Self::Right)
    }

    /// A rotation given for the left side, reflected in the plane x = 0 for the right.
    fn rotation(self, left: Matrix3<f64>) -> Matrix3<f64> {
        let mirror = Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, 1.0));
        if self == Self::Left { left } else { mirror * left * mirror }
    }

    /// The stride's phase of this leg.
    fn phase(self, stance: &Stance) -> f64 {
        stance.phase + if self == Self::Left { 0.0 } else { PI }
    }
}

fn about_x(angle: f64) -> Matrix3<f64> {
    rotation::exp(&Vector3::new(angle, 0.0, 0.0))
}

fn about_y(angle: f64) -> Matrix3<f64> {
    rotation::exp(&Vector3::new(0.0, angle, 0.0))
}

fn about_z(angle: f64) -> Matrix3<f64> {
    rotation::exp(&Vector3::new(0.0, 0.0, angle))
}

/// 1 at phase 0, 0 half a stride away, smooth in between.
fn bump(phase: f64) -> f64 {
    (0.5 * (1.0 + phase.cos())).powi(2)
}

fn turn_trunk(rotations: &mut [Matrix3<f64>; N_JOINTS], stance: &Stance, posture: &Posture, pelvis_lean: f64) {
    let sway = stance.activity * stance.phase.cos();
    rotations[joint("pelvis")] = about_y(stance.heading - 0.10 * sway) * about_x(pelvis_lean);
    let lean = posture.lean + 0.45 * posture.crouch + 0.15 * posture.sit + 0.06 * stance.activity;
    let vertebra = about_y((posture.trunk_yaw + 0.18 * sway) / 3.0)
        * about_x(lean / 3.0)
        * about_z((0.03 * stance.activity * stance.phase.sin() - posture.trunk_roll) / 3.0);
    for name in ["spine1", "spine2", "spine3"] {
        rotations[joint(name)] = vertebra;
    }
    // The head looks ahead when the trunk bends.
    let nod = 0.5 * (posture.head_pitch - 0.6 * (lean + pelvis_lean));
    for name in ["neck", "head"] {
        rotations[joint(name)] = about_y(0.5 * posture.head_yaw - 0.04 * sway) * about_x(nod);
    }
}

/// Hip, knee and ankle in the sagittal plane: forward swing, knee bent while it swings, heel first, toes last.
fn bend_leg(
    rotations: &mut [Matrix3<f64>; N_JOINTS],
    side: Side,
    stance: &Stance,
    posture: &Posture,
    pelvis_lean: f64,
) {
    let (phase, activity) = (side.phase(stance), stance.activity);
    let stride = (0.5 * stance.step / 0.8).min(0.6).asin();
    let thigh = 0.05 + activity * stride * (phase.cos() + 0.15) + 1.5 * posture.crouch + 1.5 * posture.sit;
    let knee = 0.08
        + activity * (0.95 * bump(phase - 1.42 * PI) + 0.16 * bump(phase - 0.25 * PI))
        + 2.4 * posture.crouch
        + 1.5 * posture.sit;
    let foot = activity * (0.50 * bump(phase - 1.08 * PI) - 0.22 * bump(phase - 1.94 * PI));
    let splay = about_z(0.03 + 0.15 * posture.crouch + 0.06 * posture.sit);
    rotations[side.joint(joint("left_hip"))] = side.rotation(about_x(-thigh - pelvis_lean) * splay);
    rotations[side.joint(joint("left_knee"))] = about_x(knee);
    rotations[side.joint(joint("left_ankle"))] = side.rotation(about_y(0.12) * about_x(foot + thigh - knee));
    rotations[side.joint(joint("left_foot"))] = about_x(-0.5 * foot.max(0.0));
}

fn bend_arm(rotations: &mut [Matrix3<f64>; N_JOINTS], side: Side, stance: &Stance, arm: &Arm) {
    let swing = arm.swing * stance.activity * (-side.phase(stance).cos());
    let (flexion, abduction) = (arm.flexion + 0.38 * swing, 0.12 + arm.abduction);
    let elbow = 0.25 + arm.elbow + 0.18 * arm.swing * stance.activity * (1.0 + swing);
    // The shoulder blade takes its share of a raised arm, about a fifth here.
    let raised = 0.2 * (flexion.max(0.0).hypot(abduction) - 0.5).max(0.0);
    rotations[side.joint(joint("left_collar"))] = side.rotation(about_z(raised));
    rotations[side.joint(joint("left_shoulder"))] =
        side.rotation(about_x(-flexion) * about_z(abduction - raised - FRAC_PI_2) * about_x(ELBOW_TILT));
    rotations[side.joint(joint("left_elbow"))] =
        side.rotation(about_x(-ELBOW_TILT) * about_y(-elbow) * about_x(ELBOW_TILT));
    rotations[side.joint(joint("left_wrist"))] = side.rotation(about_z(0.28));
}

/// Rotation of the elbow's axis about the upper arm in motion capture, rad; the upper arm is rotated back by the same angle
/// (mean over CMU's takes: flexion about (0, -48, 23) degrees).
const ELBOW_TILT: f64 = 0.45;

/// Points of the soles in the frames of ankle and foot joints, m.
const SOLE: [(usize, [f64; 3]); 6] = [
    (joint("left_ankle"), [0.0, -0.075, -0.050]),
    (joint("right_ankle"), [0.0, -0.075, -0.050]),
    (joint("left_foot"), [0.0, -0.025, 0.0]),
    (joint("right_foot"), [0.0, -0.025, 0.0]),
    (joint("left_foot"), [0.0, -0.025, 0.070]),
    (joint("right_foot"), [0.0, -0.025, 0.070]),
];

/// Softness of the minimum over the soles' heights, m: a hard minimum would jerk the whole body at every step.
const SOLE_SOFTNESS: f64 = 0.006;

/// Moves the midpoint of the ankles over `position` and the soles onto the floor (at most 11 mm above it, never below).
fn stand(skeleton: &SimulatedSkeleton, rotations: [Matrix3<f64>; N_JOINTS], position: &Vector2<f64>) -> MotionPose {
    let mut pose = MotionPose { rotations, pelvis: Vector3::zeros() };
    let posed = skeleton.pose(&pose);
    let ankles = 0.5 * (posed.joints[joint("left_ankle")] + posed.joints[joint("right_ankle")]);
    let soles = SOLE
        .map(|(joint, [x, y, z])| Rule::At { joint, offset: Vector3::new(x, y, z) }.point(&posed, skeleton.scale).y);
    let lowest = soles.iter().copied().fold(f64::INFINITY, f64::min);
    let softened: f64 = soles.iter().map(|y| ((lowest - y) / SOLE_SOFTNESS).exp()).sum();
    pose.pelvis = Vector3::new(position.x - ankles.x, SOLE_SOFTNESS * softened.ln() - lowest, position.y - ankles.z);
    pose
}
