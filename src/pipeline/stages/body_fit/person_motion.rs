//! One person's fit on the session's time line, and the motion published from it.

use super::minimisation::FittedMotion;
use super::observations::Observations;
use crate::body::BodyModel;
use crate::body::anthropometry::N_BETAS;
use crate::body::kinematics::{Pose, landmark_position, posed};
use crate::body::model::Betas;
use crate::body::skeleton::KeypointConvention;
use crate::session::people::{BodyPose, JointSigmas};
use crate::session::reconstruction::StageReport;
use crate::session::{BodyMotion, FrameIndex, JointTrajectory, PersonId};
use std::ops::Range;

/// One person's fit on the session's time line.
pub(super) struct PersonFit {
    pub person: PersonId,
    /// Frame index of the session at which the motion begins.
    pub first: usize,
    pub observations: Observations,
    pub fitted: FittedMotion,
    /// By frame; false in gaps that are only interpolated. Such frames take part in no collision.
    pub valid: Vec<bool>,
}

impl PersonFit {
    /// Frames of the session that the motion covers.
    pub(super) fn frames(&self) -> Range<usize> {
        self.first..self.first + self.valid.len()
    }
}

/// Whether each frame is valid: not in a gap of more than `limit` frames without observations.
pub(super) fn valid_frames(observations: &Observations, limit: usize) -> Vec<bool> {
    let n_frames = observations.points.len();
    let mut valid = vec![true; n_frames];
    let mut start = 0;
    for t in 0..=n_frames {
        if t == n_frames || observations.is_seen(t) {
            if t - start > limit {
                valid[start..t].fill(false);
            }
            start = t + 1;
        }
    }
    valid
}

/// The published motion of a fit.
pub(super) fn body_motion(model: &BodyModel, person: &PersonFit, joint_sigmas: Option<Vec<JointSigmas>>) -> BodyMotion {
    let PersonFit { fitted, valid, .. } = person;
    let body = model.shaped(&fitted.state.betas);
    let frame = |(pose, valid): (&Pose, &bool)| BodyPose {
        rotations: pose.rotations,
        translation: pose.translation,
        joints: posed(&body, pose).joints,
        valid: *valid,
    };
    let betas: [f64; N_BETAS] = fitted.state.betas.into();
    let frames = fitted.state.poses.iter().zip(valid).map(frame).collect();
    BodyMotion { person: person.person, first: FrameIndex(person.first), betas, frames, joint_sigmas, hands: None }
}

/// The keypoints of a motion's body, in the order of `convention`, by frame.
///
/// `n_views` is zero throughout: these points are the body's, observed or not. Keypoints without a landmark are `None`.
pub fn landmark_trajectory(model: &BodyModel, motion: &BodyMotion, convention: KeypointConvention) -> JointTrajectory {
    let body = model.shaped(&Betas::from(motion.betas));
    let landmarks = model.landmarks_of(convention);
    let points_of = |frame: &BodyPose| {
        let skeleton = posed(&body, &Pose { rotations: frame.rotations, translation: frame.translation });
        landmarks.iter().map(|l| l.map(|l| landmark_position(model, &body, &skeleton, l))).collect::<Vec<_>>()
    };
    JointTrajectory {
        person: motion.person,
        first: motion.first,
        points: motion.frames.iter().map(points_of).collect(),
        n_views: vec![vec![0; landmarks.len()]; motion.frames.len()],
    }
}

/// Statistics over all persons.
pub(super) fn stage_report(people: &[PersonFit], n_tracks: usize) -> StageReport {
    let fitted: Vec<&FittedMotion> = people.iter().map(|person| &person.fitted).collect();
    let n_frames: usize = fitted.iter().map(|f| f.state.poses.len()).sum();
    let mut metrics = vec![
        ("people", fitted.len() as f64),
        ("people_skipped", (n_tracks - fitted.len()) as f64),
        ("frames", n_frames as f64),
    ];
    let mut medians: Vec<f64> = fitted.iter().filter_map(|f| f.median_reprojection_px).collect();
    medians.sort_by(f64::total_cmp);
    if let Some(worst) = medians.last() {
        metrics.push(("worst_person_median_reprojection_px", *worst));
        metrics.push(("median_reprojection_px", medians[medians.len() / 2]));
    }
    let iterations = fitted.iter().map(|f| f.iterations).max().unwrap_or(0);
    let termination = if fitted.iter().all(|f| f.converged) { "converged" } else { "iteration limit" };
    StageReport {
        cost_before: Some(fitted.iter().map(|f| f.cost_before).sum()),
        cost_after: Some(fitted.iter().map(|f| f.cost_after).sum()),
        ..StageReport::new("body_fit", iterations, termination, metrics)
    }
}
