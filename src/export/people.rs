//! `people.json`: shape and motion of every person in SMPL's convention.

use super::files::{micro, micro_entries};
use super::skin::free_body;
use crate::body::skeleton::N_JOINTS;
use crate::body::{Betas, BodyModel};
use crate::geometry::rotation;
use crate::session::formats::rounded;
use crate::session::people::{BodyPose, JointSigmas};
use crate::session::reconstruction::BodyModelId;
use crate::session::{BodyMotion, FrameIndex, Reconstruction, Session};
use serde::Serialize;

/// The file.
#[derive(Serialize)]
pub(super) struct People<'a> {
    units: &'static str,
    fps: f64,
    body_model: &'a BodyModelId,
    people: Vec<Person>,
}

#[derive(Serialize)]
struct Person {
    id: usize,
    betas: [f64; 10],
    /// Height of the body in its rest pose, m, of the default body.
    #[serde(skip_serializing_if = "Option::is_none")]
    stature_m: Option<f64>,
    frames: Vec<i64>,
    global_orient: Vec<[f64; 3]>,
    body_pose: Vec<Vec<f64>>,
    transl: Vec<[f64; 3]>,
    valid: Vec<bool>,
    /// By frame and joint, three axes together.
    #[serde(skip_serializing_if = "Option::is_none")]
    joint_sigma_mm: Option<Vec<[f64; N_JOINTS]>>,
}

/// The content of `people.json`.
pub(super) fn people<'a>(session: &Session, reconstruction: &'a Reconstruction) -> People<'a> {
    let body = free_body(&reconstruction.body_model);
    People {
        units: "m",
        fps: session.fps,
        body_model: &reconstruction.body_model,
        people: reconstruction.motions.iter().map(|motion| person(session, motion, body.as_ref())).collect(),
    }
}

/// Frame numbers of a motion, consecutive.
pub(super) fn frame_numbers(session: &Session, motion: &BodyMotion) -> Vec<i64> {
    (0..motion.frames.len()).map(|i| session.frame_number(FrameIndex(motion.first.0 + i))).collect()
}

/// The 24 local rotations of a frame as axis-angle, radians: SMPL's `poses`, 72 wide.
pub(super) fn axis_angles(pose: &BodyPose) -> Vec<f64> {
    pose.rotations.iter().flat_map(|r| <[f64; 3]>::from(rotation::log(r))).collect()
}

/// Standard deviations in mm, to a hundredth.
pub(super) fn millimetres(sigmas: &JointSigmas) -> [f64; N_JOINTS] {
    sigmas.map(|sigma| rounded(1e3 * sigma, 2))
}

fn person(session: &Session, motion: &BodyMotion, body: Option<&BodyModel>) -> Person {
    // [frames, 72]
    let poses: Vec<Vec<f64>> =
        motion.frames.iter().map(|pose| axis_angles(pose).into_iter().map(micro).collect()).collect();
    Person {
        id: motion.person.0,
        betas: motion.betas.map(micro),
        stature_m: body.map(|body| rounded(body.surface.stature(&Betas::from(motion.betas)), 3)),
        frames: frame_numbers(session, motion),
        global_orient: poses.iter().map(|pose| [pose[0], pose[1], pose[2]]).collect(),
        body_pose: poses.iter().map(|pose| pose[3..].to_vec()).collect(),
        transl: motion.frames.iter().map(|pose| micro_entries(&pose.translation)).collect(),
        valid: motion.frames.iter().map(|pose| pose.valid).collect(),
        joint_sigma_mm: motion.joint_sigmas.as_ref().map(|sigmas| sigmas.iter().map(millimetres).collect()),
    }
}
