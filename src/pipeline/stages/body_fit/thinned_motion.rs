//! Fits to every few frames, from which those between follow.

use crate::body::kinematics::Pose;
use crate::body::skeleton::N_JOINTS;
use crate::geometry::rotation;
use crate::motion_prior::interpolation::{grid_place, interpolate, interpolate_positions};
use nalgebra::Vector3;

/// Time between the frames of fits from a rough start, s: people accelerate little within it, and the fits to all frames go on
/// from where these end.
const FRAME_SECS: f64 = 0.1;

/// Every how many frames a fit from a rough start takes one; `frame_interval`: s.
pub(super) fn rough_stride(frame_interval: f64) -> usize {
    ((FRAME_SECS / frame_interval).round() as usize).max(1)
}

/// Moves every `stride`-th pose to `adjusted`, and those between by what their neighbours moved, weighted linearly.
pub(super) fn carry_along(poses: &mut [Pose], adjusted: &[Pose], stride: usize) {
    let moved = |(before, after): (&Pose, &Pose)| {
        let turn = |joint: usize| rotation::step(&before.rotations[joint], &after.rotations[joint]);
        (after.translation - before.translation, std::array::from_fn(turn))
    };
    let moved: Vec<(Vector3<f64>, [Vector3<f64>; N_JOINTS])> =
        poses.iter().step_by(stride).zip(adjusted).map(moved).collect();
    for (t, pose) in poses.iter_mut().enumerate() {
        let (k, part) = (t / stride, (t % stride) as f64 / stride as f64);
        let ((shift, turns), (next_shift, next_turns)) = (&moved[k], &moved[(k + 1).min(moved.len() - 1)]);
        pose.translation += shift.lerp(next_shift, part);
        for ((turned, turn), next) in pose.rotations.iter_mut().zip(turns).zip(next_turns) {
            *turned *= rotation::exp(&turn.lerp(next, part));
        }
    }
}

/// Makes `poses` the motion through `fitted`, poses of every `stride`-th frame. What a start in closed form has between them is as
/// rough as that start is, and the next fit spends its steps on it. Frames after the last fitted one move as that did.
pub(super) fn lead_through(poses: &mut [Pose], fitted: &[Pose], stride: usize) {
    let Some(last) = fitted.len().checked_sub(1) else { return };
    for (t, pose) in poses[..last * stride].iter_mut().enumerate() {
        let place = grid_place(t as f64 / stride as f64, fitted.len());
        let samples = place.samples.map(|k| &fitted[k]);
        let turned = |joint: usize| interpolate(&samples.map(|pose| pose.rotations[joint]), place.share);
        pose.rotations = std::array::from_fn(turned);
        pose.translation = interpolate_positions(&samples.map(|pose| pose.translation), place.share);
    }
    carry_along(&mut poses[last * stride..], &fitted[last..], stride);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A steady motion continues through frames that were not fitted, whatever they were before.
    #[test]
    fn a_fitted_motion_leads_through_the_frames_between() {
        let pose = |t: usize| {
            let mut pose = Pose::rest();
            pose.rotations[4] = rotation::exp(&Vector3::new(0.1 * t as f64, 0.0, 0.0));
            pose.translation = Vector3::new(0.02 * t as f64, 0.9, 0.0);
            pose
        };
        let fitted: Vec<Pose> = (0..11).step_by(3).map(pose).collect();
        let mut poses: Vec<Pose> = (0..11).map(|t| if t == 4 { Pose::rest() } else { pose(t) }).collect();
        lead_through(&mut poses, &fitted, 3);
        for (t, found) in poses.iter().enumerate().filter(|(t, _)| (3..6).contains(t) || *t > 8) {
            assert!((found.rotations[4] - pose(t).rotations[4]).norm() < 1e-12, "frame {t}");
            assert!((found.translation - pose(t).translation).norm() < 1e-12, "frame {t}");
        }
        lead_through(&mut [], &[], 3);
    }

    /// A motion that is turned and moved as a whole stays one: frames between adjusted ones follow.
    #[test]
    fn frames_between_adjusted_ones_are_carried_along() {
        let pose = |t: usize, turn: f64, shift: f64| {
            let mut pose = Pose::rest();
            pose.rotations[4] = rotation::exp(&Vector3::new(0.1 * t as f64, 0.0, 0.0));
            pose.rotations[4] *= rotation::exp(&Vector3::new(0.0, turn, 0.0));
            pose.translation = Vector3::new(0.02 * t as f64 + shift, 0.9, 0.0);
            pose
        };
        let mut poses: Vec<Pose> = (0..8).map(|t| pose(t, 0.0, 0.0)).collect();
        let adjusted: Vec<Pose> = (0..8).step_by(3).map(|t| pose(t, 0.2, 0.05)).collect();
        carry_along(&mut poses, &adjusted, 3);
        for (t, found) in poses.iter().enumerate() {
            let wanted = pose(t, 0.2, 0.05);
            assert!((found.rotations[4] - wanted.rotations[4]).norm() < 1e-12, "frame {t}");
            assert!((found.translation - wanted.translation).norm() < 1e-12, "frame {t}");
        }
    }
}
