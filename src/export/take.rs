//! The input of the format writers: cameras and people on one time line, as the JSON files of the result hold them.
//!
//! A take is converted from a reconstruction or read back from a finished result ([`super::read_take`]); both give the same
//! numbers, so that a format written later has the same bytes.

use super::files::micro;
use super::people::millimetres;
use super::skin::free_body;
use crate::body::BodyModel;
use crate::geometry::{Intrinsics, Rigid, rotation};
use crate::session::people::BodyPose;
use crate::session::reconstruction::BodyModelId;
use crate::session::recording::UpAxis;
use crate::session::{BodyMotion, PersonId, Reconstruction, Session};
use nalgebra::{Matrix3, Vector3};
use std::collections::BTreeMap;

/// Cameras and people of a result. World: right-handed, metres.
#[derive(Debug, Clone, PartialEq)]
pub struct Take {
    /// Name of the session, for display.
    pub name: String,
    /// Frames per second.
    pub fps: f64,
    /// Frame number of frame index 0.
    pub first_frame: i64,
    /// Number of frames of the time line.
    pub n_frames: usize,
    /// Up axis of the world.
    pub up_axis: UpAxis,
    /// Cameras with a solved pose, in the session's order.
    pub cameras: Vec<TakeCamera>,
    /// Names of the other cameras.
    pub unsolved: Vec<String>,
    /// Motions of all people; every number is finite, and every motion has a frame.
    pub motions: Vec<BodyMotion>,
    /// Names of the people that have one.
    pub names: BTreeMap<PersonId, String>,
    /// Names of the detector's keypoints.
    pub keypoint_names: Vec<String>,
    /// The detector's own keypoints in space by person and frame index, world metres: `None` where a point is unknown. Frames
    /// without any point are left out.
    pub keypoints: BTreeMap<PersonId, KeypointFrames>,
    /// The body model that the motions refer to.
    pub body_model: BodyModelId,
    /// That model, where its mesh may be exported: the default body, or one that the caller holds ([`Take::with_body`]).
    pub body: Option<BodyModel>,
}

/// Points by frame index and keypoint.
pub type KeypointFrames = BTreeMap<usize, Vec<Option<Vector3<f64>>>>;

/// A body model that is not the one of a take.
#[derive(Debug, thiserror::Error)]
#[error("the body has the digest {found}, the result was solved with {expected} ({name}); pass that body's file")]
pub struct OtherBody {
    /// Name of the result's body model.
    pub name: String,
    /// Its digest.
    pub expected: String,
    /// Digest of the given body.
    pub found: String,
}

/// A camera with a solved pose.
#[derive(Debug, Clone, PartialEq)]
pub struct TakeCamera {
    /// Its name.
    pub id: String,
    /// Intrinsics of OpenCV's model.
    pub intrinsics: Intrinsics,
    /// Camera pose, metres; OpenCV's axes: x right, y down, z forward.
    pub camera_from_world: Rigid,
}

impl Take {
    /// Frame number of a frame index.
    pub fn frame_number(&self, index: usize) -> i64 {
        self.first_frame.saturating_add_unsigned(index as u64)
    }

    /// First and last frame number of the time line.
    pub fn frame_range(&self) -> [i64; 2] {
        [self.first_frame, self.frame_number(self.n_frames.saturating_sub(1))]
    }

    /// First and last frame number of a motion: the frames in which the person is present.
    pub fn presence(&self, motion: &BodyMotion) -> [i64; 2] {
        let first = motion.first.0;
        [self.frame_number(first), self.frame_number(first + motion.frames.len().saturating_sub(1))]
    }

    /// The person's pose in every frame of the time line: the nearest one in frames in which the person is absent.
    pub fn on_time_line<'a>(&self, motion: &'a BodyMotion) -> impl Iterator<Item = &'a BodyPose> {
        let last = motion.frames.len().saturating_sub(1);
        let first = motion.first.0;
        (0..self.n_frames).filter_map(move |index| motion.frames.get(index.saturating_sub(first).min(last)))
    }

    /// Index of [`Self::on_time_line`]'s pose in the motion, for every frame of the time line.
    pub(super) fn frames_on_time_line(&self, motion: &BodyMotion) -> impl Iterator<Item = usize> {
        let (first, last) = (motion.first.0, motion.frames.len().saturating_sub(1));
        (0..self.n_frames).map(move |index| index.saturating_sub(first).min(last))
    }

    /// The keypoints of a person in every frame of the motion: `names.len()` each, none where the take has none of the person.
    pub fn keypoints_of<'a>(&'a self, motion: &'a BodyMotion) -> impl Iterator<Item = &'a [Option<Vector3<f64>>]> {
        let frames = self.keypoints.get(&motion.person);
        let of_frame = move |i: usize| frames.and_then(|frames| frames.get(&(motion.first.0 + i)));
        (0..motion.frames.len()).map(move |i| of_frame(i).map_or(&[][..], Vec::as_slice))
    }

    /// The take with the mesh of `body`, which the caller may use under its own licence.
    ///
    /// # Errors
    /// [`OtherBody`] where the result was solved with another one; the name does not count.
    pub fn with_body(self, body: BodyModel) -> Result<Self, OtherBody> {
        let body = BodyModel { name: self.body_model.name.clone(), ..body };
        let found = body.sha256();
        if found != self.body_model.sha256 {
            return Err(OtherBody { name: self.body_model.name, expected: self.body_model.sha256, found });
        }
        Ok(Self { body: Some(body), ..self })
    }

    /// The take in a world with `up_axis` up.
    pub fn with_up_axis(&self, up_axis: UpAxis) -> Take {
        let target_from_world = rotation_between(up_axis, self.up_axis);
        let mut take = Take { up_axis, ..self.clone() };
        for camera in &mut take.cameras {
            camera.camera_from_world.rotation *= target_from_world.transpose();
        }
        for point in take.keypoints.values_mut().flat_map(BTreeMap::values_mut).flatten().flatten() {
            *point = target_from_world * *point;
        }
        for pose in take.motions.iter_mut().flat_map(|motion| &mut motion.frames) {
            // SMPL rotates about the rest pelvis J_0 and adds the translation: J_0 = p_0 - T is constant, p_0 is rotated.
            let rest_pelvis = pose.joints[0] - pose.translation;
            pose.rotations[0] = target_from_world * pose.rotations[0];
            pose.joints = pose.joints.map(|joint| target_from_world * joint);
            pose.translation = pose.joints[0] - rest_pelvis;
        }
        let hands = take.motions.iter_mut().flat_map(|motion| motion.hands.iter_mut().flatten());
        for pose in hands.flat_map(|hand| &mut hand.frames) {
            pose.joints = pose.joints.map(|joint| target_from_world * joint);
        }
        take
    }
}

fn names(reconstruction: &Reconstruction) -> BTreeMap<PersonId, String> {
    let people = reconstruction.report.people.iter();
    people.filter_map(|person| Some((PersonId(person.id), person.name.clone()?))).collect()
}

/// Converts a reconstruction: numbers are rounded as in the JSON files, and poses that are not finite are carried over from
/// neighbouring frames.
pub(super) fn take_of(session: &Session, reconstruction: &Reconstruction) -> Take {
    let mut take = Take {
        name: session.name.clone(),
        fps: session.fps,
        first_frame: session.first_frame,
        n_frames: session.n_frames,
        up_axis: reconstruction.up_axis,
        body_model: reconstruction.body_model.clone(),
        cameras: Vec::new(),
        unsolved: Vec::new(),
        motions: Vec::new(),
        names: names(reconstruction),
        keypoint_names: session.convention.names().iter().map(|name| (*name).to_owned()).collect(),
        keypoints: BTreeMap::new(),
        body: free_body(&reconstruction.body_model),
    };
    for (view, solved) in session.views.iter().zip(&reconstruction.cameras) {
        match solved.camera_from_world {
            Some(camera_from_world) => {
                take.cameras.push(TakeCamera {
                    id: view.id.clone(),
                    intrinsics: solved.lens(&view.intrinsics),
                    camera_from_world,
                });
            }
            None => take.unsolved.push(view.id.clone()),
        }
    }
    let rounded = |motion: &BodyMotion| {
        let mut motion = motion.clone();
        motion.betas = motion.betas.map(micro);
        for pose in &mut motion.frames {
            pose.rotations = pose.rotations.map(|r| rotation::exp(&rotation::log(&r).map(micro)));
            pose.translation = pose.translation.map(micro);
            pose.joints = pose.joints.map(|joint| joint.map(micro));
        }
        for pose in motion.hands.iter_mut().flatten().flat_map(|hand| &mut hand.frames) {
            pose.rotations = pose.rotations.map(|r| rotation::exp(&rotation::log(&r).map(micro)));
            pose.joints = pose.joints.map(|joint| joint.map(micro));
        }
        let sigmas = motion.joint_sigmas.iter_mut().flatten();
        sigmas.for_each(|sigmas| *sigmas = millimetres(sigmas).map(|mm| 1e-3 * mm));
        carry_over_non_finite(motion)
    };
    take.motions = reconstruction.motions.iter().filter_map(rounded).collect();
    for path in &reconstruction.keypoints {
        for (i, points) in path.points.iter().enumerate() {
            let points: Vec<_> = points.iter().map(known_point).collect();
            if points.iter().any(Option::is_some) {
                take.keypoints.entry(path.person).or_default().insert(path.first.0 + i, points);
            }
        }
    }
    take
}

/// A point as `keypoints3d.json` has it.
fn known_point(point: &Option<Vector3<f64>>) -> Option<Vector3<f64>> {
    point.filter(|point| point.iter().all(|c| c.is_finite())).map(|point| point.map(micro))
}

/// Replaces every pose that is not finite by the nearest earlier (at the start: later) finite one, marked as not valid;
/// `None` without any finite pose. Betas that are not finite become 0.
pub(super) fn carry_over_non_finite(mut motion: BodyMotion) -> Option<BodyMotion> {
    let finite = |v: &Vector3<f64>| v.iter().all(|c| c.is_finite());
    let usable: Vec<bool> = motion
        .frames
        .iter()
        .map(|pose| {
            let has_finite_rotations = pose.rotations.iter().all(|r| r.iter().all(|c| c.is_finite()));
            has_finite_rotations && finite(&pose.translation) && pose.joints.iter().all(finite)
        })
        .collect();
    let mut source = usable.iter().position(|usable| *usable)?;
    for (t, usable) in usable.into_iter().enumerate() {
        if usable {
            source = t;
        } else {
            motion.frames[t] = motion.frames[source].clone();
            motion.frames[t].valid = false;
            for hand in motion.hands.iter_mut().flatten() {
                hand.frames[t] = hand.frames[source].clone();
            }
        }
    }
    motion.betas = motion.betas.map(|beta| if beta.is_finite() { beta } else { 0.0 });
    Some(motion)
}

/// The rotation `target_from_source` between two worlds given by their up axes: y and z by a quarter turn about x, as
/// modelling programs do; x to y by a cyclic permutation of the axes.
fn rotation_between(target: UpAxis, source: UpAxis) -> Matrix3<f64> {
    let y_from = |axis| match axis {
        UpAxis::X => Matrix3::new(0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0),
        UpAxis::Y => Matrix3::identity(),
        UpAxis::Z => Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0),
    };
    y_from(target).transpose() * y_from(source)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_up_to_up_without_mirroring() {
        let axes = [(UpAxis::X, Vector3::x()), (UpAxis::Y, Vector3::y()), (UpAxis::Z, Vector3::z())];
        for (source, up_in_source) in axes {
            for (target, up_in_target) in axes {
                let rotation = rotation_between(target, source);
                assert_eq!(rotation * up_in_source, up_in_target);
                assert_eq!(rotation.determinant(), 1.0);
            }
        }
        let front = Vector3::new(1.0, 2.0, 3.0);
        assert_eq!(rotation_between(UpAxis::Y, UpAxis::Z) * front, Vector3::new(1.0, 3.0, -2.0));
    }
}
