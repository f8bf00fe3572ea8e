//! The skeleton of a person as programs for animation expect it: rest joints, and joint axes along the bones.
//!
//! SMPL's joint axes are parallel to the world in the rest pose. Programs draw a bone along its joint's y axis, so that such a
//! skeleton falls apart into parallel sticks. Here y points in the rest pose from a joint to the next one and z as near to
//! the body's front as that allows: the next joint is at the bone's tail.
//!
//! `world_from_bone = G_j Q_j` with SMPL's `G_j` ([`crate::body::kinematics`]) and the rest axes `Q_j = body_from_bone`;
//! local rotations are `Q_parent^T R_j Q_j`.

use crate::body::hand::{N_FINGER_JOINTS, Side, finger_joint_name, finger_parent};
use crate::body::skeleton::{JOINT_NAMES, N_JOINTS, PARENTS, chain_to_root};
use crate::geometry::rotation::any_perpendicular;
use crate::session::BodyMotion;
use crate::session::people::HandMotion;
use nalgebra::{Matrix3, Vector3};

/// The skeleton of one person in the rest pose: y up, facing +z, metres. SMPL's joints come first; where hands were fitted, the
/// 15 finger joints of the left hand follow, then those of the right one.
pub(super) struct Rig {
    /// Rest joints, m.
    pub(super) joints: Vec<Vector3<f64>>,
    /// `body_from_bone`: axes of the joints in the rest pose.
    pub(super) axes: Vec<Matrix3<f64>>,
    /// Parents; the root has none.
    pub(super) parents: Vec<Option<usize>>,
    /// Names as in SMPL and SMPL-H.
    pub(super) names: Vec<String>,
}

impl Rig {
    /// The skeleton of a motion.
    pub(super) fn of(motion: &BodyMotion) -> Self {
        let mut joints = rest_joints(motion).to_vec();
        let (mut parents, mut names) = (PARENTS.to_vec(), JOINT_NAMES.map(str::to_owned).to_vec());
        for (side, hand) in Side::BOTH.into_iter().zip(motion.hands.iter().flatten()) {
            let first = joints.len();
            for (joint, offset) in finger_offsets(motion, hand, side).into_iter().enumerate() {
                let parent = finger_parent(joint).map_or(side.wrist(), |parent| first + parent);
                joints.push(joints[parent] + offset);
                parents.push(Some(parent));
                names.push(finger_joint_name(side, joint));
            }
        }
        let axes = (0..joints.len()).map(|joint| bone_axes(&joints, &parents, joint)).collect();
        Self { joints, axes, parents, names }
    }

    /// Number of joints.
    pub(super) fn n_joints(&self) -> usize {
        self.joints.len()
    }

    /// The joints below a joint, in order of their numbers.
    pub(super) fn children(&self, joint: usize) -> impl Iterator<Item = usize> {
        (0..self.n_joints()).filter(move |&child| self.parents[child] == Some(joint))
    }

    /// Position of a joint in its parent's axes, of the root in the body's, m.
    pub(super) fn offset(&self, joint: usize) -> Vector3<f64> {
        self.parents[joint].map_or(self.joints[joint], |parent| {
            self.axes[parent].transpose() * (self.joints[joint] - self.joints[parent])
        })
    }

    /// `parent_from_bone` for a local rotation in SMPL's axes; the identity gives the rest pose.
    pub(super) fn local(&self, joint: usize, rotation: &Matrix3<f64>) -> Matrix3<f64> {
        let turned = rotation * self.axes[joint];
        self.parents[joint].map_or(turned, |parent| self.axes[parent].transpose() * turned)
    }

    /// `parent_from_bone` in the rest pose.
    pub(super) fn rest(&self, joint: usize) -> Matrix3<f64> {
        self.local(joint, &Matrix3::identity())
    }

    /// `rest_from_bone` of a pose: the rotation away from the rest pose, in the joint's own axes.
    pub(super) fn away_from_rest(&self, joint: usize, rotation: &Matrix3<f64>) -> Matrix3<f64> {
        self.axes[joint].transpose() * rotation * self.axes[joint]
    }
}

/// Local rotation of a joint of the [`Rig`] in a frame of the motion, in SMPL's axes.
pub(super) fn joint_turn(motion: &BodyMotion, t: usize, joint: usize) -> Matrix3<f64> {
    match (joint.checked_sub(N_JOINTS), &motion.hands) {
        (Some(finger), Some(hands)) => hands[finger / N_FINGER_JOINTS].frames[t].rotations[finger % N_FINGER_JOINTS],
        _ => motion.frames[t].rotations[joint],
    }
}

/// Offsets of finger joints from their parents in the rest pose, m: mean over the frames.
fn finger_offsets(motion: &BodyMotion, hand: &HandMotion, side: Side) -> [Vector3<f64>; N_FINGER_JOINTS] {
    let mut offsets = [Vector3::zeros(); N_FINGER_JOINTS];
    let chain: Vec<usize> = chain_to_root(side.wrist()).collect();
    for (pose, fingers) in motion.frames.iter().zip(&hand.frames) {
        let wrist = chain.iter().rev().fold(Matrix3::identity(), |world, &joint| world * pose.rotations[joint]);
        let mut world_from_joint = [wrist; N_FINGER_JOINTS];
        for joint in 0..N_FINGER_JOINTS {
            let parent = finger_parent(joint);
            let (world_from_parent, at) = match parent {
                Some(parent) => (world_from_joint[parent], fingers.joints[parent]),
                None => (wrist, pose.joints[side.wrist()]),
            };
            offsets[joint] += world_from_parent.transpose() * (fingers.joints[joint] - at);
            world_from_joint[joint] = world_from_parent * fingers.rotations[joint];
        }
    }
    offsets.map(|sum| sum / motion.frames.len().max(1) as f64)
}

/// The joint at the tail of a joint's bone; where several meet, the next one of the spine.
fn next_joint(parents: &[Option<usize>], joint: usize) -> Option<usize> {
    const PELVIS: usize = 0;
    const SPINE1: usize = 3;
    const SPINE3: usize = 9;
    const NECK: usize = 12;
    match joint {
        PELVIS => Some(SPINE1),
        SPINE3 => Some(NECK),
        _ => parents.iter().position(|parent| *parent == Some(joint)),
    }
}

/// `body_from_bone`; the last bone of a limb continues the one before.
fn bone_axes(joints: &[Vector3<f64>], parents: &[Option<usize>], joint: usize) -> Matrix3<f64> {
    let bone = match (next_joint(parents, joint), parents[joint]) {
        (Some(next), _) => joints[next] - joints[joint],
        (None, Some(parent)) => joints[joint] - joints[parent],
        (None, None) => Vector3::y(),
    };
    let y = bone.try_normalize(f64::MIN_POSITIVE).unwrap_or_else(Vector3::y);
    let front = Vector3::z() - y * y.z;
    let z = front.try_normalize(1e-3).unwrap_or_else(|| any_perpendicular(&y)); // 0.06 degrees from the front
    Matrix3::from_columns(&[y.cross(&z), y, z])
}

/// Joints of the person in SMPL's rest pose, y up, m: `J_0 = p_0 - T`, `J_j = J_par + G_par^T (p_j - p_par)`, mean over the
/// frames.
pub(super) fn rest_joints(motion: &BodyMotion) -> [Vector3<f64>; N_JOINTS] {
    let mut offsets = [Vector3::zeros(); N_JOINTS];
    for pose in &motion.frames {
        let mut world_from_joint = pose.rotations;
        offsets[0] += pose.joints[0] - pose.translation;
        for (j, parent) in PARENTS.iter().enumerate() {
            if let Some(p) = *parent {
                offsets[j] += world_from_joint[p].transpose() * (pose.joints[j] - pose.joints[p]);
                world_from_joint[j] = world_from_joint[p] * pose.rotations[j];
            }
        }
    }
    let n_frames = motion.frames.len().max(1) as f64;
    let mut rest = offsets.map(|sum| sum / n_frames);
    for (j, parent) in PARENTS.iter().enumerate() {
        if let Some(p) = *parent {
            rest[j] += rest[p];
        }
    }
    rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::sample_motion::{motion, motion_with_fingers};

    #[test]
    fn bones_along_y_reach_the_next_joint_in_every_pose() {
        let motion = motion();
        let rig = Rig::of(&motion);
        for pose in &motion.frames {
            let mut world_from_bone = [Matrix3::identity(); N_JOINTS];
            let mut places = [pose.joints[0]; N_JOINTS];
            for joint in 0..N_JOINTS {
                world_from_bone[joint] = rig.local(joint, &pose.rotations[joint]);
                let about_rest = rig.rest(joint) * rig.away_from_rest(joint, &pose.rotations[joint]);
                assert!((about_rest - world_from_bone[joint]).norm() < 1e-12);
                if let Some(parent) = PARENTS[joint] {
                    places[joint] = places[parent] + world_from_bone[parent] * rig.offset(joint);
                    world_from_bone[joint] = world_from_bone[parent] * world_from_bone[joint];
                }
                assert!((places[joint] - pose.joints[joint]).norm() < 1e-9);
            }
            for (joint, next) in (0..N_JOINTS).filter_map(|joint| Some((joint, next_joint(&PARENTS, joint)?))) {
                let length = (places[next] - places[joint]).norm();
                let tail = places[joint] + world_from_bone[joint] * Vector3::y() * length;
                assert!((tail - places[next]).norm() < 1e-9);
            }
        }
    }

    #[test]
    fn fingers_reach_their_places_in_every_pose() {
        let motion = motion_with_fingers();
        let (rig, hands) = (Rig::of(&motion), motion.hands.as_ref().unwrap());
        assert_eq!((rig.n_joints(), rig.names[N_JOINTS + 15].as_str()), (54, "right_index1"));
        for (t, pose) in motion.frames.iter().enumerate() {
            let mut world_from_bone = vec![Matrix3::identity(); rig.n_joints()];
            let mut places = vec![pose.joints[0]; rig.n_joints()];
            for joint in 0..rig.n_joints() {
                world_from_bone[joint] = rig.local(joint, &joint_turn(&motion, t, joint));
                if let Some(parent) = rig.parents[joint] {
                    places[joint] = places[parent] + world_from_bone[parent] * rig.offset(joint);
                    world_from_bone[joint] = world_from_bone[parent] * world_from_bone[joint];
                }
            }
            for (side, hand) in hands.iter().enumerate() {
                for (joint, place) in hand.frames[t].joints.iter().enumerate() {
                    assert!((places[N_JOINTS + 15 * side + joint] - place).norm() < 1e-9);
                }
            }
        }
    }

    #[test]
    fn axes_are_rotations_even_of_joints_in_one_place() {
        let axes = |joints: &[Vector3<f64>; N_JOINTS]| {
            (0..N_JOINTS).map(|j| bone_axes(joints, &PARENTS, j)).collect::<Vec<_>>()
        };
        let forwards = std::array::from_fn(|joint| Vector3::z() * joint as f64);
        for axes in axes(&[Vector3::zeros(); N_JOINTS]).iter().chain(&axes(&forwards)) {
            assert!((axes.transpose() * axes - Matrix3::identity()).norm() < 1e-12);
            assert!((axes.determinant() - 1.0).abs() < 1e-12);
        }
    }
}
