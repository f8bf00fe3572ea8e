//! Joint names of other programs, by which their retargeting recognises a skeleton.
//!
//! | suffix | names |
//! | none | SMPL's |
//! | `.humanik` | HumanIK, as MotionBuilder and Maya characterise them |
//! | `.mixamo` | Mixamo: HumanIK's with the prefix `mixamorig:` |
//! | `.unreal` | the mannequin of Unreal Engine 5 |
//!
//! Known limits: SMPL has three joints in the spine, Unreal's mannequin five: `spine_02` and `spine_04` are left out. SMPL's
//! hands are the knuckles of the middle fingers; there are no other fingers.

use crate::body::skeleton::{JOINT_NAMES, N_JOINTS};

/// A set of joint names.
pub(super) struct Profile {
    /// Stands in file names before the extension.
    pub(super) suffix: &'static str,
    /// In SMPL's order.
    pub(super) names: [String; N_JOINTS],
}

const HUMANIK_NAMES: [&str; N_JOINTS] = [
    "Hips", "LeftUpLeg", "RightUpLeg", "Spine", "LeftLeg", "RightLeg", "Spine1", "LeftFoot", "RightFoot", "Spine2",
    "LeftToeBase", "RightToeBase", "Neck", "LeftShoulder", "RightShoulder", "Head", "LeftArm", "RightArm",
    "LeftForeArm", "RightForeArm", "LeftHand", "RightHand", "LeftHandMiddle1", "RightHandMiddle1",
];

const UNREAL_NAMES: [&str; N_JOINTS] = [
    "pelvis", "thigh_l", "thigh_r", "spine_01", "calf_l", "calf_r", "spine_03", "foot_l", "foot_r", "spine_05",
    "ball_l", "ball_r", "neck_01", "clavicle_l", "clavicle_r", "head", "upperarm_l", "upperarm_r", "lowerarm_l",
    "lowerarm_r", "hand_l", "hand_r", "middle_01_l", "middle_01_r",
];

/// All sets, SMPL's first.
pub(super) fn profiles() -> [Profile; 4] {
    [
        Profile { suffix: "", names: JOINT_NAMES.map(str::to_owned) },
        Profile { suffix: ".humanik", names: HUMANIK_NAMES.map(str::to_owned) },
        Profile { suffix: ".mixamo", names: HUMANIK_NAMES.map(|name| format!("mixamorig:{name}")) },
        Profile { suffix: ".unreal", names: UNREAL_NAMES.map(str::to_owned) },
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// Side of a joint by the spelling of each program: -1 left, 1 right, 0 neither.
    fn side(name: &str) -> i32 {
        let lower = name.to_ascii_lowercase();
        let plain = lower.trim_start_matches("mixamorig:");
        match (plain.starts_with("left") || plain.ends_with("_l"), plain.starts_with("right") || plain.ends_with("_r"))
        {
            (true, false) => -1,
            (false, true) => 1,
            _ => 0,
        }
    }

    #[test]
    fn names_are_distinct_and_keep_the_side() {
        for profile in profiles() {
            assert_eq!(profile.names.iter().collect::<BTreeSet<_>>().len(), N_JOINTS, "{}", profile.suffix);
            for (name, smpl) in profile.names.iter().zip(JOINT_NAMES) {
                assert_eq!(side(name), side(smpl), "{name} and {smpl}");
            }
        }
    }
}
