//! A motion for tests of the writers.

use crate::body::kinematics::{Pose, posed};
use crate::body::{Betas, default_body};
use crate::geometry::rotation::exp;
use crate::session::people::BodyPose;
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
