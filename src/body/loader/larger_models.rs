//! SMPL-H and SMPL-X read as SMPL's 24 joints: fingers move with the hand, jaw and eyes with the head.
//!
//! Both have SMPL's first 22 joints, from the pelvis to the wrists. SMPL-H (Romero et al., TOG 2017) continues with 15 finger
//! joints of the left and of the right hand; SMPL-X (Pavlakos et al., CVPR 2019) has jaw, left and right eye before them.
//!
//! | field | as of SMPL |
//! |---|---|
//! | `weights` | a finger's weights are added to those of the hand, those of jaw and eyes to the head's |
//! | `J_regressor` | the first 22 rows; a hand is the first joint of its middle finger |
//! | `posedirs` | the features of the first 22 joints; those of the hands are zero |
//! | `shapedirs` | the first ten components |

use super::assemble::shaped;
use super::error::BodyFileError;
use super::fields::{Fields, MAX_ELEMENTS, max_elements};
use crate::body::anthropometry::N_BETAS;
use crate::body::hand::{N_FINGER_JOINTS, Side, finger_parent};
use crate::body::skeleton::{N_JOINTS, PARENTS};
use crate::body::surface::N_POSE_FEATURES;
use crate::formats::npy::{Array, Limits};

/// Joints that all models of the family share: pelvis to wrists.
const N_SHARED: usize = 22;
/// SMPL's head, which carries jaw and eyes.
const HEAD: usize = 15;
/// First joint of the middle finger among those of a hand.
const MIDDLE: usize = 3;
/// Numbers of a joint's rotation in `posedirs`; the root has none.
const N_FEATURES: usize = 9;
/// Most numbers of `shapedirs` and `posedirs` in a file: SMPL-X has 10,475 vertices, 400 components and 486 features.
const MAX_READ: usize = 16_000_000;

/// A model with more joints than SMPL.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct LargerModel {
    pub(super) name: &'static str,
    pub(super) n_joints: usize,
    /// First joint of the left hand's fingers.
    first_finger: usize,
}

const MODELS: [LargerModel; 2] = [
    LargerModel { name: "SMPL-H", n_joints: 52, first_finger: 22 },
    LargerModel { name: "SMPL-X", n_joints: 55, first_finger: 25 },
];

impl LargerModel {
    /// The model whose skinning weights these are; `None` for SMPL and unknown models.
    pub(super) fn of_weights(weights: &Array) -> Option<Self> {
        MODELS.into_iter().find(|model| matches!(weights.shape[..], [_, n] if n == model.n_joints))
    }

    /// Number of entries of a field's last axis that are read, and its limits.
    pub(super) fn leading(field: &str) -> (usize, Limits) {
        let read = |n: usize| (n, Limits { read: MAX_READ, kept: MAX_ELEMENTS });
        match field {
            "shapedirs" => read(N_BETAS),
            "posedirs" => read(N_FEATURES * (N_SHARED - 1)),
            _ => (usize::MAX, Limits { read: max_elements(field), kept: max_elements(field) }),
        }
    }

    /// SMPL's joint that moves what a joint of this model moves.
    fn joint_of_smpl(self, joint: usize) -> usize {
        match joint.checked_sub(self.first_finger) {
            Some(finger) => N_SHARED + finger / N_FINGER_JOINTS,
            None if joint < N_SHARED => joint,
            None => HEAD,
        }
    }

    /// Parent of a joint.
    fn parent(self, joint: usize) -> Option<usize> {
        let Some(finger) = joint.checked_sub(self.first_finger) else {
            return if joint < N_SHARED { PARENTS[joint] } else { Some(HEAD) };
        };
        let side = Side::BOTH[finger / N_FINGER_JOINTS];
        let first = joint - finger % N_FINGER_JOINTS;
        Some(finger_parent(finger % N_FINGER_JOINTS).map_or(side.wrist(), |parent| first + parent))
    }

    /// The fields as those of a SMPL file. Missing ones stay missing.
    pub(super) fn folded(self, mut fields: Fields) -> Result<Fields, BodyFileError> {
        let mut fold = |field: &str, array: &dyn Fn(&Array) -> Result<Array, BodyFileError>| match fields.get_mut(field)
        {
            Some(own) => array(own).map(|folded| *own = folded),
            None => Ok(()),
        };
        fold("weights", &|own| Ok(self.weights(own)))?;
        fold("J_regressor", &|own| self.regressor(own))?;
        fold("kintree_table", &|own| self.tree(own))?;
        fold("posedirs", &pose_directions)?;
        Ok(fields)
    }

    fn weights(self, own: &Array) -> Array {
        let n_vertices = own.shape[0];
        let mut values = vec![0.0; n_vertices * N_JOINTS];
        for (row, folded) in own.values.chunks_exact(self.n_joints).zip(values.chunks_exact_mut(N_JOINTS)) {
            row.iter().enumerate().for_each(|(joint, weight)| folded[self.joint_of_smpl(joint)] += weight);
        }
        Array { shape: vec![n_vertices, N_JOINTS], values }
    }

    fn regressor(self, own: &Array) -> Result<Array, BodyFileError> {
        let fits = matches!(own.shape[..], [n, v] if n == self.n_joints && v > 0);
        shaped("J_regressor", own, "(joints of the weights, V)", fits)?;
        let hands = [0, 1].map(|hand| self.first_finger + hand * N_FINGER_JOINTS + MIDDLE);
        let rows = (0..N_SHARED).chain(hands);
        let n_vertices = own.shape[1];
        let values = rows.flat_map(|row| &own.values[row * n_vertices..(row + 1) * n_vertices]).copied().collect();
        Ok(Array { shape: vec![N_JOINTS, n_vertices], values })
    }

    fn tree(self, own: &Array) -> Result<Array, BodyFileError> {
        shaped("kintree_table", own, "(2, joints of the weights)", own.shape == [2, self.n_joints])?;
        for (row, found) in own.values[..self.n_joints].iter().enumerate().skip(1) {
            if self.parent(row).is_none_or(|parent| *found != parent as f64) {
                let rule = "the parents must be those of SMPL-H's 52 or SMPL-X's 55 joints";
                return Err(BodyFileError::Value { field: "kintree_table", row, rule });
            }
        }
        let parents = (0..N_JOINTS).map(|joint| PARENTS[joint].map_or(own.values[0], |parent| parent as f64));
        let values = parents.chain((0..N_JOINTS).map(|joint| joint as f64)).collect();
        Ok(Array { shape: vec![2, N_JOINTS], values })
    }
}

/// The features of the shared joints, zeros for the hands.
fn pose_directions(own: &Array) -> Result<Array, BodyFileError> {
    let n_own = N_FEATURES * (N_SHARED - 1);
    shaped("posedirs", own, "(V, 3, 459 or 486)", matches!(own.shape[..], [_, 3, n] if n == n_own))?;
    let mut values = Vec::with_capacity(own.shape[0] * 3 * N_POSE_FEATURES);
    for row in own.values.chunks_exact(n_own) {
        values.extend_from_slice(row);
        values.resize(values.len() + N_POSE_FEATURES - n_own, 0.0);
    }
    Ok(Array { shape: vec![own.shape[0], 3, N_POSE_FEATURES], values })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joints_fold_into_hands_and_head() {
        let [h, x] = MODELS;
        assert_eq!([21, 22, 36, 37, 51].map(|joint| h.joint_of_smpl(joint)), [21, 22, 22, 23, 23]);
        assert_eq!([21, 22, 24, 25, 39, 40, 54].map(|joint| x.joint_of_smpl(joint)), [21, 15, 15, 22, 22, 23, 23]);
        assert_eq!([22, 23, 25, 37, 51].map(|joint| h.parent(joint)), [20, 22, 20, 21, 50].map(Some));
        assert_eq!([22, 24, 25, 26, 40, 54].map(|joint| x.parent(joint)), [15, 15, 20, 25, 21, 53].map(Some));
        assert_eq!((h.parent(0), x.parent(15)), (None, Some(12)));
    }

    #[test]
    fn features_of_hands_are_zero() {
        let own = Array { shape: vec![2, 3, 189], values: (0..2 * 3 * 189).map(f64::from).collect() };
        let folded = pose_directions(&own).unwrap();
        assert_eq!(folded.shape, [2, 3, 207]);
        assert_eq!(
            (folded.values[188], folded.values[189], folded.values[206], folded.values[207]),
            (188.0, 0.0, 0.0, 189.0)
        );
    }
}
