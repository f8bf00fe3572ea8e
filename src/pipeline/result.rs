//! From findings to the result: everything moved into the world, bodies fitted, figures and verdict gathered.

use super::calibration::Calibration;
use super::config::Extrinsics;
use super::stages::association::identities;
use super::stages::body_fit::{
    BodyFitConfig, BodyFitInput, FittedBodies, fit_bodies, fitted_statures, landmark_trajectory,
};
use super::stages::fit_figures::FitFigures;
use super::stages::joint_trajectories::{Hold, TrajectoryConfig, TrajectoryInput, joint_trajectories};
use super::stages::verdict::{Evidence, quality};
use super::stages::world_frame::world_from_solution;
use super::{Capture, PipelineError};
use crate::body::BodyModel;
use crate::body::scale::FittedStature;
use crate::geometry::{Rigid, Similarity};
use crate::progress::{Canceled, Progress};
use crate::session::reconstruction::{BodyModelId, KeypointBias, PenetrationReport, Report, ScaleReport, SolvedCamera};
use crate::session::recording::UpAxis;
use crate::session::{JointTrajectory, PersonTrack, Reconstruction};
use nalgebra::Vector3;

/// Smooth paths of everybody's keypoints under the calibration's cameras.
///
/// # Errors
/// [`Canceled`].
pub fn paths(
    capture: &Capture,
    calibration: &Calibration,
    progress: &Progress,
) -> Result<Vec<JointTrajectory>, Canceled> {
    let input = TrajectoryInput {
        session: capture.session,
        noise: &calibration.noise,
        cameras: &calibration.cameras,
        tracks: &calibration.association.tracks,
        start: &calibration.association.points,
        metres_per_unit: 1.0,
        hold: if capture.session.views.len() == 1 { Hold::OnRay } else { Hold::Whisper },
    };
    joint_trajectories(&input, &TrajectoryConfig::default(), progress)
}

/// How tall everybody is if a unit of the calibration is `scale` metres, by track.
///
/// # Errors
/// [`Canceled`].
pub fn statures(
    capture: &Capture,
    calibration: &Calibration,
    paths: &[JointTrajectory],
    scale: f64,
    model: &BodyModel,
    progress: &Progress,
) -> Result<Vec<Option<FittedStature>>, Canceled> {
    let metres_from_units = Similarity { scale, ..Similarity::identity() };
    let (mut cameras, mut points) = (calibration.cameras.clone(), paths.to_vec());
    move_into(&metres_from_units, &mut cameras, &mut points);
    let input = BodyFitInput {
        session: capture.session,
        noise: &calibration.noise,
        cameras: &cameras,
        tracks: &calibration.association.tracks,
        points: &points,
        up: Vector3::y(), // asked for of a single view alone
    };
    fitted_statures(input, model, progress)
}

/// What was found, in the result's world.
pub struct Findings {
    calibration: Calibration,
    paths: Vec<JointTrajectory>,
    metres_per_unit: f64,
    scale: Option<ScaleReport>,
    heldout_px: Option<f64>,
    up_axis: UpAxis,
}

impl Findings {
    /// Moves cameras and paths into the world that the options ask for; given extrinsics keep theirs.
    pub fn in_world(
        capture: &Capture,
        mut calibration: Calibration,
        mut paths: Vec<JointTrajectory>,
        scale: Option<ScaleReport>,
        heldout_px: Option<f64>,
    ) -> Self {
        let options = capture.options;
        let metres_per_unit = scale.as_ref().map_or(1.0, |s| s.value);
        let given = options.extrinsics != Extrinsics::Estimate;
        let up_axis = if given { capture.session.up_axis.unwrap_or(options.up_axis) } else { options.up_axis };
        if !given {
            let world_from_solution =
                world_from_solution(capture.session, &calibration.cameras, &paths, metres_per_unit, up_axis);
            move_into(&world_from_solution, &mut calibration.cameras, &mut paths);
        }
        Self { calibration, paths, metres_per_unit, scale, heldout_px, up_axis }
    }

    /// Fits bodies and gathers the result.
    ///
    /// # Errors
    /// [`PipelineError::Canceled`].
    pub fn with_bodies(
        mut self,
        capture: &Capture,
        model: &BodyModel,
        progress: &Progress,
    ) -> Result<Reconstruction, PipelineError> {
        let tracks = self.calibration.association.tracks.clone();
        let input = BodyFitInput {
            session: capture.session,
            noise: &self.calibration.noise,
            cameras: &self.calibration.cameras,
            tracks: &tracks,
            points: &self.paths,
            up: self.upright(capture),
        };
        let is_one_view = capture.session.views.len() == 1;
        let config = if is_one_view { BodyFitConfig::one_view() } else { BodyFitConfig::default() };
        let config = BodyFitConfig {
            keep_apart: capture.options.collision,
            motion_prior: capture.options.motion_prior,
            ..config
        };
        let FittedBodies { motions, detector_model, mut detector, penetration, report } =
            fit_bodies(input, model, &config, progress)?;
        if is_one_view {
            detector.reason = "one view does not tell a habit of the detector from how people stand".to_owned();
        }
        self.calibration.stages.push(report);
        // A track whose trunk was never triangulated has no body; such a person is nobody in the result.
        let kept: Vec<PersonTrack> =
            tracks.into_iter().filter(|t| motions.iter().any(|m| m.person == t.person)).collect();
        self.paths.retain(|p| motions.iter().any(|m| m.person == p.person));
        if is_one_view {
            // A single ray tells no depth: the points are the bodies' own.
            for (path, motion) in self.paths.iter_mut().zip(&motions) {
                path.points = landmark_trajectory(&detector_model, motion, capture.session.convention).points;
            }
        }
        let figures =
            FitFigures::new(capture.session, &self.calibration.cameras, &self.calibration.noise, &kept, &self.paths);
        let report = Report { detector, ..self.report(capture, &kept, &figures, penetration) };
        let mut keypoints = std::mem::take(&mut self.paths);
        for (path, motion) in keypoints.iter_mut().zip(&motions) {
            fill_from_body(path, &landmark_trajectory(&detector_model, motion, capture.session.convention));
        }
        Ok(Reconstruction {
            cameras: self.solved_cameras(&figures),
            keypoints,
            motions,
            identities: identities(capture.session, &kept),
            up_axis: self.up_axis,
            body_model: BodyModelId { name: model.name.clone(), sha256: model.sha256() },
            repairs: None,
            report,
        })
    }

    /// The upright in the result's world: the up axis, unless nobody gave one with the given extrinsics and the camera
    /// would lie on its side by it. Cameras stand upright more often than not.
    fn upright(&self, capture: &Capture) -> Vector3<f64> {
        let axis = match self.up_axis {
            UpAxis::X => Vector3::x(),
            UpAxis::Y => Vector3::y(),
            UpAxis::Z => Vector3::z(),
        };
        let is_known = capture.session.up_axis.is_some() || capture.options.extrinsics == Extrinsics::Estimate;
        let of_camera = self.calibration.cameras.iter().flatten().next().map(|c| -c.rotation.row(1).transpose());
        of_camera.filter(|up| !is_known && up.angle(&axis) > MAX_CAMERA_TILT).unwrap_or(axis)
    }

    fn solved_cameras(&self, figures: &FitFigures) -> Vec<SolvedCamera> {
        let uncertainty = |v: usize| self.calibration.adjusted.as_ref().and_then(|a| a.cameras[v].uncertainty);
        self.calibration
            .cameras
            .iter()
            .enumerate()
            .map(|(v, camera)| {
                let (reprojection_px, n_observations) = figures.of_view(v);
                SolvedCamera {
                    camera_from_world: *camera,
                    reprojection_px,
                    n_observations,
                    sigma_position_mm: uncertainty(v).map(|u| 1e3 * u.sigma_position * self.metres_per_unit),
                    sigma_angle_deg: uncertainty(v).map(|u| u.sigma_angle.to_degrees()),
                    time_offset: None,
                    focal_factor: None,
                }
            })
            .collect()
    }

    fn report(
        &self,
        capture: &Capture,
        tracks: &[PersonTrack],
        figures: &FitFigures,
        penetration: PenetrationReport,
    ) -> Report {
        let session = capture.session;
        let cameras = figures.camera_reports(session, &self.calibration.cameras, tracks);
        let people = figures.person_reports(session, &capture.bones, tracks, &self.paths);
        let geometry = figures.geometry_report(&self.paths);
        let n_detections: usize = cameras.iter().map(|c| c.n_detections).sum();
        let n_rejected: usize = cameras.iter().map(|c| c.n_rejected_detections).sum();
        let adjusted = self.calibration.adjusted.as_ref();
        let sigmas =
            adjusted.map(|a| a.cameras.iter().filter_map(|c| c.uncertainty).map(|u| u.sigma_angle.to_degrees()));
        let evidence = Evidence {
            fps: session.fps,
            cameras: &cameras,
            people: &people,
            geometry: &geometry,
            penetration: &penetration,
            gave_way: capture.options.collision,
            explained: self.calibration.association.explained,
            sigma_angle_deg: sigmas.and_then(|s| s.reduce(f64::max)),
            rival_explained: self.calibration.rival_explained,
            estimated: capture.options.extrinsics == Extrinsics::Estimate,
        };
        Report {
            stages: self.calibration.stages.clone(),
            quality: quality(&evidence),
            cameras,
            people,
            geometry,
            heldout_px: self.heldout_px,
            scale: self.scale.clone(),
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

/// A camera whose own upright is further than this from the up axis looks steeply down, or the axis is another's, rad.
const MAX_CAMERA_TILT: f64 = 1.05; // 60 degrees

pub(super) fn move_into(
    world_from_solution: &Similarity,
    cameras: &mut [Option<Rigid>],
    paths: &mut [JointTrajectory],
) {
    for camera in cameras.iter_mut().flatten() {
        *camera = world_from_solution.move_camera(camera);
    }
    for point in paths.iter_mut().flat_map(|p| p.points.iter_mut().flatten()).flatten() {
        *point = world_from_solution.transform(point);
    }
}

/// Where no view saw a point, the body knows better than a path through air.
fn fill_from_body(path: &mut JointTrajectory, body: &JointTrajectory) {
    for k in 0..path.points.first().map_or(0, Vec::len) {
        for t in 0..path.points.len() {
            if path.points[t][k].is_none() || path.n_views[t][k] == 0 {
                path.points[t][k] = body.points.get(t).and_then(|p| p[k]).or(path.points[t][k]);
            }
        }
    }
}
