//! Cameras and persons under them: the state that the passes hand on.

use super::capture::Capture;
use crate::body::detector_noise::DetectorNoise;
use crate::geometry::free_network::CameraCovariance;
use crate::geometry::{Intrinsics, Rigid};
use crate::session::reconstruction::StageReport;
use crate::session::recording::Detection;
use crate::session::{JointTrajectory, PersonTrack, Session, View};
use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Cameras and the association of detections under them.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Calibration {
    /// `camera_from_world` per view; the unit is a metre as far as bone lengths show.
    pub cameras: Vec<Option<Rigid>>,
    /// Detections assigned to persons under these cameras.
    pub association: Association,
    /// The last bundle adjustment.
    pub adjusted: Option<Adjusted>,
    /// Detector noise: the published one scaled by the residuals, or the one measured on this session.
    pub noise: DetectorNoise,
    /// Share of keypoints that the best clearly different arrangement of the cameras explained; 0 without one.
    pub rival_explained: f64,
    /// Reports of all stages so far.
    pub stages: Vec<StageReport>,
    /// Of the placed cameras, where they have been adjusted together with bodies: they are not adjusted again.
    pub with_bodies: Option<CameraCovariance>,
    /// Whether they have been, with people that a correction leaves out: they are adjusted again, from near the minimum.
    #[serde(default)]
    pub with_other_bodies: bool,
    /// Views that a correction leaves out: they have no pose and no detections.
    pub excluded: Vec<usize>,
}

impl Calibration {
    /// Cameras without association and adjustment.
    pub fn unadjusted(capture: &Capture, cameras: Vec<Option<Rigid>>) -> Self {
        Self {
            cameras,
            association: Association::default(),
            adjusted: None,
            noise: DetectorNoise::published(capture.session.convention),
            rival_explained: 0.0,
            stages: Vec::new(),
            with_bodies: None,
            with_other_bodies: false,
            excluded: Vec::new(),
        }
    }

    /// Takes cameras that were adjusted together with bodies, and their uncertainty where it is known.
    ///
    /// `placed`: poses of the placed cameras; `covariance`: theirs. Both in a world whose unit is `unit` of the calibration's.
    pub fn take_over(&mut self, placed: &[Rigid], covariance: Option<&CameraCovariance>, unit: f64) {
        self.cameras.iter_mut().flatten().zip(placed).for_each(|(camera, adjusted)| *camera = *adjusted);
        let (Some(covariance), Some(adjusted)) = (covariance, &mut self.adjusted) else { return };
        let cameras = adjusted.cameras.iter_mut().zip(&self.cameras).filter(|(_, pose)| pose.is_some());
        for ((camera, _), sigma) in cameras.zip(covariance.pose_sigmas()) {
            camera.uncertainty = Some(CameraUncertainty {
                sigma_position: sigma.position * unit,
                sigma_angle: sigma.angle,
                sigma_delay: camera.uncertainty.and_then(|before| before.sigma_delay),
                sigma_drift: camera.uncertainty.and_then(|before| before.sigma_drift),
                sigma_radial: camera.uncertainty.and_then(|before| before.sigma_radial),
            });
        }
    }

    /// Number of placed cameras.
    pub fn n_placed(&self) -> usize {
        self.cameras.iter().flatten().count()
    }

    /// The persons of `session` with their `points`, world of the calibration.
    pub fn people<'a>(&'a self, session: &'a Session, points: &'a [JointTrajectory]) -> TrackedPeople<'a> {
        let Self { noise, cameras, association, .. } = self;
        TrackedPeople { session, noise, cameras, tracks: &association.tracks, points }
    }
}

/// Detections of all persons and their points, under cameras.
#[derive(Debug, Clone, Copy)]
pub struct TrackedPeople<'a> {
    /// The detections.
    pub session: &'a Session,
    /// Detector noise.
    pub noise: &'a DetectorNoise,
    /// `camera_from_world` per view, metres; `None` for a camera without a pose.
    pub cameras: &'a [Option<Rigid>],
    /// The detections of each person.
    pub tracks: &'a [PersonTrack],
    /// Points of each person, metres, in the order of the tracks; the body fit matches them by person.
    pub points: &'a [JointTrajectory],
}

/// A camera with a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PosedCamera {
    /// Its lens.
    pub intrinsics: Intrinsics,
    /// Its pose.
    pub camera_from_world: Rigid,
}

impl PosedCamera {
    /// Where a point of the world is in the image, px; `None` behind the camera.
    pub fn pixel_of(&self, position: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.intrinsics.pixel_from_camera(&self.camera_from_world.transform(position))
    }
}

impl<'a> TrackedPeople<'a> {
    /// The cameras that have a pose, and by view the index among them.
    pub fn posed_cameras(&self) -> (Vec<PosedCamera>, Vec<Option<usize>>) {
        let mut posed = Vec::new();
        let of_view = |(view, camera): (&View, &Option<Rigid>)| {
            let camera_from_world = (*camera)?;
            posed.push(PosedCamera { intrinsics: view.intrinsics, camera_from_world });
            Some(posed.len() - 1)
        };
        let of_views = self.session.views.iter().zip(self.cameras).map(of_view).collect();
        (posed, of_views)
    }

    /// Every detection of a person in a view: index of the frame, the person's points, and the detection.
    pub fn seen_by(&self, view: usize) -> impl Iterator<Item = (usize, &'a [Option<Vector3<f64>>], &'a Detection)> {
        let frames = &self.session.views[view].frames;
        self.tracks.iter().zip(self.points).flat_map(move |(track, person)| {
            let times = track.detections.iter().zip(&person.points).enumerate();
            times.filter_map(move |(t, (assigned, points))| {
                let frame = track.first.0 + t;
                Some((frame, points.as_slice(), frames[frame].get(assigned[view]?)?))
            })
        })
    }
}

/// All persons found, as tracks, with a first estimate of their points.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Association {
    /// Detections per person; person `i` is entry `i`.
    pub tracks: Vec<PersonTrack>,
    /// First estimate of each person's points, same frames.
    pub points: Vec<JointTrajectory>,
    /// Share of confident keypoints of placed views that lie near a person's reprojection, 0 to 1.
    pub explained: f64,
    /// Number of views that were placed at the time of the association.
    pub n_views_placed: usize,
    /// Number of persons who are as well supported as those above, but more than were to be found.
    pub n_left_out: usize,
}

/// What bundle adjustment may change about the cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraFreedom {
    /// Nothing: only points and bone lengths are adjusted.
    Held,
    /// All poses, except for the gauge: the best connected camera keeps its pose, and its best partner's centre keeps
    /// its distance.
    Adjusted,
}

/// Result of bundle adjustment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Adjusted {
    /// Per view.
    pub cameras: Vec<AdjustedCamera>,
    /// Per keyframe and keypoint; a point without enough observations keeps its start.
    pub points: Vec<Vec<Option<Vector3<f64>>>>,
    /// Per person and bone, in the unit of the world; `None` where no keyframe has both ends.
    pub bone_lengths: BTreeMap<usize, Vec<Option<f64>>>,
    /// Focal factors with their covariance, where they were refined and the data determine them.
    pub focal: Option<FocalEstimate>,
}

/// Focal factors of several views.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FocalEstimate {
    /// Indices of the views.
    pub views: Vec<usize>,
    /// Logarithms of the factors, by entry of `views`.
    pub log_factors: Vec<f64>,
    /// Their covariance.
    pub covariance: Vec<Vec<f64>>,
}

/// One adjusted camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AdjustedCamera {
    /// The given pose where the view is unsolved, held, or has too few observations to move.
    pub camera_from_world: Option<Rigid>,
    /// Factor on both focal lengths; 1 unless refined.
    pub focal_factor: f64,
    /// Delay of its frames against their numbers, frames; 0 unless refined.
    pub delay: f64,
    /// Change of the delay from the middle to the end of the take, frames; 0 unless refined.
    pub drift: f64,
    /// Change of the first radial coefficient of its lens; 0 unless refined.
    pub radial: f64,
    /// Whether any of its observations lies within the last robust scale.
    pub is_observed: bool,
    /// Uncertainty of the pose; `None` where it did not move or the data do not determine it.
    pub uncertainty: Option<CameraUncertainty>,
}

/// Uncertainty of a camera after a similarity alignment of all cameras (free-network gauge), without the scale.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CameraUncertainty {
    /// Root mean square error of the centre, three axes together, unit of the world.
    pub sigma_position: f64,
    /// Root mean square angular error of the orientation, rad.
    pub sigma_angle: f64,
    /// Standard deviation of the delay against the first moving camera's, frames; where delays are refined.
    pub sigma_delay: Option<f64>,
    /// The same of the drift; where drifts are refined.
    pub sigma_drift: Option<f64>,
    /// Standard deviation of the change of the lens's first radial coefficient; where these are refined.
    pub sigma_radial: Option<f64>,
}
