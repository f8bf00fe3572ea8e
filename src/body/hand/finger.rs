//! Fingers and their joints, and the two hands.

/// Joints of a hand's fingers.
pub const N_FINGER_JOINTS: usize = 15;

/// Fingers of a hand, in SMPL-H's order.
pub const FINGERS: [&str; 5] = ["index", "middle", "pinky", "ring", "thumb"];

/// A hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// The person's left hand.
    Left,
    /// The person's right hand.
    Right,
}

impl Side {
    /// Left, then right: the order of all pairs.
    pub const BOTH: [Self; 2] = [Self::Left, Self::Right];

    /// `left` or `right`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
        }
    }

    /// Joint of the wrist in the body's skeleton.
    pub fn wrist(self) -> usize {
        match self {
            Self::Left => 20,
            Self::Right => 21,
        }
    }
}

/// Parent of a finger joint in the hand; `None` for the first of a finger, whose parent is the wrist.
pub fn finger_parent(joint: usize) -> Option<usize> {
    (!joint.is_multiple_of(3)).then(|| joint - 1)
}

/// SMPL-H's name of a finger joint, such as `left_index1`.
pub fn finger_joint_name(side: Side, joint: usize) -> String {
    format!("{}_{}{}", side.name(), FINGERS[joint / 3], joint % 3 + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::skeleton::JOINT_NAMES;

    #[test]
    fn joints_have_the_names_and_parents_of_smplh() {
        assert_eq!(finger_joint_name(Side::Left, 0), "left_index1");
        assert_eq!(finger_joint_name(Side::Right, 14), "right_thumb3");
        assert_eq!([0, 1, 2, 3].map(finger_parent), [None, Some(0), Some(1), None]);
        assert_eq!(Side::BOTH.map(|side| JOINT_NAMES[side.wrist()]), ["left_wrist", "right_wrist"]);
    }
}
