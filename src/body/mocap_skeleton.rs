//! The zero pose of the mocap skeleton, and rotations retargeted from it to another body.
//!
//! All skeletons share the axes and the T-pose, but not the bones' directions in it: the thighs of the mocap skeleton lean
//! out by 6 degrees and its shanks in by 2, so that a straight leg has a knee rotation of 8. With `Q_j` the smallest
//! rotation from a body's bone to the mocap skeleton's, bones have the same direction under
//! `R_j^{body} = Q_{p(j)}^T R_j^{mocap} Q_j`.
//! In the trunk, joint positions differ between skeletons: there `Q_j` maps upright mocap poses to the body's zero pose.

use super::skeleton::{N_JOINTS, PARENTS};
use crate::geometry::rotation::{exp, rotation_between};
use nalgebra::{Matrix3, Vector3};

/// Left joints, the end joints of their bones, and the bones' directions at rest (x left, y up, z front): means over CMU's
/// takes, whose subjects differ by 0.02.
const BONES: [(usize, usize, [f64; 3]); 5] = [
    (1, 4, [0.103, -0.995, 0.013]),
    (4, 7, [-0.037, -0.996, -0.086]),
    (7, 10, [0.222, -0.406, 0.886]),
    (16, 18, [0.996, -0.038, -0.077]),
    (18, 20, [0.999, 0.032, -0.012]),
];

/// Forward bend of spine, neck and head of people who stand upright (knees within 25 degrees of straight, chest within 10
/// of the vertical; 2,300 frames), degrees.
const UPRIGHT_DEG: [(usize, f64); 5] = [(3, 3.4), (6, -0.8), (9, -2.7), (12, 0.4), (15, -1.8)];

/// `Q_j`, `mocap_from_body`, of every joint of a body with these joints at rest. A joint that is not in the table (toes,
/// hands, collars) has the rotation of its parent.
pub fn mocap_from_body(rest_joints: &[Vector3<f64>; N_JOINTS]) -> [Matrix3<f64>; N_JOINTS] {
    let mut turns = [Matrix3::identity(); N_JOINTS];
    for joint in 1..N_JOINTS {
        let parent = turns[PARENTS[joint].unwrap_or(0)];
        turns[joint] = if let Some((end, mocap)) = mocap_bone(joint) {
            rotation_between(&(rest_joints[end] - rest_joints[joint]), &mocap)
        } else if let Some((_, bend)) = UPRIGHT_DEG.iter().find(|(j, _)| *j == joint) {
            exp(&Vector3::new(-bend.to_radians(), 0.0, 0.0)) * parent
        } else {
            parent
        };
    }
    turns
}

/// The local rotation of `joint` on the body, given that on the mocap skeleton.
pub fn retargeted(turn: &Matrix3<f64>, joint: usize, mocap_from_body: &[Matrix3<f64>; N_JOINTS]) -> Matrix3<f64> {
    let parent = PARENTS[joint].map_or_else(Matrix3::identity, |parent| mocap_from_body[parent]);
    parent.transpose() * turn * mocap_from_body[joint]
}

/// The end joint and direction of a joint's bone, if it is one of [`BONES`] or its mirror image: in SMPL's order the right
/// joint follows the left one.
fn mocap_bone(joint: usize) -> Option<(usize, Vector3<f64>)> {
    let of_side = |right: usize| {
        let bone = BONES.iter().find(|(left, ..)| left + right == joint);
        bone.map(|&(_, end, [x, y, z])| (end + right, Vector3::new(if right == 1 { -x } else { x }, y, z)))
    };
    of_side(0).or_else(|| of_side(1))
}

#[cfg(test)]
mod tests {
    use super::super::default_body;
    use super::*;

    /// A straight leg of the mocap skeleton, whose knee is turned by 8 degrees, is a straight leg of the default body.
    #[test]
    fn straight_legs_are_straight_in_every_skeleton() {
        let body = default_body();
        let turns = mocap_from_body(&body.rest_joints);
        for [hip, knee, ankle] in [[1, 4, 7], [2, 5, 8]] {
            let [(_, thigh), (_, shank)] = [hip, knee].map(|joint| mocap_bone(joint).unwrap());
            let straight = retargeted(&rotation_between(&shank, &thigh), knee, &turns);
            let bone = |end: usize, joint: usize| (body.rest_joints[end] - body.rest_joints[joint]).normalize();
            assert!((straight * bone(ankle, knee) - bone(knee, hip)).norm() < 0.01);
        }
    }

    /// Upright mocap poses become the zero pose of the body's trunk, and both sides are symmetric.
    #[test]
    fn upright_mocap_poses_are_the_zero_of_the_trunk() {
        let turns = mocap_from_body(&default_body().rest_joints);
        for (joint, bend) in UPRIGHT_DEG {
            let upright = exp(&Vector3::new(bend.to_radians(), 0.0, 0.0));
            assert!((retargeted(&upright, joint, &turns) - Matrix3::identity()).norm() < 1e-12, "{joint}");
        }
        let mirror = Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, 1.0));
        for left in [1, 4, 7, 10, 13, 16, 18, 20] {
            assert!((mirror * turns[left] * mirror - turns[left + 1]).norm() < 1e-9, "{left}");
        }
    }
}
