//! The keypoints of hands and face in a detector's convention.

use super::Side;
use crate::body::skeleton::KeypointConvention;
use std::ops::Range;

/// Points of a hand in detectors' order: the wrist, then four of each finger from its first joint to its tip, thumb to
/// little finger.
pub const N_HAND_POINTS: usize = 21;

/// A point of a hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HandPoint {
    /// The wrist.
    Wrist,
    /// A joint of a finger.
    Joint {
        /// Finger in SMPL-H's order.
        finger: usize,
        /// First, second, third joint: 0 to 2; 3 is the tip.
        place: usize,
    },
}

/// Detectors name the fingers from the thumb on; SMPL-H has them as [`super::FINGERS`].
const FINGERS_OF_DETECTORS: [usize; 5] = [4, 0, 1, 3, 2];

/// The 21 points in detectors' order.
pub fn hand_points() -> [HandPoint; N_HAND_POINTS] {
    std::array::from_fn(|point| match point.checked_sub(1) {
        None => HandPoint::Wrist,
        Some(i) => HandPoint::Joint { finger: FINGERS_OF_DETECTORS[i / 4], place: i % 4 },
    })
}

/// The keypoints of a hand in a convention; `None` where it has no hands.
///
/// COCO-WholeBody (Jin et al., ECCV 2020): 17 of the body, 6 of the feet, 68 of the face, then left and right hand.
pub fn hand_keypoints(convention: KeypointConvention, side: Side) -> Option<Range<usize>> {
    let first = match (convention, side) {
        (KeypointConvention::CocoWholebody133, Side::Left) => 91,
        (KeypointConvention::CocoWholebody133, Side::Right) => 112,
        _ => return None,
    };
    Some(first..first + N_HAND_POINTS)
}

/// The points of COCO-WholeBody's face that lie where the body has a landmark: index of the keypoint and name.
///
/// The corners of eyes and mouth of the 68-point layout (Sagonas et al., ICCV Workshops 2013), which counts from the person's
/// right. Outline, brows and lips have no fixed place on the head.
pub const FACE_POINTS: [(usize, &str); 6] = [
    (59, "right_eye_outer"),
    (62, "right_eye_inner"),
    (65, "left_eye_inner"),
    (68, "left_eye_outer"),
    (71, "right_mouth"),
    (77, "left_mouth"),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hands_end_a_wholebody_detection() {
        let convention = KeypointConvention::CocoWholebody133;
        let [left, right] = Side::BOTH.map(|side| hand_keypoints(convention, side).unwrap());
        assert_eq!((left.end, right.end), (right.start, convention.n_keypoints()));
        assert_eq!(hand_keypoints(KeypointConvention::Halpe26, Side::Left), None);
    }

    #[test]
    fn points_run_from_thumb_to_little_finger() {
        let points = hand_points();
        assert_eq!(points[0], HandPoint::Wrist);
        assert_eq!(points[4], HandPoint::Joint { finger: 4, place: 3 });
        assert_eq!(points[5], HandPoint::Joint { finger: 0, place: 0 });
        assert_eq!(points[20], HandPoint::Joint { finger: 2, place: 3 });
    }
}
