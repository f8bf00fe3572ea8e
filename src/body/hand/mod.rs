//! The hand: 15 finger joints in SMPL-H's order, and the 21 points that detectors report of a hand.
//!
//! | file | content |
//! |---|---|
//! | `finger` | names and parents of the joints, the two hands |
//! | `points` | which of a detector's keypoints are points of a hand, or of the head |
//! | `geometry` | the hand of an average adult at rest: joints, finger tips, hinges |
//! | `ranges` | ranges, rest and spread of the hinges |
//! | `kinematics` | the posed hand and its derivatives |
//! | `landmarks` | a body model whose wrists and head also have the rigid ones of these points |
//!
//! Fingers turn about hinges: two at a finger's first joint (and at the first two of the thumb), one at the others. SMPL-H's
//! rotation of a joint is the product of its hinges' rotations; all its frames are parallel to the wrist's at rest.

mod finger;
mod geometry;
mod kinematics;
mod landmarks;
mod points;
mod ranges;

pub use finger::{FINGERS, N_FINGER_JOINTS, Side, finger_joint_name, finger_parent};
pub use geometry::{HandShape, Hinge, N_HINGES, hinges};
pub use kinematics::{FingerAngles, PosedHand, finger_rotations, posed_hand};
pub use landmarks::{relative_hand_size, rigid_points, with_hand_landmarks};
pub use points::{FACE_POINTS, HandPoint, N_FACE_POINTS, N_HAND_POINTS, face_keypoints, hand_keypoints, hand_points};
pub use ranges::{HingeRange, hinge_ranges};
