//! `easymocap/`: `intri.yml`, `extri.yml`, and per frame `smpl/<frame>.json` and `keypoints3d/<frame>.json`, as EasyMocap writes them.
//!
//! `[{id, Rh [1][3], Th [1][3], poses [1][72], shapes [1][10]}]`: EasyMocap poses the body without a root rotation, then
//! rotates and translates all of it, `x = R(Rh) x_posed + Th`. SMPL rotates about the rest pelvis J_0, hence `Th = T + J_0 -
//! R(Rh) J_0`. A person is listed only in the frames in which a camera detected them.
//!
//! `[{id, keypoints3d [n][4]}]`: the detector's own keypoints in the session's order, x, y, z and a confidence, 1 where the point is
//! known; an unknown one is four zeros, as in EasyMocap. A person is listed in the frames in which a point is known.
//!
//! Known limits: file names of frames before 0 contain a minus sign; EasyMocap's programs expect its order of 25 points, which other
//! conventions of the session do not have.

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

#[derive(Serialize)]
struct PersonKeypoints {
    id: usize,
    keypoints3d: Vec<[f64; 4]>,
}

/// Writes the folder.
pub(super) fn write(files: &mut ResultFiles, take: &Take) -> io::Result<()> {
    opencv_yaml::write(files, take, "easymocap/")?;
    for (frame, people) in &bodies(take) {
        files.json(&format!("easymocap/smpl/{frame:06}.json"), people)?;
    }
    for (frame, people) in &keypoints(take) {
        files.json(&format!("easymocap/keypoints3d/{frame:06}.json"), people)?;
    }
    Ok(())
}

/// An empty list per frame of the take: EasyMocap counts files.
fn empty_frames<T>(take: &Take) -> BTreeMap<i64, Vec<T>> {
    (0..take.n_frames).map(|i| (take.frame_number(i), Vec::new())).collect()
}

fn bodies(take: &Take) -> BTreeMap<i64, Vec<Person>> {
    let mut frames = empty_frames(take);
    for motion in &take.motions {
        let rest_pelvis = rest_joints(motion)[0];
        for (i, pose) in motion.frames.iter().enumerate().filter(|(_, pose)| pose.valid) {
            let of_frame = frames.entry(take.frame_number(motion.first.0 + i)).or_default();
            of_frame.push(person(motion.person.0, &motion.betas, pose, &rest_pelvis));
        }
    }
    frames
}

fn keypoints(take: &Take) -> BTreeMap<i64, Vec<PersonKeypoints>> {
    let mut frames = empty_frames(take);
    for motion in &take.motions {
        let known = |points: &[Option<Vector3<f64>>]| points.iter().any(Option::is_some);
        for (i, points) in take.keypoints_of(motion).enumerate().filter(|(_, points)| known(points)) {
            let of_frame = frames.entry(take.frame_number(motion.first.0 + i)).or_default();
            let keypoints3d = points.iter().map(|point| match point.map(|point| point.map(micro)) {
                Some(point) => [point.x, point.y, point.z, 1.0],
                None => [0.0; 4],
            });
            of_frame.push(PersonKeypoints { id: motion.person.0, keypoints3d: keypoints3d.collect() });
        }
    }
    frames
}

fn person(id: usize, betas: &[f64; 10], pose: &BodyPose, rest_pelvis: &Vector3<f64>) -> Person {
    let mut angles: Vec<f64> = axis_angles(pose).into_iter().map(micro).collect(); // [72]
    let turn = [angles[0], angles[1], angles[2]];
    angles[..3].fill(0.0);
    let shift = pose.translation + rest_pelvis - pose.rotations[0] * rest_pelvis;
    Person { id, turn: [turn], shift: [[shift.x, shift.y, shift.z].map(micro)], poses: [angles], shapes: [*betas] }
}
