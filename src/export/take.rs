//! The input of the format writers: cameras and people on one time line, as the JSON files of the result hold them.
//!
//! A take is converted from a reconstruction or read back from a finished result ([`super::read_take`]); both give the same
//! numbers, so that a format written later has the same bytes.

use super::files::micro;
use crate::body::skeleton::{N_JOINTS, PARENTS};
use crate::geometry::{Intrinsics, Rigid, rotation};
use crate::session::reconstruction::BodyModelId;
use crate::session::recording::UpAxis;
use crate::session::{BodyMotion, Reconstruction, Session};
use nalgebra::{Matrix3, Vector3};

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
    /// The body model that the motions' betas refer to.
    pub body_model: BodyModelId,
    /// Motions of all people; every number is finite.
    pub motions: Vec<BodyMotion>,
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

    /// The take in a world with `up_axis` up.
    pub fn with_up_axis(&self, up_axis: UpAxis) -> Take {
        let target_from_world = rotation_between(up_axis, self.up_axis);
        let mut take = Take { up_axis, ..self.clone() };
        for camera in &mut take.cameras {
            camera.camera_from_world.rotation *= target_from_world.transpose();
        }
        for pose in take.motions.iter_mut().flat_map(|motion| &mut motion.frames) {
            // SMPL rotates about the rest pelvis J_0 and adds the translation: J_0 = p_0 - T is constant, p_0 is rotated.
            let rest_pelvis = pose.joints[0] - pose.translation;
            pose.rotations[0] = target_from_world * pose.rotations[0];
            pose.joints = pose.joints.map(|joint| target_from_world * joint);
            pose.translation = pose.joints[0] - rest_pelvis;
        }
        take
    }
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
        carry_over_non_finite(motion)
    };
    take.motions = reconstruction.motions.iter().filter_map(rounded).collect();
    take
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
        }
    }
    motion.betas = motion.betas.map(|beta| if beta.is_finite() { beta } else { 0.0 });
    Some(motion)
}

/// Joints of the person in SMPL's rest pose, y up, m: `J_0 = p_0 - T`, `J_j = J_par + G_par^T (p_j - p_par)`, mean over the
/// frames.
pub(super) fn rest_joints(motion: &BodyMotion) -> [Vector3<f64>; N_JOINTS] {
    let mut offsets = [Vector3::zeros(); N_JOINTS];
    for pose in &motion.frames {
        let mut world_from_joint = pose.rotations;
        offsets[0] += pose.joints[0] - pose.translation;
        for (j, parent) in PARENTS.iter().enumerate() {
            if let Some(p) = *parent {
                offsets[j] += world_from_joint[p].transpose() * (pose.joints[j] - pose.joints[p]);
                world_from_joint[j] = world_from_joint[p] * pose.rotations[j];
            }
        }
    }
    let n_frames = motion.frames.len().max(1) as f64;
    let mut rest = offsets.map(|sum| sum / n_frames);
    for (j, parent) in PARENTS.iter().enumerate() {
        if let Some(p) = *parent {
            rest[j] += rest[p];
        }
    }
    rest
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
