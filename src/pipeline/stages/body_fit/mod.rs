//! Shape and pose of each person: the articulated fit.
//!
//! Per person one shape, per frame a root motion and 21 joint rotations, and for the session what its detector means by
//! its keypoints. In stages, since a fit straight to pixels gets stuck (method.md 15): a closed-form start, then the
//! triangulated points (of a single view: those that `one_view` gives a depth), then the detected pixels, then pixels
//! with the detector's offsets released.

mod accelerations;
mod border_jacobian;
mod contacts;
mod evidence;
mod habits;
mod initial_motion;
mod local_fit;
mod motion_problem;
mod motion_system;
mod one_view;
mod paces;
mod place_cost;
mod separation;
mod session_offsets;
mod solve;
mod statures;
mod steady_places;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod tests_simulated;

use crate::body::BodyModel;
use crate::body::anthropometry::N_BETAS;
use crate::body::detector_noise::DetectorNoise;
use crate::body::kinematics::{Pose, landmark_position, posed};
use crate::body::model::Betas;
use crate::body::skeleton::KeypointConvention;
use crate::geometry::Rigid;
use crate::progress::{Canceled, Progress};
use crate::residuals::pose_likelihood::PoseWeights;
use crate::session::people::BodyPose;
use crate::session::reconstruction::{KeypointBias, PenetrationReport, StageReport};
use crate::session::{BodyMotion, FrameIndex, JointTrajectory, PersonTrack, Session};
use evidence::{Evidence, gather_evidence};
use habits::habits;
use nalgebra::Vector3;
use rayon::prelude::*;
use separation::{PlacedFit, separate};
use serde::{Deserialize, Serialize};
use solve::{FittedMotion, Stages, StartedMotion, finish_motion, start_motion};
pub use statures::fitted_statures;
use std::collections::BTreeMap;

/// What the fit reads.
#[derive(Debug, Clone, Copy)]
pub struct BodyFitInput<'a> {
    /// The detections.
    pub session: &'a Session,
    /// How far the detector errs.
    pub noise: &'a DetectorNoise,
    /// `camera_from_world` by view, metres; `None` where a camera could not be placed.
    pub cameras: &'a [Option<Rigid>],
    /// Which detections show whom.
    pub tracks: &'a [PersonTrack],
    /// Triangulated keypoints, metres; found by person, in any order.
    pub points: &'a [JointTrajectory],
    /// The upright in the world: what people lean about where a single view does not show how far.
    pub up: Vector3<f64>,
}

/// Every number of the fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BodyFitConfig {
    /// Standard deviation of a triangulated keypoint about the body's landmark, m per axis.
    pub point_sigma: f64,
    /// Bounds of a detector's standard deviation per axis as a share of the person's apparent size; within them it is
    /// measured on the person's own residuals after the fit to points.
    pub pixel_share: [f64; 2],
    /// Numbers that a frame's pixels settle: half of a pose's 69, the rest comes from the frames around it.
    pub unknowns_per_frame: f64,
    /// Residuals of this many standard deviations count half as much as they would: the scale of Geman-McClure's cost.
    pub robust_scale: f64,
    /// Size of the pelvis's accelerations at its typical pace, m/s^2.
    pub translation_acceleration: f64,
    /// Size of the joints' angular accelerations at their typical paces over those of the table of joint ranges.
    pub angular_acceleration_factor: f64,
    /// Whether what is known of human motion is used: poses that people take instead of each joint's own rest, feet that stand
    /// still, and accelerations that grow with the pace.
    pub motion_prior: bool,
    /// Whether it only refines a motion that was fitted to what was seen alone. From a rough start it draws limbs that a single
    /// view sees to the wrong side of where they are in depth.
    pub prior_comes_last: bool,
    /// How firmly poses are held to those that people take.
    pub pose_weights: PoseWeights,
    /// Size of the ankles' accelerations in the world at their typical pace, m/s^2.
    pub ankle_acceleration: f64,
    /// Accelerations below this share of their size cost their square, those above it grow linearly: they are spread as
    /// Laplace's law has it, mostly next to nothing and large at contacts.
    pub acceleration_knee: f64,
    /// Weight of the pull towards the natural rest pose.
    pub rest_weight: f64,
    /// Weight of the betas' prior against one frame's evidence.
    pub shape_prior: f64,
    /// Width of the walls at the ends of the joints' ranges, degrees.
    pub limit_width_deg: f64,
    /// Whether bodies give way to each other.
    pub keep_apart: bool,
    /// Standard deviation of the distance between two bodies' capsules where they touch, m.
    pub contact_sigma: f64,
    /// Giving way is refuted where it raises the cost of what was seen by more than the first of these per frame of the contact
    /// and by more than the second in sum (halves of squared standard deviations).
    pub contact_refuted: [f64; 2],
    /// Frames in a gap without sight of the person longer than this are carried, but not valid, s.
    pub gap_limit_secs: f64,
    /// Frames solved at once; longer takes are cut into such windows, their shape taken from the best of them.
    pub window_frames: usize,
    /// Frames that a window sees beyond its own on each side.
    pub halo_frames: usize,
    /// Whether the detector's offsets are estimated.
    pub detector_offsets: bool,
    /// Most frames of one person, and of all together, that the estimate of the offsets looks at.
    pub offset_frames: [usize; 2],
    /// Most iterations on points, and on pixels.
    pub max_iterations: [usize; 2],
    /// A step that lowers the cost by less than this share is the last.
    pub min_decrease: f64,
}

impl Default for BodyFitConfig {
    fn default() -> Self {
        Self {
            // Detector noise of 5 px at 4 m, seen from a few sides, and the body's own misfit.
            point_sigma: 0.03,
            // 0.4 % is better than any detector; above 4 % a keypoint is a guess.
            pixel_share: [0.004, 0.04],
            unknowns_per_frame: 34.0,
            // On the simulated captures 4 beats 3 (17.1 -> 16.1 mm on `hard`) and 2.2 (20.5 mm).
            robust_scale: 4.0,
            // Laplace's scale is then twice the typical accelerations of the table of joint ranges and three times the pelvis's
            // median of 1.5 m/s^2; the knee lies at a seventh and a fifth of them. With the knee at one and a half times, all
            // was worse: `hard` 17.1 against 16.5 mm, `paper` 10.3 against 10.0, two views 26.8 against 25.5; jitter 1.2, 1.4
            // and 1.05 of the truth against 0.96, 1.19, 0.95.
            translation_acceleration: 1.2,
            angular_acceleration_factor: 0.52,
            acceleration_knee: 0.25,
            motion_prior: true,
            // `paper` cut to two views, mean of ten: 16.9 mm, 17.8 with the prior from the start, 17.2 without it.
            prior_comes_last: true,
            // Two new poses a second, at 30 frames a second. `hard` (10 seeds) 17.2 mm with it and with half of it, 17.5 without
            // the prior; `paper` 9.3 and 9.6; two views (5 seeds) 17.9 with half, 17.8 with one and a half times, 18.2 with
            // 4.5 times of it.
            pose_weights: PoseWeights { weight: 1.0 / 15.0, knee: 2.0 },
            // Half of the pelvis's: jitter over the truth's on `hard` and `paper` is 0.93 and 1.01 with it (1.13 and 1.35 without
            // the term), 0.96 and 1.04 with the pelvis's, with which joints come 0.4 % worse.
            ankle_acceleration: 0.6,
            // One frame's pull is then a hundredth of one keypoint's at the end of its bone.
            rest_weight: 0.1,
            shape_prior: 1.0,
            limit_width_deg: 5.0,
            keep_apart: true,
            // As well as the capsules know the skin at rest. With 10 mm dancers stay 72 mm deep in each other (94 mm before),
            // with 5 mm 20 to 30 mm; with 2.5 mm 13 mm, but joints come 3 % off instead of 1 %.
            contact_sigma: 0.005,
            // Dancers who touch give way at 0 to 2 a frame, and at 60 at most in sum; people who were simulated walking through
            // each other would have to at 2 to 9 a frame, 500 to 1,000 in sum. Errors are alike over some ten frames: 200
            // are 20 independent ones.
            contact_refuted: [1.0, 200.0],
            gap_limit_secs: 0.5,
            // Some 70 MB a window; the factor of a frame is 0.12 MB.
            window_frames: 480,
            halo_frames: 30,
            detector_offsets: true,
            // Six seconds of walking or talking turn every limb; offsets are shared, so that more people need less of each.
            offset_frames: [180, 360],
            max_iterations: [6, 8],
            min_decrease: 2e-3,
        }
    }
}

impl BodyFitConfig {
    /// The same for the first fit: without the motion prior where that comes last.
    fn as_seen(&self) -> Self {
        Self { motion_prior: self.motion_prior && !self.prior_comes_last, ..self.clone() }
    }

    /// For a session of a single camera.
    pub fn one_view() -> Self {
        Self {
            // A limb that points at the camera looks as short as a short limb does: under the usual prior people shrink, one of
            // twenty by a third. On ten simulated captures 113 mm with 1, 84 with 10, 79 with 30, 83 with 300, 85 with 3000.
            shape_prior: 30.0,
            // What one ray leaves open, depth, stays open from frame to frame: on the same captures 72.3 mm with 0.1, 70.9 with
            // 0.3 (55.0 instead of 58.7 after Procrustes alignment), 71.7 with 1.
            pose_weights: PoseWeights { weight: 0.3, ..Self::default().pose_weights },
            // What was seen is half of what is needed: 69.0 mm so, 70.7 the other way.
            prior_comes_last: false,
            // The detector's habits cannot be told from poses.
            detector_offsets: false,
            // Fewer equations than unknowns: what they leave tells nothing of their errors. On four captures 72.9 mm so, 77.9
            // with the most that is allowed.
            unknowns_per_frame: 0.0,
            ..Self::default()
        }
    }
}

/// Everybody's bodies, and how they were found.
#[derive(Debug, Clone)]
pub struct FittedBodies {
    /// One motion per track for which the trunk was triangulated at least once, in the order of the tracks; a motion
    /// covers its track's frames without holes.
    pub motions: Vec<BodyMotion>,
    /// The model that was fitted: its landmarks lie where the session's detector has them, if that was applied.
    pub detector_model: BodyModel,
    /// What the detector means by its keypoints; empty where it was not asked for.
    pub detector: KeypointBias,
    /// How far bodies reach into each other.
    pub penetration: PenetrationReport,
    /// Figures.
    pub report: StageReport,
}

/// Fits every person's body. The same input gives the same bytes whatever the thread count.
///
/// # Errors
/// [`Canceled`] once the caller has asked the work to stop.
pub fn fit_bodies(
    input: BodyFitInput,
    model: &BodyModel,
    config: &BodyFitConfig,
    progress: &Progress,
) -> Result<FittedBodies, Canceled> {
    let frame_interval = input.session.frame_interval();
    let as_seen = config.as_seen();
    let stages = Stages { model, config, as_seen: &as_seen, frame_interval, progress };
    let started = started_people(input, &stages)?;
    progress.report(0.5, "bodies fitted one by one");

    let everybody: Vec<&(Evidence, StartedMotion)> = started.iter().flatten().collect();
    let habits = match config.detector_offsets {
        true => habits(&stages, input.session.convention, &everybody)?,
        false => None,
    };
    let has_habits = habits.is_some();
    if has_habits {
        progress.report(0.75, "what the detector means by its keypoints");
    }
    let (detector_model, detector) =
        habits.map_or_else(|| (model.clone(), KeypointBias::default()), |habits| (habits.model, habits.told));
    let stages = Stages { model: &detector_model, ..stages };
    let gap_limit = (config.gap_limit_secs / frame_interval).round() as usize;
    let finish_person = |(track, started): (&PersonTrack, Option<(Evidence, StartedMotion)>)| {
        progress.check()?;
        let Some((evidence, started)) = started else { return Ok(None) };
        let fitted = finish_motion(&stages, &evidence, started, has_habits)?;
        let valid = valid_frames(&evidence, gap_limit);
        Ok(Some(PlacedFit { person: track.person, first: track.first.0, evidence, fitted, valid }))
    };
    let people: Vec<_> = input.tracks.par_iter().zip(started).map(finish_person).collect::<Result<_, Canceled>>()?;
    let mut people: Vec<PlacedFit> = people.into_iter().flatten().collect();
    progress.report(0.9, "bodies fitted to what was seen");
    let penetration = separate(&stages, &mut people, config.keep_apart, input.session.first_frame)?;
    Ok(FittedBodies {
        report: stage_report(&people, input.tracks.len()),
        motions: people.iter().map(|person| body_motion(model, person)).collect(),
        detector,
        detector_model,
        penetration,
    })
}

/// Everybody's first fit, by track.
fn started_people(input: BodyFitInput, stages: &Stages) -> Result<Vec<Option<(Evidence, StartedMotion)>>, Canceled> {
    let start_person = |track: &PersonTrack| {
        stages.progress.check()?;
        let points = input.points.iter().find(|p| p.person == track.person);
        let mut evidence = gather_evidence(input, track, points, stages.model);
        if input.session.views.len() == 1 {
            evidence.points = one_view::lifted(stages.model, &evidence, &input.up, stages.frame_interval);
        }
        Ok(start_motion(stages, &evidence)?.map(|started| (evidence, started)))
    };
    input.tracks.par_iter().map(start_person).collect()
}

fn body_motion(model: &BodyModel, person: &PlacedFit) -> BodyMotion {
    let PlacedFit { fitted, valid, .. } = person;
    let body = model.shaped(&fitted.state.betas);
    let frame = |(pose, valid): (&Pose, &bool)| BodyPose {
        rotations: pose.rotations,
        translation: pose.translation,
        joints: posed(&body, pose).joints,
        valid: *valid,
    };
    let betas: [f64; N_BETAS] = fitted.state.betas.into();
    let frames = fitted.state.poses.iter().zip(valid).map(frame).collect();
    BodyMotion { person: person.person, first: FrameIndex(person.first), betas, frames }
}

/// Whether each frame lies in a gap of at most `limit` unseen frames.
fn valid_frames(evidence: &Evidence, limit: usize) -> Vec<bool> {
    let n_frames = evidence.points.len();
    let mut valid = vec![true; n_frames];
    let mut start = 0;
    for t in 0..=n_frames {
        if t == n_frames || evidence.is_seen(t) {
            if t - start > limit {
                valid[start..t].fill(false);
            }
            start = t + 1;
        }
    }
    valid
}

fn stage_report(people: &[PlacedFit], n_tracks: usize) -> StageReport {
    let fitted: Vec<&FittedMotion> = people.iter().map(|person| &person.fitted).collect();
    let n_frames: usize = fitted.iter().map(|f| f.state.poses.len()).sum();
    let mut metrics = BTreeMap::from([
        ("people".to_owned(), fitted.len() as f64),
        ("people_skipped".to_owned(), (n_tracks - fitted.len()) as f64),
        ("frames".to_owned(), n_frames as f64),
    ]);
    let mut medians: Vec<f64> = fitted.iter().filter_map(|f| f.median_reprojection_px).collect();
    medians.sort_by(f64::total_cmp);
    if let Some(worst) = medians.last() {
        metrics.insert("worst_person_median_reprojection_px".to_owned(), *worst);
        metrics.insert("median_reprojection_px".to_owned(), medians[medians.len() / 2]);
    }
    let converged = fitted.iter().all(|f| f.converged);
    StageReport {
        stage: "body_fit".to_owned(),
        iterations: fitted.iter().map(|f| f.iterations).max().unwrap_or(0),
        cost_before: Some(fitted.iter().map(|f| f.cost_before).sum()),
        cost_after: Some(fitted.iter().map(|f| f.cost_after).sum()),
        termination: if converged { "converged" } else { "iteration limit" }.to_owned(),
        metrics,
    }
}

/// A motion's own estimate of the detector's keypoints.
///
/// `n_views` is zero throughout: the body knows its points also where no view sees them. Keypoints without a landmark
/// are `None`.
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
