//! Joint names of other programs, by which their retargeting recognises a skeleton.
//!
//! | suffix | names |
//! | none | SMPL's |
//! | `.humanik` | HumanIK, as MotionBuilder and Maya characterise them |
//! | `.mixamo` | Mixamo: HumanIK's with the prefix `mixamorig:` |
//! | `.unreal` | the mannequin of Unreal Engine 5 |
//!
//! Known limits: SMPL has three joints in the spine, Unreal's mannequin five: `spine_02` and `spine_04` are left out. SMPL's
//! hands are the knuckles of the middle fingers; other fingers exist where hands were fitted.

use super::rig::Rig;
use crate::body::hand::{FINGERS, N_FINGER_JOINTS, Side};
use crate::body::skeleton::N_JOINTS;

/// A set of joint names.
pub(super) struct Profile {
    /// Stands in file names before the extension.
    pub(super) suffix: &'static str,
    /// In the order of the [`Rig`].
    pub(super) names: Vec<String>,
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
pub(super) fn profiles(rig: &Rig) -> [Profile; 4] {
    let has_fingers = rig.n_joints() > N_JOINTS;
    let named = |body: &[&str; N_JOINTS], palms: [&str; 2], finger: fn(Side, usize) -> String| {
        let mut names: Vec<String> = body.map(str::to_owned).to_vec();
        if has_fingers {
            // What was the knuckle of the middle finger now lies between the wrist and it.
            names[N_JOINTS - 2..].clone_from_slice(&palms.map(str::to_owned));
            names.extend(Side::BOTH.iter().flat_map(|side| (0..N_FINGER_JOINTS).map(|joint| finger(*side, joint))));
        }
        names
    };
    let humanik = named(&HUMANIK_NAMES, ["LeftInHandMiddle", "RightInHandMiddle"], humanik_finger);
    let unreal = named(&UNREAL_NAMES, ["middle_metacarpal_l", "middle_metacarpal_r"], unreal_finger);
    [
        Profile { suffix: "", names: rig.names.clone() },
        Profile { suffix: ".humanik", names: humanik.clone() },
        Profile { suffix: ".mixamo", names: humanik.iter().map(|name| format!("mixamorig:{name}")).collect() },
        Profile { suffix: ".unreal", names: unreal },
    ]
}

/// `LeftHandIndex1`
fn humanik_finger(side: Side, joint: usize) -> String {
    let side = if side == Side::Left { "Left" } else { "Right" };
    let finger = ["Index", "Middle", "Pinky", "Ring", "Thumb"][joint / 3];
    format!("{side}Hand{finger}{}", joint % 3 + 1)
}

/// `index_01_l`
fn unreal_finger(side: Side, joint: usize) -> String {
    let side = if side == Side::Left { "l" } else { "r" };
    format!("{}_0{}_{side}", FINGERS[joint / 3], joint % 3 + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::sample_motion::{motion, motion_with_fingers};
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
        for rig in [motion(), motion_with_fingers()].map(|motion| Rig::of(&motion)) {
            for profile in profiles(&rig) {
                let distinct: BTreeSet<_> = profile.names.iter().collect();
                assert_eq!(distinct.len(), rig.n_joints(), "{}", profile.suffix);
                for (name, smpl) in profile.names.iter().zip(&rig.names) {
                    assert_eq!(side(name), side(smpl), "{name} and {smpl}");
                }
            }
        }
    }
}
