//! Bones between detector keypoints: which are rigid, how long they are in adults, how far they vary.

use super::skeleton::KeypointConvention;

/// A segment between two keypoints whose length a person keeps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bone {
    /// Keypoint at one end.
    pub a: usize,
    /// Keypoint at the other end.
    pub b: usize,
    /// Length in an average adult as detectors place the ends, m.
    pub length: f64,
}

/// Names of the ends and length in an adult of 1.69 m (ANSUR II, sexes pooled), m.
///
/// Upper arm: acromion-radiale 323 mm less the 45 mm by which the joint centre lies below the acromion; forearm:
/// radiale-stylion 255 mm; thigh: trochanterion less lateral femoral epicondyle height 394 mm; shank: lateral femoral
/// epicondyle less lateral malleolus height 411 mm.
const BONES: [(&str, &str, f64); 8] = [
    ("left_shoulder", "left_elbow", 0.280),
    ("right_shoulder", "right_elbow", 0.280),
    ("left_elbow", "left_wrist", 0.250),
    ("right_elbow", "right_wrist", 0.250),
    ("left_hip", "left_knee", 0.394),
    ("right_hip", "right_knee", 0.394),
    ("left_knee", "left_ankle", 0.405),
    ("right_knee", "right_ankle", 0.405),
];

/// Relative spread of a limb's length over single frames as detectors see it: 20 mm of noise at either end of 0.35 m.
pub const LENGTH_SIGMA: f64 = 0.08;

/// The limb bones of a convention; empty for none.
pub fn limb_bones(convention: KeypointConvention) -> Vec<Bone> {
    let bone = |&(a, b, length): &(&str, &str, f64)| {
        Some(Bone { a: convention.index_of(a)?, b: convention.index_of(b)?, length })
    };
    BONES.iter().filter_map(bone).collect()
}
