//! Assembly of the result: cameras and trajectories in the world frame, bodies, fit statistics and verdict.

use super::calibration::{Calibration, TrackedPeople};
use super::capture::Capture;
use super::config::{Extrinsics, IntrinsicsMode, MotionPriorMode, Options};
use super::error::PipelineError;
use super::focal_lengths::{FocalLengths, sigma_angle_by_principal_point};
use super::stages::association::identities;
use super::stages::body_fit::{
    BodyFitConfig, FittedBodies, KnownCameras, fit_bodies, fitted_statures, landmark_trajectory,
};
use super::stages::fit_statistics::{FitStatistics, uncertain_frames};
use super::stages::hand_association::associated_hands;
use super::stages::hand_fit::fit_hands;
use super::stages::joint_trajectories::joint_trajectories;
use super::stages::verdict::input::{FollowedPerson, PoseChange, VerdictInput};
use super::stages::verdict::quality;
use super::stages::world_frame::{World, world};
use super::up_direction::UpRival;
use crate::body::BodyModel;
use crate::body::hand::with_hand_landmarks;
use crate::body::scale::FittedStature;
use crate::geometry::free_network::CameraCovariance;
use crate::geometry::similarity::similarity_from_cameras;
use crate::geometry::{Rigid, Similarity, rotation};
use crate::optim::robust::{INTERVAL_95, median, quantile};
use crate::progress::{Canceled, Progress};
use crate::session::reconstruction::{
    BodyModelId, KeypointBias, LandmarkTableId, PenetrationReport, Report, ScaleReport, SigmaSummary, SolvedCamera,
};
use crate::session::recording::UpAxis;
use crate::session::{BodyMotion, FrameIndex, JointTrajectory, PersonTrack, Reconstruction, Session, Suspicion, View};
use nalgebra::Vector3;
use std::borrow::Cow;

/// Fitted stature of every person if a unit of the calibration is `scale` metres, by track.
pub fn statures(
    capture: &Capture,
    calibration: &Calibration,
    trajectories: &[JointTrajectory],
    scale: f64,
    model: &BodyModel,
    progress: &Progress,
) -> Result<Vec<Option<FittedStature>>, Canceled> {
    let metres_from_units = Similarity { scale, ..Similarity::identity() };
    let (mut cameras, mut points) = (calibration.cameras.clone(), trajectories.to_vec());
    move_into(&metres_from_units, &mut cameras, &mut points);
    fitted_statures(
        &TrackedPeople { cameras: &cameras, ..calibration.people(capture.session, &points) },
        model,
        progress,
    )
}

/// Cameras and trajectories in the result's world.
pub struct Solution {
    calibration: Calibration,
    trajectories: Vec<JointTrajectory>,
    metres_per_unit: f64,
    scale: Option<ScaleReport>,
    heldout_px: Option<f64>,
    suspicions: Vec<Suspicion>,
    up_axis: UpAxis,
    /// From the calibration's world to that of the result.
    world_from_solution: Similarity,
    /// Another way up of the result's world, where that was estimated.
    up_rival: Option<UpRival>,
}

/// A result, and its cameras in the world of the calibration that it was fitted from.
pub struct FittedResult {
    /// The result.
    pub reconstruction: Reconstruction,
    /// Poses of the placed cameras.
    pub cameras: Vec<Rigid>,
    /// Theirs; `None` where they were not adjusted together with bodies, or the session does not determine them.
    pub covariance: Option<CameraCovariance>,
}

impl Solution {
    /// Moves cameras and trajectories into the world that the options choose; given extrinsics keep their world.
    pub fn in_world(
        capture: &Capture,
        mut calibration: Calibration,
        mut trajectories: Vec<JointTrajectory>,
        scale: Option<ScaleReport>,
        heldout_px: Option<f64>,
        suspicions: Vec<Suspicion>,
    ) -> Self {
        let options = capture.options;
        let metres_per_unit = scale.as_ref().map_or(1.0, |s| s.value);
        let given = !capture.estimates_extrinsics();
        let up_axis = if given { capture.session.up_axis.unwrap_or(options.up_axis) } else { options.up_axis };
        let cameras = &calibration.cameras;
        let world = match options.extrinsics {
            Extrinsics::Estimate => Some(world(capture.session, cameras, &trajectories, metres_per_unit, up_axis)),
            Extrinsics::Refine => given_from_solution(capture.session, cameras)
                .map(|world_from_solution| World { world_from_solution, rival: None }),
            Extrinsics::Fixed => None,
        };
        if let Some(World { world_from_solution: by, .. }) = &world {
            move_into(by, &mut calibration.cameras, &mut trajectories);
            calibration.with_bodies = calibration.with_bodies.and_then(|covariance| covariance.moved(by));
        }
        let world_from_solution = world.map_or_else(Similarity::identity, |world| world.world_from_solution);
        let up_rival = world.and_then(|world| world.rival);
        Self {
            calibration,
            trajectories,
            metres_per_unit,
            scale,
            heldout_px,
            suspicions,
            up_axis,
            world_from_solution,
            up_rival,
        }
    }

    /// `camera_from_world` per view, world of the result.
    pub fn cameras(&self) -> &[Option<Rigid>] {
        &self.calibration.cameras
    }

    /// Points of each person, world of the result.
    pub fn trajectories(&self) -> &[JointTrajectory] {
        &self.trajectories
    }

    /// Up axis of the world of the result.
    pub fn up_axis(&self) -> UpAxis {
        self.up_axis
    }

    /// Fits the bodies and assembles the result.
    pub fn with_bodies(
        mut self,
        capture: &Capture,
        focal_lengths: &mut FocalLengths,
        model: &BodyModel,
        progress: &Progress,
    ) -> Result<FittedResult, PipelineError> {
        let tracks = self.calibration.association.tracks.clone();
        let hands = associated_hands(&self.calibration.people(capture.session, &self.trajectories));
        // With every hand at its person and side; without hands the session as it is.
        let observed = hands.as_ref().map_or(capture.session, |hands| &hands.session);
        let input = self.calibration.people(observed, &self.trajectories);
        let is_monocular = capture.session.views.len() == 1;
        let config = if is_monocular { BodyFitConfig::monocular() } else { BodyFitConfig::default() };
        let config = BodyFitConfig {
            resolve_collisions: capture.options.collision,
            motion_prior: capture.options.motion_prior != MotionPriorMode::None,
            completes_gaps: capture.options.motion_prior == MotionPriorMode::Denoiser,
            latent_motions: capture.options.motion_prior == MotionPriorMode::Latent,
            correlated_errors: capture.options.adjust_with_bodies && config.correlated_errors,
            known_cameras: self.known_cameras(capture, focal_lengths),
            sigma_log_scale: self.scale.as_ref().map_or(0.0, sigma_log_scale),
            camera_rounds: self.camera_rounds(capture.options),
            known_covariance: self.calibration.with_bodies.clone(),
            ..config
        };
        // No convention with hands is the base of a dense table.
        let extended = match &capture.session.dense {
            Some(dense) => Some(dense.on(model)),
            None => hands.as_ref().map(|_| with_hand_landmarks(model)),
        };
        let fitted_model = extended.as_ref().unwrap_or(model);
        let FittedBodies {
            mut motions,
            measures,
            detector_model,
            mut detector,
            penetration,
            report,
            cameras,
            camera_covariance,
            focal,
        } = fit_bodies(&input, &self.upright(capture), fitted_model, &config, progress)?;
        if is_monocular {
            detector.reason =
                "a single view cannot separate keypoint bias of the detector from the poses of people".to_owned();
        }
        self.calibration.stages.push(report);
        self.calibration.stages.extend(hands.as_ref().map(|hands| hands.report.clone()));
        let lens_evidence = focal.as_ref().filter(|focal| focal.are_as_given).map(|focal| focal.log_evidence);
        let session = match focal {
            Some(focal) => Cow::Owned(focal_lengths.replace(self.placed_views().zip(focal.factors), observed)),
            None => Cow::Borrowed(observed),
        };
        if let Some(cameras) = cameras {
            self.calibration.take_over(&cameras, camera_covariance.as_ref(), 1.0 / self.metres_per_unit);
            let start = std::mem::take(&mut self.trajectories);
            self.trajectories = joint_trajectories(&self.calibration.people(&session, &start), progress)?;
        }
        let hand_reports =
            fit_hands(&self.calibration.people(&session, &self.trajectories), model, &mut motions, progress)?;
        // A track whose trunk was never triangulated has no body and is left out of the result.
        let kept: Vec<PersonTrack> =
            tracks.into_iter().filter(|t| motions.iter().any(|m| m.person == t.person)).collect();
        self.trajectories.retain(|p| motions.iter().any(|m| m.person == p.person));
        if is_monocular {
            // A single ray has no depth: the points are the body's landmarks.
            for (trajectory, motion) in self.trajectories.iter_mut().zip(&motions) {
                trajectory.points = landmark_trajectory(&detector_model, motion, capture.session.convention).points;
            }
        }
        let shown = TrackedPeople { tracks: &kept, ..self.calibration.people(&session, &self.trajectories) };
        let statistics = FitStatistics::new(&shown, camera_covariance.as_ref());
        let mut report =
            Report { detector, ..self.report(capture, &shown, &motions, &statistics, penetration, lens_evidence) };
        for (person, measures) in report.people.iter_mut().zip(measures) {
            person.body = Some(measures);
        }
        for (person, hands) in report.people.iter_mut().zip(hand_reports) {
            person.hands = hands;
        }
        let mut keypoints = std::mem::take(&mut self.trajectories);
        for (trajectory, motion) in keypoints.iter_mut().zip(&motions) {
            fill_from_body(trajectory, &landmark_trajectory(&detector_model, motion, capture.session.convention));
        }
        let solution_from_world = self.world_from_solution.inverse();
        let placed = self.calibration.cameras.iter().flatten();
        let placed = placed.map(|camera| solution_from_world.move_camera(camera)).collect();
        let reconstruction = Reconstruction {
            cameras: self.solved_cameras(capture.session, &statistics),
            keypoints,
            motions,
            identities: identities(capture.session, &kept),
            up_axis: self.up_axis,
            body_model: BodyModelId { name: model.name.clone(), sha256: model.sha256() },
            repairs: None,
            hand_sources: hands.map(|hands| hands.sources),
            report,
        };
        let covariance = camera_covariance.and_then(|covariance| covariance.moved(&solution_from_world));
        Ok(FittedResult { reconstruction, cameras: placed, covariance })
    }

    /// Indices of the views with a pose.
    fn placed_views(&self) -> impl Iterator<Item = usize> + use<> {
        let is_placed: Vec<bool> = self.calibration.cameras.iter().map(Option::is_some).collect();
        (0..is_placed.len()).filter(move |&view| is_placed[view])
    }

    /// What the session gives of the placed cameras, as far as the options have it refined.
    fn known_cameras(&self, capture: &Capture, refined: &FocalLengths) -> KnownCameras {
        let (options, views) = (capture.options, &capture.session.views);
        let intrinsics = options.intrinsics_of(capture.session);
        let focal_px = || self.placed_views().map(|v| views[v].intrinsics.focal() / refined.factor(v)).collect();
        KnownCameras {
            focal_px: (intrinsics != IntrinsicsMode::Fixed).then(focal_px),
            is_focal_guessed: intrinsics == IntrinsicsMode::Estimate,
            poses: match options.extrinsics {
                Extrinsics::Refine => self.placed_views().map(|view| views[view].camera_from_world).collect(),
                Extrinsics::Estimate | Extrinsics::Fixed => None,
            },
        }
    }

    /// Rounds in which the bodies adjust the cameras.
    ///
    /// The detector's errors are measured on the first fit, then on the adjusted one; a third round changes the cameras by a
    /// tenth of their standard deviation. Cameras that were adjusted with other people start where a first round ends.
    fn camera_rounds(&self, options: &Options) -> usize {
        let is_due = options.adjust_with_bodies
            && options.extrinsics != Extrinsics::Fixed
            && self.calibration.with_bodies.is_none();
        match (is_due, self.calibration.with_other_bodies) {
            (false, _) => 0,
            (true, true) => 1,
            (true, false) => 2,
        }
    }

    /// The upright in the result's world: the up axis. Where extrinsics are given without an up axis and the camera would
    /// lie on its side by it, the camera's own upright: most cameras stand upright.
    fn upright(&self, capture: &Capture) -> Vector3<f64> {
        let axis = self.up_axis.direction();
        let is_known = capture.session.up_axis.is_some() || capture.estimates_extrinsics();
        let of_camera = self.calibration.cameras.iter().flatten().next().map(|c| -c.rotation.row(1).transpose());
        of_camera.filter(|up| !is_known && up.angle(&axis) > MAX_CAMERA_TILT).unwrap_or(axis)
    }

    fn solved_cameras(&self, session: &Session, statistics: &FitStatistics) -> Vec<SolvedCamera> {
        let adjusted = self.calibration.adjusted.as_ref();
        let is_void = |v: usize| self.suspicions.iter().any(|s| s.voids_uncertainty_of(&session.views[v].id));
        let by_lens = |v: usize| {
            let view = &session.views[v];
            if view.has_intrinsics { 0.0 } else { sigma_angle_by_principal_point(&view.intrinsics) }
        };
        let uncertainty = |v: usize| adjusted.and_then(|a| a.cameras[v].uncertainty).filter(|_| !is_void(v));
        self.calibration
            .cameras
            .iter()
            .enumerate()
            .map(|(v, camera)| {
                let (reprojection_px, n_observations) = statistics.of_view(v);
                SolvedCamera {
                    camera_from_world: *camera,
                    reprojection_px,
                    n_observations,
                    sigma_position_mm: uncertainty(v).map(|u| 1e3 * u.sigma_position * self.metres_per_unit),
                    sigma_angle_deg: uncertainty(v).map(|u| u.sigma_angle.hypot(by_lens(v)).to_degrees()),
                    time_offset: None,
                    focal_factor: None,
                }
            })
            .collect()
    }

    /// How far the cameras are from the poses that the session gives.
    fn pose_changes(&self, session: &Session) -> Vec<PoseChange> {
        let cameras = session.views.iter().zip(&self.calibration.cameras);
        let change = |(view, camera): (&View, &Option<Rigid>)| {
            let (given, camera) = (view.camera_from_world?, camera.as_ref()?);
            Some(PoseChange {
                camera: view.id.clone(),
                angle_deg: rotation::angle_between(&given.rotation, &camera.rotation).to_degrees(),
                distance_mm: 1e3 * (given.center() - camera.center()).norm(),
            })
        };
        cameras.filter_map(change).collect()
    }

    fn report(
        &self,
        capture: &Capture,
        tracked: &TrackedPeople,
        motions: &[BodyMotion],
        statistics: &FitStatistics,
        penetration: PenetrationReport,
        lens_evidence: Option<f64>,
    ) -> Report {
        let session = capture.session;
        let geometry = statistics.geometry_report(tracked.points);
        let mut cameras = statistics.camera_reports(tracked);
        self.calibration.excluded.iter().for_each(|&view| cameras[view].excluded = true);
        let mut people = statistics.person_reports(tracked, &capture.bones);
        for ((person, track), motion) in people.iter_mut().zip(tracked.tracks).zip(motions) {
            person.joint_sigma_mm = joint_sigma(motion);
            person.uncertain_frames = uncertain_frames(session, track, motion);
        }
        let without_body: Vec<FollowedPerson> = (self.calibration.association.tracks.iter())
            .filter(|track| motions.iter().all(|motion| motion.person != track.person))
            .map(|track| FollowedPerson {
                id: track.person.0,
                first_frame: session.frame_number(track.first),
                last_frame: session.frame_number(FrameIndex(track.first.0 + track.detections.len().saturating_sub(1))),
            })
            .collect();
        let changes =
            if capture.options.extrinsics == Extrinsics::Refine { self.pose_changes(session) } else { Vec::new() };
        let n_detections: usize = cameras.iter().map(|c| c.n_detections).sum();
        let n_rejected: usize = cameras.iter().map(|c| c.n_rejected_detections).sum();
        let adjusted = self.calibration.adjusted.as_ref();
        let sigmas =
            adjusted.map(|a| a.cameras.iter().filter_map(|c| c.uncertainty).map(|u| u.sigma_angle.to_degrees()));
        let input = VerdictInput {
            fps: session.fps,
            cameras: &cameras,
            people: &people,
            without_body: &without_body,
            geometry: &geometry,
            scale: self.scale.as_ref(),
            penetration: &penetration,
            resolves_collisions: capture.options.collision,
            explained: self.calibration.association.explained,
            sigma_angle_deg: sigmas.and_then(|s| s.reduce(f64::max)),
            rival_explained: self.calibration.rival_explained,
            suspicions: &self.suspicions,
            lens_evidence,
            estimated: capture.estimates_extrinsics(),
            changes: &changes,
            up_rival: self.up_rival,
        };
        Report {
            stages: self.calibration.stages.clone(),
            quality: quality(&input),
            cameras,
            people,
            geometry,
            heldout_px: self.heldout_px,
            suspicions: self.suspicions.clone(),
            scale: self.scale.clone(),
            landmarks: session.dense.as_ref().map(|dense| LandmarkTableId::of(dense, session.convention)),
            detector: KeypointBias::default(),
            consistency: None,
            penetration,
            rejected_detections: n_rejected as f64 / n_detections.max(1) as f64,
            keypoints_from: match session.views.len() {
                1 => "body landmarks",
                _ => "adjusted points; body landmarks where no view saw the point",
            }
            .to_owned(),
        }
    }
}

/// A camera whose own upright is further than this from the up axis looks steeply down, or the axis is wrong, rad.
const MAX_CAMERA_TILT: f64 = 1.05; // 60 degrees

/// From a world in which cameras were refined to that of the given ones, whose place and scale their adjustment does not keep;
/// `None` with a single camera.
fn given_from_solution(session: &Session, cameras: &[Option<Rigid>]) -> Option<Similarity> {
    let pairs = session.views.iter().zip(cameras).filter_map(|(view, solved)| Some((solved.as_ref()?, view)));
    let (solved, given): (Vec<Rigid>, Vec<Rigid>) =
        pairs.filter_map(|(solved, view)| Some((*solved, view.camera_from_world?))).unzip();
    similarity_from_cameras(&solved, &given).ok()
}

/// Moves cameras and points by a similarity.
fn move_into(world_from_solution: &Similarity, cameras: &mut [Option<Rigid>], trajectories: &mut [JointTrajectory]) {
    for camera in cameras.iter_mut().flatten() {
        *camera = world_from_solution.move_camera(camera);
    }
    for point in trajectories.iter_mut().flat_map(|p| p.points.iter_mut().flatten()).flatten() {
        *point = world_from_solution.transform(point);
    }
}

/// Over all joints and valid frames, mm.
fn joint_sigma(motion: &BodyMotion) -> Option<SigmaSummary> {
    let frames = motion.frames.iter().zip(motion.joint_sigmas.as_ref()?).filter(|(pose, _)| pose.valid);
    let mut sigmas: Vec<f64> = frames.flat_map(|(_, sigmas)| sigmas.map(|sigma| 1e3 * sigma)).collect();
    Some(SigmaSummary { median: median(&mut sigmas)?, p95: quantile(&mut sigmas, 0.95)? })
}

/// Replaces points that no view saw by the body's landmarks, which are more accurate than an interpolated trajectory.
fn fill_from_body(trajectory: &mut JointTrajectory, body: &JointTrajectory) {
    for k in 0..trajectory.points.first().map_or(0, Vec::len) {
        for t in 0..trajectory.points.len() {
            if trajectory.points[t][k].is_none() || trajectory.n_views[t][k] == 0 {
                trajectory.points[t][k] = body.points.get(t).and_then(|p| p[k]).or(trajectory.points[t][k]);
            }
        }
    }
}

/// Standard deviation of the scale's logarithm.
fn sigma_log_scale(scale: &ScaleReport) -> f64 {
    let [low, high] = scale.interval95;
    (high / low).ln() / (2.0 * INTERVAL_95)
}
