//! Fits to every few frames, from which those between follow.

use crate::body::kinematics::Pose;
use crate::body::skeleton::N_JOINTS;
use crate::geometry::rotation;
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
        let turn = |joint: usize| rotation::log(&(before.rotations[joint].transpose() * after.rotations[joint]));
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

#[cfg(test)]
mod tests {
    use super::*;

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
