//! Corrections of one person's bones beyond what the body model's shape directions can express: one a kind of bone.
//!
//! $J_j - J_{par(j)} = S\text{-bone}(\beta) + M d$, mirrored between left and right; all joints below the bone move
//! with it. A nuisance parameter: it keeps a person's proportions from being mistaken for the detector's keypoint bias, and
//! does not enter any result.

use super::model::{BodyModel, Landmark};
use super::skeleton::{N_JOINTS, PARENTS, chain_to_root};
use nalgebra::{Matrix3, Vector3};

/// Corrected bones by the joints at their lower ends, left and right.
const BONES: [[usize; 2]; 8] = [[1, 2], [4, 5], [7, 8], [6, 6], [12, 12], [16, 17], [18, 19], [20, 21]];

/// Number of corrected kinds of bones: hips, thighs, shanks, spine, neck, shoulders, upper arms, forearms.
pub const N_BONE_KINDS: usize = BONES.len();

/// Corrections by kind, m, as on the left side.
pub type BoneOffsets = [Vector3<f64>; N_BONE_KINDS];

/// The kind of the bone that ends at `joint`, and `bone_from_offset`.
fn kind_of(joint: usize) -> Option<(usize, Matrix3<f64>)> {
    let kind = BONES.iter().position(|pair| pair.contains(&joint))?;
    let [left, right] = BONES[kind];
    let lateral = match joint {
        _ if left == right => 0.0,
        _ if joint == right => -1.0,
        _ => 1.0,
    };
    Some((kind, Matrix3::from_diagonal(&Vector3::new(lateral, 1.0, 1.0))))
}

/// The model with one person's bone corrections.
pub fn with_bones(model: &BodyModel, offsets: &BoneOffsets) -> BodyModel {
    let mut own = model.clone();
    let mut shift = [Vector3::zeros(); N_JOINTS];
    for (joint, parent) in PARENTS.iter().enumerate() {
        let inherited = parent.map_or_else(Vector3::zeros, |p| shift[p]);
        shift[joint] = inherited + kind_of(joint).map_or_else(Vector3::zeros, |(kind, mirror)| mirror * offsets[kind]);
        own.rest_joints[joint] += shift[joint];
    }
    own
}

/// Derivatives of a landmark to the corrections that move it: kind and 3 x 3 block; a kind may occur more than once.
///
/// `rotations`: `world_from_joint` of the posed skeleton.
pub fn landmark_by_bones<'a>(
    landmark: &'a Landmark,
    rotations: &'a [Matrix3<f64>; N_JOINTS],
) -> impl Iterator<Item = (usize, Matrix3<f64>)> + 'a {
    let shown = landmark.terms.iter().filter(|term| term.weight != 0.0);
    shown.flat_map(move |term| {
        joint_by_bones(term.joint, rotations).map(move |(kind, block)| (kind, block * term.weight))
    })
}

/// The same of a joint.
pub fn joint_by_bones(
    joint: usize,
    rotations: &[Matrix3<f64>; N_JOINTS],
) -> impl Iterator<Item = (usize, Matrix3<f64>)> + '_ {
    chain_to_root(joint).filter_map(move |bone| {
        let (kind, mirror) = kind_of(bone)?;
        Some((kind, rotations[PARENTS[bone]?] * mirror))
    })
}
