//! The simulated body: 24 joints in SMPL's order, generic adult proportions, individual variation.
//!
//! It is deliberately not the body model of the fit: a simulation can only judge methods that do not share its
//! assumptions. Proportions are rounded figures near de Leva's joint centres (J. Biomech. 29, 1996), stature 1.72 m.

use super::config::{Bodies, SimulationConfig};
use super::individual::joint_shifts;
use super::random::{Purpose, normal, stream};
use crate::body::kinematics::PosedSkeleton;
use crate::body::skeleton::{JOINT_NAMES, N_JOINTS, PARENTS};
use crate::body::{Betas, BodyModel, default_body};
use crate::motion_prior::motion_file::MotionPose;
use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;

/// Joint offsets of one simulated person.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedSkeleton {
    /// From the parent to the joint in the zero pose (a T facing +z, left = +x, y up), m; entry 0 is zero.
    pub offsets: [Vector3<f64>; N_JOINTS],
    /// Size relative to the generic adult; scales head, hands and feet, which have no joints of their own.
    pub scale: f64,
}

/// One simulated person and their motion.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedPerson {
    /// The skeleton.
    pub skeleton: SimulatedSkeleton,
    /// Shape, if the body is the default body.
    pub betas: Option<Betas>,
    /// Differences of the rest joints from those of the default body at this shape, m.
    pub joint_shifts: [Vector3<f64>; N_JOINTS],
    /// Poses by frame.
    pub poses: Vec<MotionPose>,
    /// Name of the motion's source.
    pub source: String,
}

/// Index of a joint by its name in [`JOINT_NAMES`]; in a constant an unknown name is a compile error.
pub(super) const fn joint(name: &str) -> usize {
    let mut index = 0;
    while index < N_JOINTS {
        if same(JOINT_NAMES[index].as_bytes(), name.as_bytes()) {
            return index;
        }
        index += 1;
    }
    panic!("no such joint")
}

/// String comparison for constants.
const fn same(a: &[u8], b: &[u8]) -> bool {
    let mut i = 0;
    while i < a.len() && i < b.len() && a[i] == b[i] {
        i += 1;
    }
    i == a.len() && i == b.len()
}

/// Left and middle offsets of the generic adult, m; the right side is the mirror image.
const GENERIC: [(usize, [f64; 3]); 14] = [
    (joint("left_hip"), [0.080, -0.088, -0.004]),
    (joint("left_knee"), [0.028, -0.391, 0.004]),
    (joint("left_ankle"), [-0.012, -0.409, -0.030]),
    (joint("left_foot"), [0.028, -0.056, 0.125]),
    (joint("spine1"), [0.0, 0.110, -0.022]),
    (joint("spine2"), [0.0, 0.135, 0.004]),
    (joint("spine3"), [0.0, 0.055, 0.020]),
    (joint("neck"), [0.0, 0.205, -0.035]),
    (joint("left_collar"), [0.075, 0.112, -0.026]),
    (joint("head"), [0.0, 0.088, 0.045]),
    (joint("left_shoulder"), [0.103, 0.035, -0.014]),
    (joint("left_elbow"), [0.272, -0.008, -0.018]),
    (joint("left_wrist"), [0.255, 0.006, -0.002]),
    (joint("left_hand"), [0.084, -0.009, -0.008]),
];

/// Joints whose offsets vary together from person to person.
const LIMBS: [&[&str]; 7] = [
    &["left_hip", "right_hip"],
    &["left_knee", "right_knee"],
    &["left_ankle", "right_ankle"],
    &["spine1", "spine2", "spine3", "neck"],
    &["left_collar", "right_collar", "left_shoulder", "right_shoulder"],
    &["left_elbow", "right_elbow"],
    &["left_wrist", "right_wrist"],
];

/// Standard deviation of adult stature: 0.06 of the mean with men and women pooled (ANSUR II, 2012: 5.3 %).
const STATURE_SD: f64 = 0.06;
/// Standard deviation of a segment's length at given stature.
const LIMB_SD: f64 = 0.04;
/// Largest deviation of drawn people, standard deviations.
const MAX_DEVIATIONS: f64 = 2.5;

impl SimulatedPerson {
    /// A random person without motion: a random adult skeleton, or the default body at betas from N(0, 1).
    pub(super) fn still(config: &SimulationConfig, person: usize, source: &str) -> Self {
        let rng = &mut stream(config.seed, Purpose::Body, 0, person);
        let still = Self::of_skeleton(SimulatedSkeleton::generic(), source.to_owned());
        if config.bodies == Bodies::Own {
            return Self { skeleton: SimulatedSkeleton::random(rng), ..still };
        }
        let betas = Betas::from_fn(|_, _| normal(rng, 1.0));
        let still = Self { betas: Some(betas), joint_shifts: joint_shifts(config, person), ..still };
        let skeleton = still.model().map(|body| SimulatedSkeleton::from_rest_joints(&body.shaped(&betas).rest_joints));
        Self { skeleton: skeleton.unwrap_or(still.skeleton), ..still }
    }

    /// A person without motion and shape, given the skeleton.
    pub(super) fn of_skeleton(skeleton: SimulatedSkeleton, source: String) -> Self {
        Self { skeleton, betas: None, joint_shifts: [Vector3::zeros(); N_JOINTS], poses: Vec::new(), source }
    }

    /// The person's exact body model, if it is the default body or an individual variant of it.
    pub fn model(&self) -> Option<BodyModel> {
        self.betas.map(|_| default_body().with_joints_moved(&self.joint_shifts))
    }
}

impl SimulatedSkeleton {
    /// The generic adult.
    pub fn generic() -> Self {
        let mut offsets = [Vector3::zeros(); N_JOINTS];
        for (index, [x, y, z]) in GENERIC {
            offsets[index] = Vector3::new(x, y, z);
            if let Some(side) = JOINT_NAMES[index].strip_prefix("left_")
                && let Some(twin) = JOINT_NAMES.iter().position(|name| name.strip_prefix("right_") == Some(side))
            {
                offsets[twin] = Vector3::new(-x, y, z);
            }
        }
        Self { offsets, scale: 1.0 }
    }

    /// An adult of random stature (sd 6 %) and random limb lengths (sd 4 % each).
    pub(super) fn random(rng: &mut ChaCha8Rng) -> Self {
        let mut factor = |sd: f64| 1.0 + normal(rng, sd).clamp(-MAX_DEVIATIONS * sd, MAX_DEVIATIONS * sd);
        let mut skeleton = Self::generic();
        skeleton.scale = factor(STATURE_SD);
        let scale = skeleton.scale;
        skeleton.offsets.iter_mut().for_each(|offset| *offset *= scale);
        for limb in LIMBS {
            let length = factor(LIMB_SD);
            limb.iter().for_each(|name| skeleton.offsets[joint(name)] *= length);
        }
        skeleton
    }

    /// A skeleton from its joints in the zero pose, m.
    pub fn from_rest_joints(rest: &[Vector3<f64>; N_JOINTS]) -> Self {
        let offsets = std::array::from_fn(|j| PARENTS[j].map_or_else(Vector3::zeros, |p| rest[j] - rest[p]));
        let length = |offsets: &[Vector3<f64>; N_JOINTS]| offsets.iter().map(Vector3::norm).sum::<f64>();
        Self { offsets, scale: length(&offsets) / length(&Self::generic().offsets) }
    }

    /// Forward kinematics: `g_j = g_parent R_j`, `x_j = x_parent + g_parent o_j`.
    pub fn pose(&self, pose: &MotionPose) -> PosedSkeleton {
        let mut posed = PosedSkeleton { rotations: [pose.rotations[0]; N_JOINTS], joints: [pose.pelvis; N_JOINTS] };
        for j in 1..N_JOINTS {
            let parent = PARENTS[j].unwrap_or(0);
            posed.joints[j] = posed.joints[parent] + posed.rotations[parent] * self.offsets[j];
            posed.rotations[j] = posed.rotations[parent] * pose.rotations[j];
        }
        posed
    }
}
