//! Joints that no camera shows for a while, completed by the motion prior from the rest of a fitted motion; and joints that one camera
//! alone shows, which leaves their side in depth open, guided by it.

use super::completed_joints::GapCompletion;
use super::context::FitContext;
use super::gaps::{MIN_GAP, gaps};
use super::observations::Observations;
use super::single_camera::SingleCamera;
use super::terms::unknowns::MotionState;
use crate::body::kinematics::{Pose, landmark_position, moving_joints, posed};
use crate::body::mocap_skeleton::retargeted;
use crate::body::skeleton::{N_JOINTS, PARENTS};
use crate::geometry::rotation::rotation_between;
use crate::motion_prior::MotionPrior;
use crate::motion_prior::chart::LocalRotations;
use crate::motion_prior::grid::at_rate;
use crate::motion_prior::observed::{DESCRIBED_JOINTS, N_DESCRIBED, ObservedMotion, leave_spine_open};
use crate::residuals::rotation_likelihood::RotationGaussian;
use nalgebra::{Matrix3, Vector3};

/// Keypoints nearer to a joint than this tell nothing of its rotation, m: elbows and knees lie 0.2 to 0.45 m from the next
/// joint, and a landmark's own offset from its joint is below 0.1 m.
const MIN_LEVER: f64 = 0.1;

/// What a completion is for, and hence how much of a frame's stated information counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Purpose {
    /// A fit from a rough motion, whose joints are off at the edges of gaps: a bridge that does not hold them there. With a
    /// hundred times this weight an arm that was hidden for 90 frames came out 73 mm off instead of 22.
    FromRough,
    /// A fit from a good motion. What the network states is a whole motion, which the smoothness terms only join to the seen frames.
    FromGood,
    /// Standard deviations.
    Uncertainty,
}

/// Errors of the prior last some ten frames to each side, at 30 frames a second.
pub(super) const INDEPENDENT: f64 = 0.05;

impl Purpose {
    /// Of completed joints.
    fn share(self) -> f64 {
        match self {
            Self::FromRough => 6e-5,
            Self::FromGood => 10.0,
            Self::Uncertainty => INDEPENDENT,
        }
    }

    /// Of guided joints, for which pixels speak as well.
    fn share_of_guided(self) -> f64 {
        if self == Self::FromRough { self.share() } else { INDEPENDENT }
    }
}

/// Completes the joints that no keypoint shows for [`MIN_GAP`] or longer, but some keypoint shows elsewhere in the window, and guides
/// those that one camera alone shows as long; `None` if there are none of either. `alone`: of the same observations.
pub(super) fn completed_gaps(
    context: &FitContext,
    observations: &Observations,
    alone: &SingleCamera,
    state: &MotionState,
    purpose: Purpose,
) -> Option<GapCompletion> {
    let mut sigma = rotation_sigmas(context, observations, state);
    sigma.iter_mut().for_each(leave_spine_open);
    let mut is_completed = vec![[false; N_DESCRIBED]; sigma.len()];
    for described in 0..N_DESCRIBED {
        let seen: Vec<bool> = sigma.iter().map(|row| row[described].is_finite()).collect();
        if !seen.contains(&true) {
            continue;
        }
        for gap in gaps(&seen) {
            let is_long = gap.len() as f64 * context.frame_interval >= MIN_GAP;
            for frame in gap.clone() {
                is_completed[frame][described] = is_long;
                if !is_long {
                    // The first fit's smoothness bridges it well.
                    sigma[frame][described] = sigma[gap.start.saturating_sub(1)][described].min(0.5);
                }
            }
        }
    }
    let is_guided = guided(alone, &mut sigma, context.frame_interval);
    if !is_completed.iter().chain(&is_guided).flatten().any(|is_stated| *is_stated) {
        return None;
    }
    let turns = &context.model.mocap_from_body;
    let up = rotation_between(&context.up, &Vector3::y());
    let motion = ObservedMotion {
        rotations: state.poses.iter().map(|pose| mocap_rotations(&pose.rotations, turns, &up)).collect(),
        pelvis: state.poses.iter().map(|pose| up * pose.translation).collect(),
        sigma,
    };
    let prior = MotionPrior::embedded();
    let found = at_rate(&motion, 1.0 / context.frame_interval, |motion| match purpose {
        Purpose::FromRough => prior.bridged(motion),
        Purpose::FromGood | Purpose::Uncertainty => prior.completed(motion),
    });
    let on_body = |frame: usize, described: usize, share: f64| {
        let joint = DESCRIBED_JOINTS[described];
        let mean = retargeted(&found.rotations[frame][joint], joint, turns);
        let own = turns[joint].tr_mul(&found.precision[frame][described]) * turns[joint] * share;
        (joint, RotationGaussian { mean: if joint == 0 { up.tr_mul(&mean) } else { mean }, precision: own })
    };
    let stated = |wanted: &[[bool; N_DESCRIBED]], share: f64| -> Vec<Vec<(usize, RotationGaussian)>> {
        let of_frame = |(frame, row): (usize, &[bool; N_DESCRIBED])| {
            (0..N_DESCRIBED)
                .filter(|&described| row[described])
                .map(|described| on_body(frame, described, share))
                .collect()
        };
        wanted.iter().enumerate().map(of_frame).collect()
    };
    Some(GapCompletion {
        hidden: stated(&is_completed, purpose.share()),
        guided: stated(&is_guided, purpose.share_of_guided()),
    })
}

/// The joints of bones that one camera alone shows for [`MIN_GAP`] or longer, but several elsewhere in the window, by frame; they become
/// unseen in `sigma`.
fn guided(alone: &SingleCamera, sigma: &mut [[f64; N_DESCRIBED]], frame_interval: f64) -> Vec<[bool; N_DESCRIBED]> {
    let mut is_guided = vec![[false; N_DESCRIBED]; sigma.len()];
    for (described, joint) in DESCRIBED_JOINTS.into_iter().enumerate() {
        let is_sure = |(frame, row): (usize, &[f64; N_DESCRIBED])| {
            row[described].is_infinite() || !alone.shows_bone(frame, joint)
        };
        let sure: Vec<bool> = sigma.iter().enumerate().map(is_sure).collect();
        if !sigma.iter().zip(&sure).any(|(row, sure)| *sure && row[described].is_finite()) {
            continue;
        }
        for run in gaps(&sure).into_iter().filter(|run| run.len() as f64 * frame_interval >= MIN_GAP) {
            for frame in run {
                is_guided[frame][described] = true;
                sigma[frame][described] = f64::INFINITY;
            }
        }
    }
    is_guided
}

/// How well keypoints determine each joint's rotation, rad per axis: keypoints that it moves, each with the error of a
/// triangulated one over its distance from the joint; infinite without one.
fn rotation_sigmas(context: &FitContext, observations: &Observations, state: &MotionState) -> Vec<[f64; N_DESCRIBED]> {
    let model = context.model;
    let body = model.shaped(&state.betas);
    let moving: Vec<Vec<usize>> = model.landmarks.iter().map(moving_joints).collect();
    let of_frame = |(frame, pose): (usize, &Pose)| {
        let skeleton = posed(&body, pose);
        let mut information = [0.0_f64; N_JOINTS];
        for pixel in &observations.pixels[frame] {
            let position = landmark_position(model, &body, &skeleton, pixel.landmark);
            for &joint in &moving[pixel.landmark] {
                let lever = (position - skeleton.joints[joint]).norm();
                if lever > MIN_LEVER {
                    information[joint] += (lever / context.config.point_sigma).powi(2);
                }
            }
        }
        DESCRIBED_JOINTS.map(|joint| information[joint].sqrt().recip())
    };
    state.poses.iter().enumerate().map(of_frame).collect()
}

/// Local rotations of the mocap skeleton in a world with y up, `Q_p R_j Q_j^T`, the inverse of [`retargeted`].
pub(super) fn mocap_rotations(
    rotations: &LocalRotations,
    mocap_from_body: &[Matrix3<f64>; N_JOINTS],
    up: &Matrix3<f64>,
) -> LocalRotations {
    std::array::from_fn(|joint| {
        let parent = PARENTS[joint].map_or(*up, |parent| mocap_from_body[parent]);
        parent * rotations[joint] * mocap_from_body[joint].transpose()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::default_body;
    use crate::geometry::rotation::exp;

    #[test]
    fn rotations_return_from_the_mocap_skeleton() {
        let turns = default_body().mocap_from_body;
        let rotations: LocalRotations = std::array::from_fn(|j| exp(&Vector3::new(0.1 * j as f64, 0.3, -0.2)));
        let there = mocap_rotations(&rotations, &turns, &Matrix3::identity());
        for joint in 0..N_JOINTS {
            assert!((retargeted(&there[joint], joint, &turns) - rotations[joint]).norm() < 1e-12, "{joint}");
        }
    }

    #[test]
    fn gaps_are_the_runs_that_are_not_seen() {
        assert_eq!(gaps(&[false, true, false, false, true]), [0..1, 2..4]);
        assert!(gaps(&[true; 3]).is_empty() && gaps(&[]).is_empty());
    }
}
