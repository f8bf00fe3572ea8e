//! Initial capsules, defined by joints.

use super::body_capsules::N_CAPSULES;
use crate::body::model::{BodyModel, ShapeDirections};
use crate::body::skeleton::JOINT_NAMES;
use nalgebra::Vector3;

/// A capsule before the fit, in the rest pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct RoughCapsule {
    /// The joint it is fixed to.
    pub joint: usize,
    /// Both ends at beta 0, m.
    pub ends: [Vector3<f64>; 2],
    /// Change of the ends per beta, m.
    pub directions: [ShapeDirections; 2],
    /// Radius at both ends, m.
    pub radius: f64,
}

/// A point: two joints, the share of the way from the first to the second, and an offset (m).
type Anchor = (&'static str, &'static str, f64, [f64; 3]);

/// Joint, both ends, radius (m); for the left side or the midline.
type Line = (&'static str, [Anchor; 2], f64);

const PAIRED: [Line; 9] = [
    ("pelvis", [("pelvis", "pelvis", 0.0, [0.045, -0.08, 0.0]), ("pelvis", "spine1", 1.0, [0.045, 0.0, 0.0])], 0.12),
    ("spine3", [("spine2", "spine2", 0.0, [0.045, 0.0, 0.0]), ("spine3", "neck", 0.8, [0.045, 0.0, 0.0])], 0.12),
    ("left_collar", bone("left_collar", "left_shoulder", 0.3, 1.0), 0.07),
    ("left_shoulder", bone("left_shoulder", "left_elbow", 0.0, 1.0), 0.05),
    ("left_elbow", bone("left_elbow", "left_wrist", 0.0, 1.0), 0.05),
    ("left_wrist", bone("left_wrist", "left_hand", 0.0, 1.6), 0.03),
    ("left_hip", bone("left_hip", "left_knee", 0.0, 1.0), 0.05),
    ("left_knee", bone("left_knee", "left_ankle", 0.0, 1.0), 0.05),
    ("left_ankle", bone("left_ankle", "left_foot", 0.0, 1.2), 0.03),
];

const MIDDLE: [Line; 3] = [
    ("spine1", [("spine1", "spine1", 0.0, [0.045, 0.03, 0.0]), ("spine1", "spine1", 0.0, [-0.045, 0.03, 0.0])], 0.12),
    ("neck", bone("neck", "head", 0.0, 1.0), 0.06),
    ("head", [("head", "head", 0.0, [0.0; 3]), ("head", "head", 0.0, [0.0, 0.08, 0.0])], 0.08),
];

const fn bone(from: &'static str, to: &'static str, first: f64, second: f64) -> [Anchor; 2] {
    [(from, to, first, [0.0; 3]), (from, to, second, [0.0; 3])]
}

/// The initial capsules: midline, left, right.
pub(super) fn rough_capsules(model: &BodyModel) -> [RoughCapsule; N_CAPSULES] {
    std::array::from_fn(|k| match k.checked_sub(MIDDLE.len()) {
        None => rough(model, &MIDDLE[k], Side::Left),
        Some(k) if k < PAIRED.len() => rough(model, &PAIRED[k], Side::Left),
        Some(k) => rough(model, &PAIRED[k - PAIRED.len()], Side::Right),
    })
}

#[derive(Clone, Copy)]
enum Side {
    Left,
    Right,
}

fn rough(model: &BodyModel, (joint_name, anchors, radius): &Line, side: Side) -> RoughCapsule {
    let joint = |name: &str| {
        let of_side = match side {
            Side::Left => name.to_owned(),
            Side::Right => name.replacen("left_", "right_", 1),
        };
        JOINT_NAMES.iter().position(|known| *known == of_side).expect("the tables name joints")
    };
    let lateral = match side {
        Side::Left => 1.0,
        Side::Right => -1.0,
    };
    let end = |(from, to, share, [x, y, z]): &Anchor| {
        model.rest_joints[joint(from)].lerp(&model.rest_joints[joint(to)], *share) + Vector3::new(lateral * x, *y, *z)
    };
    let directions = |(from, to, share, _): &Anchor| {
        model.shape_directions[joint(from)] * (1.0 - share) + model.shape_directions[joint(to)] * *share
    };
    RoughCapsule {
        joint: joint(joint_name),
        ends: anchors.each_ref().map(end),
        directions: anchors.each_ref().map(directions),
        radius: *radius,
    }
}
