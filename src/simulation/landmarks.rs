//! True keypoints of a posed skeleton: one rule a keypoint, for every convention.

use super::config::SimulationConfig;
use super::error::SimulationError;
use super::individual::as_detected;
use super::skeleton::{SimulatedPerson, joint};
use crate::body::kinematics::{PosedSkeleton, landmark_position};
use crate::body::model::{BodyModel, ShapedBody};
use crate::body::skeleton::{JOINT_NAMES, KeypointConvention};
use nalgebra::Vector3;

/// Position of a keypoint on the body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Rule {
    /// At an offset (m, for the generic adult) in the frame of a joint.
    At {
        /// The joint.
        joint: usize,
        /// In the joint's frame: x left, y up, z forward in the zero pose.
        offset: Vector3<f64>,
    },
    /// Half way between two joints.
    Between(usize, usize),
}

/// Points on the head in the head's frame, m; the left one of each pair.
const HEAD: [(&str, [f64; 3]); 7] = [
    ("nose", [0.0, 0.045, 0.115]),
    ("eye", [0.033, 0.080, 0.095]),
    ("eye_inner", [0.018, 0.080, 0.100]),
    ("eye_outer", [0.048, 0.080, 0.085]),
    ("ear", [0.075, 0.055, 0.010]),
    ("mouth", [0.024, 0.005, 0.098]),
    ("head_top", [0.0, 0.170, 0.015]),
];

/// Points on feet and hands: name, joint, offset on the left side, m.
const EXTREMITIES: [(&str, &str, [f64; 3]); 6] = [
    ("big_toe", "foot", [-0.020, -0.015, 0.070]),
    ("small_toe", "foot", [0.045, -0.015, 0.040]),
    ("heel", "ankle", [0.0, -0.060, -0.050]),
    ("pinky", "hand", [0.005, -0.004, -0.030]),
    ("index", "hand", [0.012, 0.0, 0.026]),
    ("thumb", "hand", [-0.030, -0.008, 0.045]),
];

/// The rules of a convention's named keypoints, in its order.
///
/// # Errors
/// [`SimulationError::UnknownKeypoint`] where a keypoint has no rule.
pub fn rules(convention: KeypointConvention) -> Result<Vec<Rule>, SimulationError> {
    let rule = |name: &&'static str| match convention {
        KeypointConvention::Smpl24 => named_joint(name),
        _ => detector_point(name),
    };
    convention
        .names()
        .iter()
        .map(|keypoint| rule(keypoint).ok_or(SimulationError::UnknownKeypoint { convention, keypoint }))
        .collect()
}

impl Rule {
    /// The point in the world, m; `scale` is the person's size relative to the generic adult.
    pub fn point(&self, posed: &PosedSkeleton, scale: f64) -> Vector3<f64> {
        match *self {
            Self::At { joint, offset } => posed.joints[joint] + posed.rotations[joint] * offset * scale,
            Self::Between(a, b) => 0.5 * (posed.joints[a] + posed.joints[b]),
        }
    }
}

/// The true keypoints of one person.
#[derive(Debug, Clone)]
pub enum Detectable {
    /// Points by rule, on a person of the given size relative to the generic adult.
    Rules(Vec<Rule>, f64),
    /// Landmarks (by index) of the default body in a shape.
    Body(Box<(BodyModel, ShapedBody)>, Vec<usize>),
}

impl Detectable {
    /// The points that the session's detector reports for its named keypoints on a person.
    ///
    /// # Errors
    /// [`SimulationError::UnknownKeypoint`] where the body has no such point.
    pub fn new(person: &SimulatedPerson, config: &SimulationConfig) -> Result<Self, SimulationError> {
        let convention = config.convention;
        let Some((betas, body)) = person.betas.zip(person.model()) else {
            return Ok(Self::Rules(rules(convention)?, person.skeleton.scale));
        };
        let body = as_detected(body, config);
        let body = config.dense.as_ref().map_or_else(|| body.clone(), |dense| dense.on(&body));
        let landmarks = body.landmarks_of(convention).into_iter().zip(convention.names());
        let known = |(landmark, keypoint): (Option<usize>, &&'static str)| {
            landmark.ok_or(SimulationError::UnknownKeypoint { convention, keypoint })
        };
        let mut landmarks = landmarks.map(known).collect::<Result<Vec<_>, _>>()?;
        landmarks.extend(config.dense.iter().flat_map(|dense| dense.places(&body)).flatten());
        let shaped = body.shaped(&betas);
        Ok(Self::Body(Box::new((body, shaped)), landmarks))
    }

    /// The points in the world, m.
    pub fn points(&self, posed: &PosedSkeleton) -> Vec<Vector3<f64>> {
        match self {
            Self::Rules(rules, scale) => rules.iter().map(|rule| rule.point(posed, *scale)).collect(),
            Self::Body(body, landmarks) => {
                landmarks.iter().map(|landmark| landmark_position(&body.0, &body.1, posed, *landmark)).collect()
            }
        }
    }
}

fn named_joint(name: &str) -> Option<Rule> {
    let joint = JOINT_NAMES.iter().position(|n| *n == name)?;
    Some(Rule::At { joint, offset: Vector3::zeros() })
}

fn detector_point(name: &str) -> Option<Rule> {
    let (side, part) = match name.split_once('_') {
        Some(("left", part)) => ("left", part),
        Some(("right", part)) => ("right", part),
        _ => ("", name),
    };
    let mirrored = |[x, y, z]: [f64; 3]| Vector3::new(if side == "right" { -x } else { x }, y, z);
    match part {
        "neck" => return Some(Rule::Between(joint("left_shoulder"), joint("right_shoulder"))),
        "mid_hip" => return Some(Rule::Between(joint("left_hip"), joint("right_hip"))),
        "shoulder" | "elbow" | "wrist" | "hip" | "knee" | "ankle" => return named_joint(name),
        _ => {}
    }
    if let Some((_, offset)) = HEAD.iter().find(|(n, _)| *n == part) {
        return Some(Rule::At { joint: joint("head"), offset: mirrored(*offset) });
    }
    let (_, base, offset) = EXTREMITIES.iter().find(|(n, _, _)| *n == part)?;
    let joint =
        JOINT_NAMES.iter().position(|n| n.strip_prefix(side).and_then(|n| n.strip_prefix('_')) == Some(base))?;
    Some(Rule::At { joint, offset: mirrored(*offset) })
}
