//! Limb bones between detector keypoints: their ends, their length in adults and its spread.

use super::skeleton::KeypointConvention;

/// A limb segment between two keypoints whose length is constant for one person.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LimbBone {
    /// Index of the keypoint at one end.
    pub a: usize,
    /// Index of the keypoint at the other end.
    pub b: usize,
    /// Distance between the two keypoints as detectors place them, in an average adult, m.
    pub length: f64,
}

/// Names of both ends and the length in an adult of 1.69 m (ANSUR II, sexes pooled), m.
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

/// Relative standard deviation of a limb's length over single frames as detectors see it: 20 mm of noise at each end
/// of a bone of 0.35 m.
pub const LENGTH_SIGMA: f64 = 0.08;

/// The limb bones whose ends the convention has.
pub fn limb_bones(convention: KeypointConvention) -> Vec<LimbBone> {
    let bone = |&(a, b, length): &(&str, &str, f64)| {
        Some(LimbBone { a: convention.index_of(a)?, b: convention.index_of(b)?, length })
    };
    BONES.iter().filter_map(bone).collect()
}
