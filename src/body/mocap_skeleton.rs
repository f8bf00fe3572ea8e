//! Where the captured skeletons have their zero, and what that means for another body's turns.
//!
//! All skeletons share axes and the T-pose, but not where in it a bone points: the thighs of the captured ones lean out by 6
//! degrees and their shanks in by 2, so that a straight leg has a knee turned by 8. With `Q_j` the least rotation from a
//! body's bone to the captured one, bones point alike under
//! `R_j^{body} = Q_{p(j)}^T R_j^{captured} Q_j`.
//! In the trunk, where joints lie is the skeleton's own: there `Q_j` is such that the captured upright is the body's zero.

use super::skeleton::{N_JOINTS, PARENTS};
use crate::geometry::rotation::{exp, rotation_between};
use nalgebra::{Matrix3, Vector3};

/// Left joints, the ends of the bones that they carry, and the bones' directions at rest (x left, y up, z front): means over
/// CMU's takes, whose subjects differ by 0.02.
const BONES: [(usize, usize, [f64; 3]); 5] = [
    (1, 4, [0.103, -0.995, 0.013]),
    (4, 7, [-0.037, -0.996, -0.086]),
    (7, 10, [0.222, -0.406, 0.886]),
    (16, 18, [0.996, -0.038, -0.077]),
    (18, 20, [0.999, 0.032, -0.012]),
];

/// How far spine, neck and head are bent forward where people stand upright (knees within 25 degrees of straight, chest
/// within 10 of the vertical; 2,300 frames), degrees.
const UPRIGHT_DEG: [(usize, f64); 5] = [(3, 3.4), (6, -0.8), (9, -2.7), (12, 0.4), (15, -1.8)];

/// `Q_j`, `mocap_from_body`, of every joint of a body with these joints at rest. A joint without a bone of its own
/// (toes, hands, collars) follows the one before it.
pub fn mocap_from_body(rest_joints: &[Vector3<f64>; N_JOINTS]) -> [Matrix3<f64>; N_JOINTS] {
    let mut turns = [Matrix3::identity(); N_JOINTS];
    for joint in 1..N_JOINTS {
        let before = turns[PARENTS[joint].unwrap_or(0)];
        turns[joint] = if let Some((end, captured)) = captured_bone(joint) {
            rotation_between(&(rest_joints[end] - rest_joints[joint]), &captured)
        } else if let Some((_, bend)) = UPRIGHT_DEG.iter().find(|(j, _)| *j == joint) {
            exp(&Vector3::new(-bend.to_radians(), 0.0, 0.0)) * before
        } else {
            before
        };
    }
    turns
}

/// A captured turn of `joint` as the body has it.
pub fn retargeted(turn: &Matrix3<f64>, joint: usize, mocap_from_body: &[Matrix3<f64>; N_JOINTS]) -> Matrix3<f64> {
    let before = PARENTS[joint].map_or_else(Matrix3::identity, |parent| mocap_from_body[parent]);
    before.transpose() * turn * mocap_from_body[joint]
}

/// The end and direction of the bone that a joint carries, if it is one of [`BONES`] or its mirror image: in SMPL's order the
/// right joint stands next to the left one.
fn captured_bone(joint: usize) -> Option<(usize, Vector3<f64>)> {
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

    /// A straight leg of the captured skeletons, whose knee is turned by 8 degrees, is a straight leg of the default body.
    #[test]
    fn straight_legs_are_straight_in_every_skeleton() {
        let body = default_body();
        let turns = mocap_from_body(&body.rest_joints);
        for [hip, knee, ankle] in [[1, 4, 7], [2, 5, 8]] {
            let [(_, thigh), (_, shank)] = [hip, knee].map(|joint| captured_bone(joint).unwrap());
            let straight = retargeted(&rotation_between(&shank, &thigh), knee, &turns);
            let bone = |end: usize, joint: usize| (body.rest_joints[end] - body.rest_joints[joint]).normalize();
            assert!((straight * bone(ankle, knee) - bone(knee, hip)).norm() < 0.01);
        }
    }

    /// Who stands upright there does so here without bending any joint of the trunk, and both sides are alike.
    #[test]
    fn the_captured_upright_is_the_zero_of_the_trunk() {
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
