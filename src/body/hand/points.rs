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

/// Points of a face in detectors' order.
pub const N_FACE_POINTS: usize = 68;

/// Points of the face that follow a convention's body; left and right hand come after them. `None` where it has no hands.
///
/// COCO-WholeBody (Jin et al., ECCV 2020): 17 points of the body, 6 of the feet, 68 of the face, 21 of each hand. OpenPose
/// (Simon et al., CVPR 2017): 25 of the body, 21 of each hand; its 70 points of the face are not read. Halpe (Fang et al.,
/// PAMI 2022): 26 of the body, 68 of the face, 21 of each hand. MediaPipe Holistic: 33 of the body, 21 of each hand.
fn face_size(convention: KeypointConvention) -> Option<usize> {
    match convention {
        KeypointConvention::CocoWholebody133 | KeypointConvention::Halpe136 => Some(N_FACE_POINTS),
        KeypointConvention::Body25Hands | KeypointConvention::Blazepose75 => Some(0),
        _ => None,
    }
}

/// The keypoints of the face in a convention; empty where it has hands and no face, `None` where it has neither.
pub fn face_keypoints(convention: KeypointConvention) -> Option<Range<usize>> {
    let first = convention.names().len();
    Some(first..first + face_size(convention)?)
}

/// The keypoints of a hand in a convention; `None` where it has no hands.
pub fn hand_keypoints(convention: KeypointConvention, side: Side) -> Option<Range<usize>> {
    let first = face_keypoints(convention)?.end + N_HAND_POINTS * side as usize;
    Some(first..first + N_HAND_POINTS)
}

/// The points of the face that lie where the body has a landmark: index in the face and name.
///
/// The corners of eyes and mouth of the 68-point layout (Sagonas et al., ICCV Workshops 2013), which counts from the person's
/// right. Outline, brows and lips have no fixed place on the head.
pub const FACE_POINTS: [(usize, &str); 6] = [
    (36, "right_eye_outer"),
    (39, "right_eye_inner"),
    (42, "left_eye_inner"),
    (45, "left_eye_outer"),
    (48, "right_mouth"),
    (54, "left_mouth"),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hands_end_a_detection() {
        for convention in KeypointConvention::ALL {
            let hands = Side::BOTH.map(|side| hand_keypoints(convention, side));
            let [Some(left), Some(right)] = hands else {
                assert_eq!(convention.n_keypoints(), convention.names().len(), "{}", convention.name());
                continue;
            };
            assert_eq!((left.end, right.end), (right.start, convention.n_keypoints()), "{}", convention.name());
        }
    }

    #[test]
    fn hands_begin_where_detectors_write_them() {
        use KeypointConvention as C;
        for (convention, left) in
            [(C::CocoWholebody133, 91), (C::Body25Hands, 25), (C::Halpe136, 94), (C::Blazepose75, 33)]
        {
            assert_eq!(hand_keypoints(convention, Side::Left), Some(left..left + 21));
            assert_eq!(hand_keypoints(convention, Side::Right), Some(left + 21..left + 42));
        }
        assert_eq!((face_keypoints(C::CocoWholebody133), face_keypoints(C::Body25Hands)), (Some(23..91), Some(25..25)));
        assert_eq!((face_keypoints(C::Halpe136), face_keypoints(C::Blazepose75)), (Some(26..94), Some(33..33)));
        assert_eq!(hand_keypoints(C::Halpe26, Side::Left), None);
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
