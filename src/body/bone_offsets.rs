//! Corrections of one person's bones beyond what the body model's shape directions can express.
//!
//! $J_j - J_{par(j)} = S\text{-bone}(\beta) + d_j$; all joints below the bone move with it. Left and right have their own: arms and
//! legs of people differ by 1 to 2 % between the sides, skeletons of motion capture and what a detector takes for a joint by up to
//! 5 %, and where both sides are held alike the longer limb is taken for the nearer one, which bends focal lengths by some percent.
//! A nuisance parameter: it keeps a person's proportions from being mistaken for the detector's keypoint bias or for the cameras,
//! and does not enter any result.

use super::model::{BodyModel, Landmark};
use super::skeleton::{N_JOINTS, PARENTS, chain_to_root};
use nalgebra::{Matrix3, Vector3};

/// Corrected bones by the joints at their lower ends: hips, thighs, shanks, spine, neck, shoulders, upper arms, forearms.
const BONES: [usize; 14] = [1, 2, 4, 5, 7, 8, 6, 12, 16, 17, 18, 19, 20, 21];

/// Number of corrected bones.
pub const N_BONES: usize = BONES.len();

/// Corrections by bone, in the rest pose, m.
pub type BoneOffsets = [Vector3<f64>; N_BONES];

/// The corrected bone that ends at `joint`.
fn bone_at(joint: usize) -> Option<usize> {
    BONES.iter().position(|&end| end == joint)
}

/// The model with one person's bone corrections.
pub fn with_bones(model: &BodyModel, offsets: &BoneOffsets) -> BodyModel {
    let mut own = model.clone();
    let mut shift = [Vector3::zeros(); N_JOINTS];
    for (joint, parent) in PARENTS.iter().enumerate() {
        let inherited = parent.map_or_else(Vector3::zeros, |p| shift[p]);
        shift[joint] = inherited + bone_at(joint).map_or_else(Vector3::zeros, |bone| offsets[bone]);
        own.rest_joints[joint] += shift[joint];
    }
    own
}

/// Derivatives of a landmark to the corrections that move it: bone and 3 x 3 block; a bone may occur more than once.
///
/// `rotations`: `world_from_joint` of the posed skeleton.
pub fn landmark_by_bones<'a>(
    landmark: &'a Landmark,
    rotations: &'a [Matrix3<f64>; N_JOINTS],
) -> impl Iterator<Item = (usize, Matrix3<f64>)> + 'a {
    let shown = landmark.terms.iter().filter(|term| term.weight != 0.0);
    shown.flat_map(move |term| {
        joint_by_bones(term.joint, rotations).map(move |(bone, block)| (bone, block * term.weight))
    })
}

/// The same of a joint.
pub fn joint_by_bones(
    joint: usize,
    rotations: &[Matrix3<f64>; N_JOINTS],
) -> impl Iterator<Item = (usize, Matrix3<f64>)> + '_ {
    chain_to_root(joint).filter_map(move |end| Some((bone_at(end)?, rotations[PARENTS[end]?])))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::default_body::default_body;

    #[test]
    fn a_longer_left_forearm_leaves_the_right_one() {
        let model = default_body();
        let [elbow, wrist, hand, right_wrist] = [18, 20, 22, 21];
        let forearm = bone_at(wrist).unwrap();
        let longer = Vector3::new(0.013, 0.0, 0.0);
        let mut offsets = BoneOffsets::default();
        offsets[forearm] = longer;
        let own = with_bones(&model, &offsets);
        for joint in 0..N_JOINTS {
            let moved = own.rest_joints[joint] - model.rest_joints[joint];
            let expected = if [wrist, hand].contains(&joint) { longer } else { Vector3::zeros() };
            assert!((moved - expected).norm() < 1e-15, "joint {joint}: {moved:?}");
        }
        let is_moved = |joint| joint_by_bones(joint, &[Matrix3::identity(); N_JOINTS]).any(|(bone, _)| bone == forearm);
        assert_eq!([elbow, wrist, hand, right_wrist].map(is_moved), [false, true, true, false]);
    }
}
