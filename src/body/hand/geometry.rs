//! The hand of an average adult at rest.
//!
//! Lengths of metacarpals and phalanges and of the soft tissue at the tips: Buryanov and Kotiuk, Proportions of hand segments,
//! Int. J. Morphol. 28(3), 2010 (means of 66 adults, radiographs). Their middle fingers with the carpus make a hand of 187 mm,
//! the mean of men and women in ANSUR II (193 and 181 mm, 0.110 of stature), whose breadth of 83 mm spaces the knuckles: that
//! breadth less half of the width of two fingers. Fingers fan out at rest by some degrees; the thumb points forwards and outwards.

use super::{N_FINGER_JOINTS, Side};
use nalgebra::Vector3;

/// Hinges of a hand.
pub const N_HINGES: usize = 21;

/// A hinge of a finger joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Hinge {
    /// Finger in SMPL-H's order.
    pub finger: usize,
    /// First, second or third joint of the finger: 0 to 2.
    pub place: usize,
    /// Flexion bends the finger; otherwise it moves sideways.
    pub is_flexion: bool,
}

/// Places and kinds of a finger's hinges; of one joint the outer comes first. Flexion: true.
const OF_FINGER: [(usize, bool); 4] = [(0, false), (0, true), (1, true), (2, true)];
const OF_THUMB: [(usize, bool); 5] = [(0, false), (0, true), (1, false), (1, true), (2, true)];

/// All hinges, finger by finger: the order of [`super::FingerAngles`].
pub fn hinges() -> [Hinge; N_HINGES] {
    let thumb = 4;
    std::array::from_fn(|h| {
        let finger = (h / OF_FINGER.len()).min(thumb);
        let own = h - finger * OF_FINGER.len();
        let (place, is_flexion) = if finger == thumb { OF_THUMB[own] } else { OF_FINGER[own] };
        Hinge { finger, place, is_flexion }
    })
}

/// A finger of the left hand: knuckle from the wrist, direction at rest (x along the forearm, y to the back of the hand, z to
/// the thumb), lengths to the next joints and from the last one to the tip, mm.
struct Finger {
    knuckle: [f64; 3],
    direction: [f64; 3],
    lengths: [f64; 3],
}

/// In SMPL-H's order. A tip is the distal phalanx and its soft tissue.
const FINGERS: [Finger; 5] = [
    Finger { knuckle: [93.0, -2.0, 25.0], direction: [0.993, 0.0, 0.115], lengths: [39.78, 22.38, 19.66] },
    Finger { knuckle: [94.5, 0.0, 3.0], direction: [1.0, 0.0, 0.010], lengths: [44.63, 26.33, 21.35] },
    Finger { knuckle: [77.0, -8.0, -35.0], direction: [0.978, 0.0, -0.208], lengths: [32.74, 18.11, 19.69] },
    Finger { knuckle: [86.5, -3.0, -16.5], direction: [0.996, 0.0, -0.090], lengths: [41.37, 25.65, 21.25] },
    // From the saddle joint: metacarpal 46.22 mm, then the phalanges.
    Finger { knuckle: [20.0, -8.0, 22.0], direction: [0.740, -0.220, 0.635], lengths: [46.22, 31.57, 25.34] },
];

/// Direction in which the thumb's flexion moves its tip: across the palm.
const ACROSS_PALM: [f64; 3] = [0.0, -0.55, -0.835];

/// A hand at rest, in the frame of its wrist, which is parallel to the body's in the T-pose.
#[derive(Debug, Clone, PartialEq)]
pub struct HandShape {
    /// `[finger][place]`: the joints, and the tip in the last place, from the wrist, m.
    pub places: [[Vector3<f64>; 4]; 5],
    /// Axes of the hinges, unit length; a positive angle bends the finger, or moves it to the thumb's side.
    pub axes: [Vector3<f64>; N_HINGES],
}

impl HandShape {
    /// The hand of an average adult, 187 mm from the wrist to the tip of the middle finger.
    pub fn average(side: Side) -> Self {
        let left = Self::left();
        match side {
            Side::Left => left,
            Side::Right => left.mirrored(),
        }
    }

    /// `M = diag(-1, 1, 1)` maps points to `M p` and the rotation about `a` to that about `-M a`.
    fn mirrored(&self) -> Self {
        let mirror = |p: &Vector3<f64>| Vector3::new(-p.x, p.y, p.z);
        Self { places: self.places.map(|finger| finger.map(|p| mirror(&p))), axes: self.axes.map(|a| -mirror(&a)) }
    }

    fn left() -> Self {
        let direction = |finger: usize| Vector3::from(FINGERS[finger].direction).normalize();
        let places = std::array::from_fn(|finger| {
            let Finger { knuckle, lengths, .. } = &FINGERS[finger];
            let along = |place: usize| direction(finger) * lengths[..place].iter().sum::<f64>();
            std::array::from_fn(|place| (Vector3::from(*knuckle) + along(place)) * 1e-3)
        });
        let axes = hinges().map(|hinge| {
            let along = direction(hinge.finger);
            let palm = if hinge.finger == 4 { Vector3::from(ACROSS_PALM) } else { -Vector3::y() };
            let flexion = along.cross(&palm).normalize();
            if hinge.is_flexion { flexion } else { along.cross(&flexion).normalize() }
        });
        Self { places, axes }
    }

    /// A joint in SMPL-H's order, from the wrist, m.
    pub fn joint(&self, joint: usize) -> Vector3<f64> {
        debug_assert!(joint < N_FINGER_JOINTS);
        self.places[joint / 3][joint % 3]
    }

    /// From the wrist to the tip of the middle finger, m.
    pub fn length(&self) -> f64 {
        self.places[1][3].norm()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_average_hand_has_the_published_size() {
        let hand = HandShape::average(Side::Left);
        assert!((hand.length() - 0.187).abs() < 0.001, "{}", hand.length());
        let breadth = (hand.places[0][0] - hand.places[2][0]).norm();
        assert!((0.058..0.066).contains(&breadth), "{breadth}");
        // Metacarpals of index to little finger from the carpus, 26 to 30 mm from the wrist.
        for (finger, length) in [(0, 68.12), (1, 64.60), (2, 53.69), (3, 58.00)] {
            let from_carpus = hand.places[finger][0].norm() * 1e3 - length;
            assert!((24.0..34.0).contains(&from_carpus), "{finger}: {from_carpus}");
        }
    }

    #[test]
    fn flexion_bends_fingers_to_the_palm_and_sides_mirror() {
        let [left, right] = Side::BOTH.map(HandShape::average);
        for (h, hinge) in hinges().iter().enumerate().filter(|(_, hinge)| hinge.is_flexion) {
            let along = left.places[hinge.finger][3] - left.places[hinge.finger][0];
            assert!(left.axes[h].cross(&along).y < 0.0, "hinge {h}");
        }
        for (a, b) in left.places.iter().flatten().zip(right.places.iter().flatten()) {
            assert_eq!(*a, Vector3::new(-b.x, b.y, b.z));
        }
        assert!(left.places[4][3].z > 0.05, "the thumb points forwards in the T-pose");
    }
}
