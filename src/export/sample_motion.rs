//! A motion for tests of the writers.

use crate::body::hand::{HandShape, Side, finger_rotations, hinge_ranges, posed_hand};
use crate::body::kinematics::{Pose, posed};
use crate::body::{Betas, default_body};
use crate::geometry::rotation::exp;
use crate::session::people::{BodyPose, HandMotion, HandPose};
use crate::session::{BodyMotion, FrameIndex, PersonId};
use nalgebra::Vector3;

/// Three frames of large rotations of a default body.
pub(super) fn motion() -> BodyMotion {
    let body = default_body().shaped(&Betas::repeat(0.4));
    let frame = |t: usize| {
        let turn = |j: usize| Vector3::new((t + j) as f64, 1.7 * j as f64, (t * j) as f64).map(f64::sin);
        let pose = Pose { rotations: std::array::from_fn(|j| exp(&turn(j))), translation: Vector3::y() };
        let joints = posed(&body, &pose).joints;
        BodyPose { rotations: pose.rotations, translation: pose.translation, joints, valid: true }
    };
    let frames = (0..3).map(frame).collect();
    BodyMotion { person: PersonId(0), first: FrameIndex(0), betas: [0.4; 10], frames, joint_sigmas: None, hands: None }
}

/// The same with moving fingers.
pub(super) fn motion_with_fingers() -> BodyMotion {
    let body = default_body().shaped(&Betas::repeat(0.4));
    let motion = motion();
    let hand = |side: Side| {
        let shape = HandShape::average(side);
        let pose = |(t, frame): (usize, &BodyPose)| {
            let angles = hinge_ranges().map(|range| range.rest + range.spread * (t as f64 + range.min).sin());
            let skeleton = posed(&body, &Pose { rotations: frame.rotations, translation: frame.translation });
            let wrist = (&skeleton.joints[side.wrist()], &skeleton.rotations[side.wrist()]);
            let joints = posed_hand(&shape, wrist, 1.04, &angles).joints();
            HandPose { rotations: finger_rotations(&shape, &angles), joints, n_views: 3 }
        };
        HandMotion { frames: motion.frames.iter().enumerate().map(pose).collect() }
    };
    let hands = Some(Side::BOTH.map(hand));
    BodyMotion { hands, ..motion }
}
