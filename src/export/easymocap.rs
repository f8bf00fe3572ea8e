//! `easymocap/`: `intri.yml`, `extri.yml`, and per frame `smpl/<frame>.json`, as EasyMocap writes them.
//!
//! `[{id, Rh [1][3], Th [1][3], poses [1][72], shapes [1][10]}]`: EasyMocap poses the body without a root rotation, then
//! rotates and translates all of it, `x = R(Rh) x_posed + Th`. SMPL rotates about the rest pelvis J_0, hence `Th = T + J_0 -
//! R(Rh) J_0`. A person is listed only in the frames in which a camera detected them.
//!
//! Known limit: file names of frames before 0 contain a minus sign.

use super::files::{ResultFiles, micro};
use super::opencv_yaml;
use super::people::axis_angles;
use super::rig::rest_joints;
use super::take::Take;
use crate::session::people::BodyPose;
use nalgebra::Vector3;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io;

#[derive(Serialize)]
struct Person {
    id: usize,
    #[serde(rename = "Rh")]
    turn: [[f64; 3]; 1],
    #[serde(rename = "Th")]
    shift: [[f64; 3]; 1],
    poses: [Vec<f64>; 1],
    shapes: [[f64; 10]; 1],
}

/// Writes the folder.
pub(super) fn write(files: &mut ResultFiles, take: &Take) -> io::Result<()> {
    opencv_yaml::write(files, take, "easymocap/")?;
    // Frames without people have a file with an empty list: EasyMocap counts files.
    let mut frames: BTreeMap<i64, Vec<Person>> =
        (0..take.n_frames).map(|i| (take.frame_number(i), Vec::new())).collect();
    for motion in &take.motions {
        let rest_pelvis = rest_joints(motion)[0];
        for (i, pose) in motion.frames.iter().enumerate().filter(|(_, pose)| pose.valid) {
            let of_frame = frames.entry(take.frame_number(motion.first.0 + i)).or_default();
            of_frame.push(person(motion.person.0, &motion.betas, pose, &rest_pelvis));
        }
    }
    for (frame, people) in &frames {
        files.json(&format!("easymocap/smpl/{frame:06}.json"), people)?;
    }
    Ok(())
}

fn person(id: usize, betas: &[f64; 10], pose: &BodyPose, rest_pelvis: &Vector3<f64>) -> Person {
    let mut angles: Vec<f64> = axis_angles(pose).into_iter().map(micro).collect(); // [72]
    let turn = [angles[0], angles[1], angles[2]];
    angles[..3].fill(0.0);
    let shift = pose.translation + rest_pelvis - pose.rotations[0] * rest_pelvis;
    Person { id, turn: [turn], shift: [[shift.x, shift.y, shift.z].map(micro)], poses: [angles], shapes: [*betas] }
}
