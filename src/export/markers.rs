//! The markers of a person: the body model's joint centres, and beside them the detector's own keypoints.

use super::take::Take;
use crate::body::skeleton::JOINT_NAMES;
use crate::session::BodyMotion;
use nalgebra::Vector3;

/// Distinguishes keypoints from joints of the same name.
const KEYPOINT_PREFIX: &str = "detected_";

/// Named points of a motion.
pub(super) struct Markers {
    /// Joints first, then keypoints; those are left out where the take has none of the person.
    pub(super) names: Vec<String>,
    /// `[frames][markers]`, m; `None` where a keypoint is unknown.
    pub(super) frames: Vec<Vec<Option<Vector3<f64>>>>,
}

/// The markers of a person in the take's world.
pub(super) fn markers(take: &Take, motion: &BodyMotion) -> Markers {
    let has_keypoints = take.keypoints_of(motion).any(|points| !points.is_empty());
    let keypoints: &[String] = if has_keypoints { &take.keypoint_names } else { &[] };
    let names = JOINT_NAMES.iter().map(|name| (*name).to_owned());
    let names = names.chain(keypoints.iter().map(|name| format!("{KEYPOINT_PREFIX}{name}"))).collect();
    let frame = |(pose, points): (&crate::session::people::BodyPose, &[Option<Vector3<f64>>])| {
        let known = (0..keypoints.len()).map(|k| points.get(k).copied().flatten());
        pose.joints.iter().copied().map(Some).chain(known).collect()
    };
    Markers { names, frames: motion.frames.iter().zip(take.keypoints_of(motion)).map(frame).collect() }
}
