//! Joint names and parents in SMPL's order, and the keypoint conventions of detectors.

use serde::{Deserialize, Serialize};

/// Number of joints of the SMPL skeleton.
pub const N_JOINTS: usize = 24;

/// The 24 joints in SMPL's order.
pub const JOINT_NAMES: [&str; N_JOINTS] = [
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
    "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_hand", "right_hand",
];

/// For each joint the one on the other side of the body; itself on the midline.
pub const JOINT_COUNTERPARTS: [usize; N_JOINTS] =
    [0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16, 19, 18, 21, 20, 23, 22];

/// Parent of every joint; the pelvis is the root.
pub const PARENTS: [Option<usize>; N_JOINTS] = [
    None,
    Some(0),
    Some(0),
    Some(0),
    Some(1),
    Some(2),
    Some(3),
    Some(4),
    Some(5),
    Some(6),
    Some(7),
    Some(8),
    Some(9),
    Some(9),
    Some(9),
    Some(12),
    Some(13),
    Some(14),
    Some(16),
    Some(17),
    Some(18),
    Some(19),
    Some(20),
    Some(21),
];

/// Joint `joint` and all its ancestors up to the root, nearest first.
pub fn chain_to_root(joint: usize) -> impl Iterator<Item = usize> {
    std::iter::successors(Some(joint), |&j| PARENTS[j])
}

/// The order and meaning of a detector's keypoints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum KeypointConvention {
    /// COCO, 17 points.
    Coco17,
    /// OpenPose COCO, 18 points.
    Coco18,
    /// OpenPose BODY_25.
    Body25,
    /// OpenPose BODY_25B.
    Body25b,
    /// Halpe, 26 body points.
    Halpe26,
    /// COCO-WholeBody, 133 points: the first 23 (body and feet) are used everywhere, hands and some points of the face
    /// ([`super::hand`]) in the fits of bodies and hands.
    #[serde(rename = "coco_wholebody133")]
    CocoWholebody133,
    /// MediaPipe BlazePose, 33 points.
    Blazepose33,
    /// The 24 SMPL joints.
    Smpl24,
    /// OpenPose BODY_25 with its 21 points of the left and of the right hand, 67 points; hands as of COCO-WholeBody.
    #[serde(rename = "body25_hands")]
    Body25Hands,
    /// Halpe, 136 points: 26 of the body, face and hands as of COCO-WholeBody.
    Halpe136,
    /// MediaPipe Holistic, 75 points: BlazePose's 33, then left and right hand in the order of COCO-WholeBody.
    Blazepose75,
}

use KeypointConvention as C;

impl KeypointConvention {
    /// Every convention, for messages and tests.
    pub const ALL: [Self; 11] = [
        C::Coco17,
        C::Coco18,
        C::Body25,
        C::Body25b,
        C::Halpe26,
        C::CocoWholebody133,
        C::Blazepose33,
        C::Smpl24,
        C::Body25Hands,
        C::Halpe136,
        C::Blazepose75,
    ];

    /// The canonical name.
    pub fn name(self) -> &'static str {
        match self {
            C::Coco17 => "coco17",
            C::Coco18 => "coco18",
            C::Body25 => "body25",
            C::Body25b => "body25b",
            C::Halpe26 => "halpe26",
            C::CocoWholebody133 => "coco_wholebody133",
            C::Blazepose33 => "blazepose33",
            C::Smpl24 => "smpl24",
            C::Body25Hands => "body25_hands",
            C::Halpe136 => "halpe136",
            C::Blazepose75 => "blazepose75",
        }
    }

    /// The convention of a canonical name or a detector's own name for it.
    pub fn parse(name: &str) -> Option<Self> {
        let plain: String = name.chars().filter(char::is_ascii_alphanumeric).collect::<String>().to_ascii_lowercase();
        Some(match plain.as_str() {
            "coco17" | "coco" | "cocokeypoints" | "yolopose" | "vitposecoco" => C::Coco17,
            "coco18" | "openposecoco" | "openposecoco18" => C::Coco18,
            "body25" | "openposebody25" | "openpose25" | "openpose" => C::Body25,
            "body25b" | "openposebody25b" | "openpose25b" => C::Body25b,
            "halpe26" | "halpe26body" | "alphaposehalpe26" | "bodywithfeet" => C::Halpe26,
            "cocowholebody133" | "cocowholebody" | "wholebody133" | "coco133" => C::CocoWholebody133,
            "blazepose33" | "blazepose" | "mediapipe" | "mediapipe33" => C::Blazepose33,
            "smpl24" | "smpl" => C::Smpl24,
            "body25hands" | "openposebody25hands" | "openposehands" => C::Body25Hands,
            "halpe136" | "halpefullbody" | "halpefullbody136" | "alphaposehalpe136" => C::Halpe136,
            "blazepose75" | "mediapipe75" | "mediapipeholistic" | "holistic" => C::Blazepose75,
            _ => return None,
        })
    }

    /// Number of keypoints of a person.
    pub fn n_keypoints(self) -> usize {
        match self {
            C::CocoWholebody133 => 133,
            C::Body25Hands => 67,
            C::Halpe136 => 136,
            C::Blazepose75 => 75,
            _ => self.names().len(),
        }
    }

    /// Names of the leading body keypoints, in order; the points after them (face, hands) have no names: association, cameras and
    /// repair go without them.
    pub fn names(self) -> &'static [&'static str] {
        match self {
            C::Coco17 => &HALPE26_NAMES[..17],
            C::Coco18 => &COCO18_NAMES,
            C::Body25 | C::Body25Hands => &BODY25_NAMES,
            C::Body25b => &BODY25B_NAMES,
            C::Halpe26 | C::Halpe136 => &HALPE26_NAMES,
            C::CocoWholebody133 => &WHOLEBODY_NAMES,
            C::Blazepose33 | C::Blazepose75 => &BLAZEPOSE_NAMES,
            C::Smpl24 => &JOINT_NAMES,
        }
    }

    /// Index of a keypoint by name.
    pub fn index_of(self, name: &str) -> Option<usize> {
        self.names().iter().position(|n| *n == name)
    }

    /// Indices of the left and the right keypoint of a part of the body.
    pub fn sides_of(self, part: &str) -> Option<[usize; 2]> {
        Some([self.index_of(&format!("left_{part}"))?, self.index_of(&format!("right_{part}"))?])
    }

    /// For each named keypoint its left/right counterpart (itself on the midline).
    pub fn mirror(self) -> Vec<usize> {
        let counterpart = |name: &str| self.index_of(&counterpart_name(name)?);
        self.names().iter().enumerate().map(|(i, name)| counterpart(name).unwrap_or(i)).collect()
    }
}

/// The name of the joint or point on the other side, by `left_` and `right_`; `None` on the midline.
pub fn counterpart_name(name: &str) -> Option<String> {
    match (name.strip_prefix("left_"), name.strip_prefix("right_")) {
        (Some(part), _) => Some(format!("right_{part}")),
        (_, Some(part)) => Some(format!("left_{part}")),
        _ => None,
    }
}

const COCO18_NAMES: [&str; 18] = [
    "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
    "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "right_eye", "left_eye",
    "right_ear", "left_ear",
];

const BODY25_NAMES: [&str; 25] = [
    "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
    "mid_hip", "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "right_eye",
    "left_eye", "right_ear", "left_ear", "left_big_toe", "left_small_toe", "left_heel", "right_big_toe",
    "right_small_toe", "right_heel",
];

const BODY25B_NAMES: [&str; 25] = [
    "nose", "left_eye", "right_eye", "left_ear", "right_ear", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle",
    "right_ankle", "neck", "head_top", "left_big_toe", "left_small_toe", "left_heel", "right_big_toe",
    "right_small_toe", "right_heel",
];

const HALPE26_NAMES: [&str; 26] = [
    "nose", "left_eye", "right_eye", "left_ear", "right_ear", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle",
    "right_ankle", "head_top", "neck", "mid_hip", "left_big_toe", "right_big_toe", "left_small_toe", "right_small_toe",
    "left_heel", "right_heel",
];

const WHOLEBODY_NAMES: [&str; 23] = [
    "nose", "left_eye", "right_eye", "left_ear", "right_ear", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle",
    "right_ankle", "left_big_toe", "left_small_toe", "left_heel", "right_big_toe", "right_small_toe", "right_heel",
];

const BLAZEPOSE_NAMES: [&str; 33] = [
    "nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye", "right_eye_outer",
    "left_ear", "right_ear", "left_mouth", "right_mouth", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_pinky", "right_pinky", "left_index", "right_index", "left_thumb",
    "right_thumb", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle", "left_heel",
    "right_heel", "left_big_toe", "right_big_toe",
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counterparts_of_joints_follow_their_names() {
        for (name, &counterpart) in JOINT_NAMES.into_iter().zip(&JOINT_COUNTERPARTS) {
            assert_eq!(JOINT_NAMES[counterpart], counterpart_name(name).as_deref().unwrap_or(name));
        }
    }

    #[test]
    fn conventions_parse_their_names_and_mirror_back() {
        for c in KeypointConvention::ALL {
            assert_eq!(KeypointConvention::parse(c.name()), Some(c));
            let m = c.mirror();
            assert!(m.iter().enumerate().all(|(i, &j)| m[j] == i), "{}", c.name());
        }
    }

    #[test]
    fn a_parent_comes_before_its_child() {
        for (j, p) in PARENTS.iter().enumerate().skip(1) {
            assert!(p.is_some_and(|p| p < j));
        }
    }
}
