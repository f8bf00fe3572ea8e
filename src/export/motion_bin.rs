//! `stages/motion.bin`: all data that the viewer draws in the scene, in the layout of [`super::buffers`].
//!
//! Header: `format: "wandless.motion"`, `version: 1`, `name`, `fps`, `first_frame`, `n_frames`, `joint_names`,
//! `joint_parents` (null for the root), `keypoint_names`, `world` (the content of `cameras.json`), `body_model` (of
//! `people.json`) and `people`, each with
//!
//! - `id`; `betas`; `first`: frame index (from 0) of the first row of all arrays
//! - `joints` `[frames, 24, 3]`: the body's joints, world metres
//! - `turns` `[frames, 24, 4]`: `world_from_joint` as quaternions x y z w, 32767 for 1
//! - `valid` `[frames]`: 0 where the pose is carried over
//! - `keypoints` `[frames, K, 3]`: the keypoints in the world, metres, NaN where unknown
//! - `n_views` `[frames, K]`: number of cameras that observe each of them
//! - `fingers` `[frames, 2, 15, 3]`, where hands were fitted: finger joints of the left and the right hand, world metres
//! - `repairs`: `[frame index, camera index]` where the detector's track of this person ended and the result continues it
//!   with another, or where detections that would have been another person's are assigned to this one from here on
//!
//! and `rejected` `[cameras, n_frames]`: number of detections assigned to no person; `repaired`, same shape, where the
//! consistency stage ran: number of detections with exchanged or rejected keypoints. Both are at most 255. `hands`, where any
//! person has `fingers`: `wrists`, the body's joints that carry the left and the right hand, and `parents` of the finger
//! joints, null for the wrist.

use super::buffers::{Array, Payload};
use super::cameras::{Cameras, cameras};
use super::files::micro;
use super::rotation_forms::quaternion_xyzw;
use crate::body::hand::{N_FINGER_JOINTS, Side, finger_parent};
use crate::body::skeleton::{JOINT_NAMES, N_JOINTS, PARENTS};
use crate::session::people::{BodyPose, HandMotion};
use crate::session::reconstruction::{BodyModelId, DetectionRepairs};
use crate::session::{BodyMotion, JointTrajectory, PersonId, Reconstruction, Session};
use serde::Serialize;
use std::io;

/// Version of the layout described above.
const VERSION: u32 = 1;

#[derive(Serialize)]
struct Header<'a> {
    format: &'static str,
    version: u32,
    name: &'a str,
    fps: f64,
    first_frame: i64,
    n_frames: usize,
    joint_names: [&'static str; N_JOINTS],
    joint_parents: [Option<usize>; N_JOINTS],
    keypoint_names: &'static [&'static str],
    world: Cameras<'a>,
    body_model: &'a BodyModelId,
    #[serde(skip_serializing_if = "Option::is_none")]
    hands: Option<Hands>,
    people: Vec<Person>,
    rejected: Array,
    #[serde(skip_serializing_if = "Option::is_none")]
    repaired: Option<Array>,
}

#[derive(Serialize)]
struct Hands {
    wrists: [usize; 2],
    parents: [Option<usize>; N_FINGER_JOINTS],
}

#[derive(Serialize)]
struct Person {
    id: usize,
    betas: [f64; 10],
    first: usize,
    joints: Array,
    turns: Array,
    valid: Array,
    keypoints: Array,
    n_views: Array,
    #[serde(skip_serializing_if = "Option::is_none")]
    fingers: Option<Array>,
    repairs: Vec<[usize; 2]>,
}

/// The bytes of the file.
///
/// # Errors
/// See [`Payload::file`].
pub(super) fn motion_bin(session: &Session, reconstruction: &Reconstruction) -> io::Result<Vec<u8>> {
    let mut payload = Payload::default();
    let people = reconstruction
        .motions
        .iter()
        .map(|motion| {
            let path = reconstruction.keypoints.iter().find(|path| path.person == motion.person);
            person(session, reconstruction, motion, path, &mut payload)
        })
        .collect();
    let header = Header {
        format: "wandless.motion",
        version: VERSION,
        name: &session.name,
        fps: session.fps,
        first_frame: session.first_frame,
        n_frames: session.n_frames,
        joint_names: JOINT_NAMES,
        joint_parents: PARENTS,
        keypoint_names: session.convention.names(),
        world: cameras(session, reconstruction),
        body_model: &reconstruction.body_model,
        hands: reconstruction
            .motions
            .iter()
            .any(|motion| motion.hands.is_some())
            .then(|| Hands { wrists: Side::BOTH.map(Side::wrist), parents: std::array::from_fn(finger_parent) }),
        people,
        rejected: rejected(session, reconstruction, &mut payload),
        repaired: reconstruction.repairs.as_ref().map(|repairs| repaired(session, repairs, &mut payload)),
    };
    payload.file(&header)
}

fn person(
    session: &Session,
    reconstruction: &Reconstruction,
    motion: &BodyMotion,
    path: Option<&JointTrajectory>,
    payload: &mut Payload,
) -> Person {
    let (n_frames, n_keypoints) = (motion.frames.len(), session.convention.names().len());
    // Rows of the trajectory at the motion's frames: either may be longer.
    let row = |i: usize| Some((path?, (motion.first.0 + i).checked_sub(path?.first.0)?));
    let point = |i: usize, k: usize| row(i).and_then(|(path, t)| *path.points.get(t)?.get(k)?);
    let count = |i: usize, k: usize| row(i).and_then(|(path, t)| path.n_views.get(t)?.get(k).copied()).unwrap_or(0);
    let cells = || (0..n_frames).flat_map(|i| (0..n_keypoints).map(move |k| (i, k)));
    let joints = motion.frames.iter().flat_map(|pose| pose.joints.iter().flat_map(|joint| [joint.x, joint.y, joint.z]));
    Person {
        id: motion.person.0,
        betas: motion.betas.map(micro),
        first: motion.first.0,
        joints: payload.f32(&[n_frames, N_JOINTS, 3], joints),
        turns: payload.i16(&[n_frames, N_JOINTS, 4], motion.frames.iter().flat_map(turns)),
        valid: payload.u8(&[n_frames], motion.frames.iter().map(|pose| u8::from(pose.valid))),
        keypoints: payload.f32(
            &[n_frames, n_keypoints, 3],
            cells().flat_map(|(i, k)| point(i, k).map_or([f64::NAN; 3], <[f64; 3]>::from)),
        ),
        n_views: payload.u8(&[n_frames, n_keypoints], cells().map(|(i, k)| count(i, k))),
        fingers: motion.hands.as_ref().map(|hands| fingers(hands, payload)),
        repairs: repairs(session, reconstruction, motion.person),
    }
}

/// Finger joints in the world, m: `[frames, 2, 15, 3]`.
fn fingers(hands: &[HandMotion; 2], payload: &mut Payload) -> Array {
    let [left, right] = hands;
    let frames = left.frames.iter().zip(&right.frames).flat_map(|(left, right)| [left, right]);
    let joints = frames.flat_map(|pose| pose.joints.iter().flat_map(|joint| [joint.x, joint.y, joint.z]));
    payload.f32(&[left.frames.len().min(right.frames.len()), 2, N_FINGER_JOINTS, 3], joints)
}

/// Quaternions `world_from_joint` of all joints, four numbers each; the identity where a pose is not finite.
fn turns(pose: &BodyPose) -> Vec<i16> {
    let mut world_from_joint = pose.rotations;
    for (joint, parent) in PARENTS.iter().enumerate() {
        if let Some(parent) = *parent {
            world_from_joint[joint] = world_from_joint[parent] * pose.rotations[joint];
        }
    }
    let quaternion = |turn| {
        let q = quaternion_xyzw(turn);
        if q.iter().all(|c| c.is_finite()) { q } else { [0.0, 0.0, 0.0, 1.0] }
    };
    world_from_joint.iter().flat_map(quaternion).map(|c| (c * f64::from(i16::MAX)).round() as i16).collect()
}

/// Frames and cameras in which the person's detection has another track number than the person's previous one in that camera,
/// or in which it would have been another person's without the repairs while the previous one would not.
fn repairs(session: &Session, reconstruction: &Reconstruction, person: PersonId) -> Vec<[usize; 2]> {
    let before = reconstruction.repairs.as_ref().map(|repairs| &repairs.identities_before);
    let mut found = Vec::new();
    for (view_index, (view, given)) in session.views.iter().zip(&reconstruction.identities).enumerate() {
        let (mut last_id, mut was_anothers) = (None, false);
        for (frame, (detections, given)) in view.frames.iter().zip(given).enumerate() {
            let Some(own) = given.iter().position(|given| *given == Some(person)) else { continue };
            let track_id = detections.get(own).and_then(|detection| detection.track_id);
            let is_new_id = last_id.is_some() && track_id.is_some() && track_id != last_id;
            let given_before = before.and_then(|views| *views.get(view_index)?.get(frame)?.get(own)?);
            let is_anothers = given_before.is_some_and(|one| one != person);
            if is_new_id || (is_anothers && !was_anothers) {
                found.push([frame, view_index]);
            }
            (last_id, was_anothers) = (track_id.or(last_id), is_anothers);
        }
    }
    found.sort_unstable();
    found
}

fn repaired(session: &Session, repairs: &DetectionRepairs, payload: &mut Payload) -> Array {
    let mut counts = vec![0_u8; session.views.len() * session.n_frames];
    for repair in &repairs.repaired {
        if let Some(count) = counts.get_mut(repair.view * session.n_frames + repair.frame.0) {
            *count = count.saturating_add(1);
        }
    }
    payload.u8(&[session.views.len(), session.n_frames], counts)
}

fn rejected(session: &Session, reconstruction: &Reconstruction, payload: &mut Payload) -> Array {
    let count = |view: usize, frame: usize| {
        let given = reconstruction.identities.get(view).and_then(|frames| frames.get(frame));
        let n = given.map_or(0, |given| given.iter().filter(|given| given.is_none()).count());
        u8::try_from(n).unwrap_or(u8::MAX)
    };
    let cells = (0..session.views.len()).flat_map(|view| (0..session.n_frames).map(move |frame| count(view, frame)));
    payload.u8(&[session.views.len(), session.n_frames], cells)
}
