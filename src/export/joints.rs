//! `poses3d.json` and `keypoints3d.json`: 3D points of people, frame by frame, world metres.

use super::files::micro_entries;
use crate::body::skeleton::JOINT_NAMES;
use crate::session::recording::UpAxis;
use crate::session::{FrameIndex, Reconstruction, Session};
use nalgebra::Vector3;
use serde::Serialize;
use std::collections::BTreeMap;

/// Points of each person, in order of `joint_names`; null where unknown.
type PointsByPerson = BTreeMap<usize, Vec<Option<[f64; 3]>>>;

/// Content of either file. Frames and people are in order of their numbers.
#[derive(Serialize)]
pub(super) struct Joints {
    joint_names: &'static [&'static str],
    units: &'static str,
    up_axis: UpAxis,
    frames: BTreeMap<i64, PointsByPerson>,
}

/// The content of `poses3d.json`: the body's 24 joints in every frame of a person's motion, including carried poses.
pub(super) fn body_joints(session: &Session, reconstruction: &Reconstruction) -> Joints {
    let mut joints = empty(&JOINT_NAMES, reconstruction.up_axis);
    for motion in &reconstruction.motions {
        for (i, pose) in motion.frames.iter().enumerate() {
            let frame = session.frame_number(FrameIndex(motion.first.0 + i));
            let points = pose.joints.iter().map(written).collect();
            joints.frames.entry(frame).or_default().insert(motion.person.0, points);
        }
    }
    joints
}

/// The content of `keypoints3d.json`: the keypoints, in frames with at least one known point.
pub(super) fn keypoints(session: &Session, reconstruction: &Reconstruction) -> Joints {
    let mut joints = empty(session.convention.names(), reconstruction.up_axis);
    for trajectory in &reconstruction.keypoints {
        for (i, points) in trajectory.points.iter().enumerate() {
            let frame = session.frame_number(FrameIndex(trajectory.first.0 + i));
            let points: Vec<_> = points.iter().map(|point| point.as_ref().and_then(written)).collect();
            if points.iter().any(Option::is_some) {
                joints.frames.entry(frame).or_default().insert(trajectory.person.0, points);
            }
        }
    }
    joints
}

fn empty(joint_names: &'static [&'static str], up_axis: UpAxis) -> Joints {
    Joints { joint_names, units: "m", up_axis, frames: BTreeMap::new() }
}

/// A rounded point; `None` where any coordinate is not finite.
fn written(point: &Vector3<f64>) -> Option<[f64; 3]> {
    point.iter().all(|c| c.is_finite()).then(|| micro_entries(point))
}
