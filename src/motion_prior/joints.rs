//! Joints of a skeleton from local rotations, for training and evaluation.
//!
//! The root is ignored: the pelvis is at the origin with rotation identity. Collars and hands are at identity.

use super::chart::{Chart, Features, LocalRotations, N_FEATURES};
use crate::body::skeleton::{N_JOINTS, PARENTS};
use crate::body::{Betas, default_body};
use nalgebra::{Matrix3, Vector3};

/// Joint positions of one frame, m, pelvis at the origin.
pub type JointPositions = [Vector3<f64>; N_JOINTS];

/// Offsets from the parent joints of the default body at its mean shape, m.
#[derive(Debug, Clone, PartialEq)]
pub struct Bones([Vector3<f64>; N_JOINTS]);

/// By joint, the end of its bone. The bone from their parent is parallel at rest to those of the last joints of a limb and the head.
const BONE_ENDS: [usize; N_JOINTS] =
    [3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 10, 11, 15, 16, 17, 15, 18, 19, 20, 21, 22, 23, 22, 23];

/// A posed skeleton.
pub struct Posed {
    /// Joints, m.
    pub joints: JointPositions,
    /// `pelvis_from_joint`.
    pub rotations: [Matrix3<f64>; N_JOINTS],
}

impl Bones {
    /// The bones of the default body.
    pub fn of_default_body() -> Self {
        Self::of_rest_joints(&default_body().shaped(&Betas::zeros()).rest_joints)
    }

    /// The bones between joints of a zero pose, m.
    pub fn of_rest_joints(rest: &JointPositions) -> Self {
        Self(std::array::from_fn(|j| PARENTS[j].map_or_else(Vector3::zeros, |p| rest[j] - rest[p])))
    }

    /// The direction of a joint's bone in its own frame: along the trunk or to its child; for the last joints of a limb and the head that
    /// from their parent.
    pub fn axis(&self, joint: usize) -> Vector3<f64> {
        self.0[BONE_ENDS[joint]].normalize()
    }

    /// Forward kinematics (docs/method.md) from local rotations without the root.
    pub fn posed(&self, local: &LocalRotations) -> Posed {
        let mut turned = *local;
        turned[0] = Matrix3::identity();
        let rotations = orientations(&turned);
        let mut joints = [Vector3::zeros(); N_JOINTS];
        for (j, parent) in PARENTS.iter().enumerate() {
            if let Some(p) = *parent {
                joints[j] = joints[p] + rotations[p] * self.0[j];
            }
        }
        Posed { joints, rotations }
    }

    /// Joints from features, m.
    pub fn joints(&self, chart: &Chart, features: &Features) -> JointPositions {
        self.posed(&chart.rotations(features)).joints
    }
}

/// Rotations from the frame that the root is given in, of every joint: `G_0 = R_0`, `G_j = G_par R_j`.
pub(crate) fn orientations(local: &LocalRotations) -> LocalRotations {
    let mut found = *local;
    for (j, parent) in PARENTS.iter().enumerate() {
        if let Some(p) = *parent {
            found[j] = found[p] * local[j];
        }
    }
    found
}

/// Single precision rows of features as double precision frames.
pub(crate) fn frame(row: &[f32]) -> Features {
    std::array::from_fn(|i| f64::from(row[i]))
}

/// Features of frames in single precision, one after the other.
pub(crate) fn rows(features: &[Features]) -> Vec<f32> {
    let mut rows = Vec::with_capacity(features.len() * N_FEATURES);
    features.iter().for_each(|f| rows.extend(f.iter().map(|v| *v as f32)));
    rows
}
