//! Fit statistics: reprojection errors and uncertainty of the result, per camera, person and keypoint.
//!
//! A keypoint's standard deviation in space is the noise of one ray times the dilution of the views that see it. The noise
//! is measured per keypoint, over all persons, from the distances of its detections from the result, in metres on the body.
//! Trajectories smooth what changes from frame to frame, not what lasts: the share that does is the autocorrelation of the
//! distances' directions and lengths over a frame. What the cameras are uncertain by, after a similarity alignment, is added. Known
//! limits: errors of different views are taken as independent, and a bias that all views share does not show.

mod reprojections;
mod still_detections;
mod uncertain_frames;

use crate::body::bones::LimbBone;
use crate::body::keypoint_accelerations::{acceleration_density, second_difference_variance};
use crate::geometry::free_network::CameraCovariance;
use crate::optim::point_chain::smoothing_gain;
use crate::optim::robust::{MEDIAN_LENGTH_IN_PLANE, OUTLIER_SIGMAS, median, quantile};
use crate::pipeline::calibration::TrackedPeople;
use crate::session::reconstruction::{
    CameraReport, ErrorSummary, GeometryReport, KeypointReport, PersonReport, SigmaSummary,
};
use crate::session::recording::Session;
use crate::session::{FrameIndex, JointTrajectory};
use nalgebra::Vector3;
use reprojections::{KeypointStatistics, Misfits, PersonStatistics, people_statistics};
use still_detections::still_detections;
pub use uncertain_frames::uncertain_frames;

/// Errors of a result against the detections.
#[derive(Debug, Clone)]
pub struct FitStatistics {
    /// In the order of the tracks.
    people: Vec<PersonStatistics>,
    /// Per keypoint; `None` where no two views see it.
    rays: Vec<Option<RayNoise>>,
    /// Per view.
    views: Vec<Misfits>,
}

/// Errors of the detections of a keypoint.
#[derive(Debug, Clone, Copy)]
struct RayNoise {
    /// Standard deviation for which the detector's factor is 1, m on the body.
    sigma: f64,
    /// What a trajectory leaves of the variance of a point: [`smoothing_gain`] of the share of the errors that changes from frame
    /// to frame, and all of the rest.
    smoothed: f64,
}

impl FitStatistics {
    /// Compares all trajectories (world, m) with all detections.
    ///
    /// `covariance`: of the placed cameras; without one they count as exact.
    pub fn new(input: &TrackedPeople, covariance: Option<&CameraCovariance>) -> Self {
        let people = people_statistics(input, covariance);
        let n_keypoints = people.first().map_or(0, |p| p.keypoints.len());
        let rays = (0..n_keypoints).map(|k| ray_noise(input, k, people.iter().map(|p| &p.keypoints[k]))).collect();
        let of_view =
            |v: usize| Misfits::together(people.iter().flat_map(|p| &p.keypoints).map(move |k| &k.by_view[v]));
        let views = (0..input.session.views.len()).map(of_view).collect();
        Self { people, rays, views }
    }

    /// Reprojection error of a single view, px, and its number of keypoints.
    pub fn of_view(&self, view: usize) -> (Option<ErrorSummary>, usize) {
        (summary(&self.views[view].px), self.views[view].px.len())
    }

    /// One report per camera.
    pub fn camera_reports(&self, people: &TrackedPeople) -> Vec<CameraReport> {
        let TrackedPeople { session, cameras, tracks, .. } = people;
        let given = |view: usize| {
            tracks.iter().flat_map(|t| &t.detections).filter(|assignment| assignment[view].is_some()).count()
        };
        let report = |(v, view): (usize, &crate::session::View)| {
            let n_detections = view.frames.iter().flatten().filter(|detection| detection.has_points()).count();
            CameraReport {
                id: view.id.clone(),
                solved: cameras[v].is_some(),
                excluded: false,
                n_detections,
                n_rejected_detections: n_detections.saturating_sub(given(v)),
                still_detections: still_detections(session, tracks, v),
                reprojection_px: summary(&self.views[v].px),
                reprojection_mm: summary(&self.views[v].mm),
                rejected_keypoints: self.views[v].rejected(),
                time_offset: None,
            }
        };
        session.views.iter().enumerate().map(report).collect()
    }

    /// One report per person.
    pub fn person_reports(&self, people: &TrackedPeople, bones: &[LimbBone]) -> Vec<PersonReport> {
        let TrackedPeople { session, tracks, points, .. } = people;
        let rows = tracks.iter().zip(*points).zip(&self.people);
        rows.map(|((track, path), statistics)| {
            let last = FrameIndex(track.first.0 + track.detections.len() - 1);
            let misfits = statistics.misfits();
            PersonReport {
                id: track.person.0,
                name: None,
                first_frame: session.frame_number(track.first),
                last_frame: session.frame_number(last),
                n_detections: statistics.n_detections,
                reprojection_px: summary(&misfits.px),
                reprojection_mm: summary(&misfits.mm),
                share_in_two_views: statistics.share_in_two_views,
                sigma_mm: sigmas_mm(statistics.keypoints.iter().zip(&self.rays)),
                joint_sigma_mm: None,
                uncertain_frames: Vec::new(),
                body: None,
                ray_angle_deg: median_ray_angle_deg(statistics.keypoints.iter()),
                dilution: median_dilution(statistics.keypoints.iter()),
                keypoints: self.keypoint_reports(session, statistics),
                bone_length_spread: bone_spread(bones, path),
                jitter_m_per_s2: mean_acceleration(path, session.fps),
                hands: Vec::new(),
            }
        })
        .collect()
    }

    fn keypoint_reports(&self, session: &Session, person: &PersonStatistics) -> Vec<KeypointReport> {
        let rows = session.convention.names().iter().zip(&person.keypoints).zip(&self.rays);
        rows.map(|((name, statistics), rays)| {
            let misfits = Misfits::together(statistics.by_view.iter());
            KeypointReport {
                keypoint: (*name).to_owned(),
                n_observations: misfits.n_detections(),
                rejected: misfits.rejected(),
                reprojection_px: summary(&misfits.px),
                reprojection_mm: summary(&misfits.mm),
                sigma_mm: sigmas_mm(std::iter::once((statistics, rays))),
            }
        })
        .collect()
    }

    /// Coverage of the persons by the views.
    pub fn geometry_report(&self, paths: &[JointTrajectory]) -> GeometryReport {
        let keypoints = || self.people.iter().flat_map(|p| &p.keypoints);
        GeometryReport {
            people_spread_m: people_spread(paths),
            ray_angle_deg: median_ray_angle_deg(keypoints()),
            dilution: median_dilution(keypoints()),
        }
    }
}

/// Of one keypoint, from the errors of all persons. Errors beyond the robust scale have no say in a point, and count as much as the
/// scale.
fn ray_noise<'a>(
    input: &TrackedPeople,
    keypoint: usize,
    people: impl Iterator<Item = &'a KeypointStatistics> + Clone,
) -> Option<RayNoise> {
    let mut errors: Vec<f64> = people.clone().flat_map(|k| &k.ray_errors).copied().collect();
    let limit = OUTLIER_SIGMAS * median(&mut errors)? / MEDIAN_LENGTH_IN_PLANE;
    let squared = errors.iter().map(|error| error.min(limit).powi(2)).sum::<f64>() / errors.len() as f64;
    let (product, square) =
        people.clone().fold((0.0, 0.0), |sums, k| (sums.0 + k.over_time[0], sums.1 + k.over_time[1]));
    let lasting = if square > 0.0 { (product / square).clamp(0.0, 1.0) } else { 0.0 };
    let per_axis = input.noise.sigmas_m()[keypoint] * median_dilution(people)? / 3.0f64.sqrt();
    let density = acceleration_density(input.session.convention.names()[keypoint]);
    let of_motion = second_difference_variance(density, input.session.frame_interval());
    let independent = smoothing_gain(per_axis.powi(2) / of_motion);
    Some(RayNoise { sigma: (0.5 * squared).sqrt(), smoothed: lasting + (1.0 - lasting) * independent })
}

/// Standard deviations of points in space, mm, from their dilutions, the noise of their rays, and that of the cameras.
fn sigmas_mm<'a>(
    keypoints: impl Iterator<Item = (&'a KeypointStatistics, &'a Option<RayNoise>)>,
) -> Option<SigmaSummary> {
    let mut sigmas: Vec<f64> = keypoints
        .filter_map(|(statistics, rays)| Some((statistics, (*rays)?)))
        .flat_map(|(statistics, rays)| {
            let parts = statistics.dilutions.iter().zip(&statistics.camera_variances);
            let of_rays = rays.sigma.powi(2) * rays.smoothed;
            parts.map(move |(dilution, of_cameras)| 1e3 * (of_rays * dilution.powi(2) + of_cameras).sqrt())
        })
        .collect();
    Some(SigmaSummary { median: median(&mut sigmas)?, p95: quantile(&mut sigmas, 0.95)? })
}

fn median_dilution<'a>(keypoints: impl Iterator<Item = &'a KeypointStatistics>) -> Option<f64> {
    median(&mut keypoints.flat_map(|k| &k.dilutions).copied().collect::<Vec<_>>())
}

fn median_ray_angle_deg<'a>(keypoints: impl Iterator<Item = &'a KeypointStatistics>) -> Option<f64> {
    median(&mut keypoints.flat_map(|k| &k.ray_angles).copied().collect::<Vec<_>>()).map(f64::to_degrees)
}

/// Mean and median; `None` without values.
fn summary(values: &[f64]) -> Option<ErrorSummary> {
    let mut sorted = values.to_vec();
    let median = median(&mut sorted)?;
    Some(ErrorSummary { mean: values.iter().sum::<f64>() / values.len() as f64, median })
}

/// Root mean square distance of people's positions (the mean of their points, frame by frame) from the mean of all, m.
fn people_spread(paths: &[JointTrajectory]) -> Option<f64> {
    let position = |points: &Vec<Option<Vector3<f64>>>| {
        let known = points.iter().flatten();
        let n = known.clone().count();
        (n > 0).then(|| known.sum::<Vector3<f64>>() / n as f64)
    };
    let positions: Vec<Vector3<f64>> = paths.iter().flat_map(|path| &path.points).filter_map(position).collect();
    let n = positions.len() as f64;
    let mean = positions.iter().sum::<Vector3<f64>>() / n;
    let squared = positions.iter().map(|position| (position - mean).norm_squared()).sum::<f64>() / n;
    (!positions.is_empty()).then(|| squared.sqrt())
}

/// Relative standard deviation of bone lengths over frames in which two views see both ends, mean over bones.
fn bone_spread(bones: &[LimbBone], path: &JointTrajectory) -> Option<f64> {
    let spreads: Vec<f64> = bones
        .iter()
        .filter_map(|bone| {
            let lengths: Vec<f64> = path
                .points
                .iter()
                .zip(&path.n_views)
                .filter(|(_, n)| n[bone.a] >= 2 && n[bone.b] >= 2)
                .filter_map(|(p, _)| Some((p[bone.a]? - p[bone.b]?).norm()))
                .collect();
            if lengths.len() < 10 {
                return None;
            }
            let n = lengths.len() as f64;
            let mean = lengths.iter().sum::<f64>() / n;
            let variance = lengths.iter().map(|l| (l - mean) * (l - mean)).sum::<f64>() / n;
            Some(variance.sqrt() / mean)
        })
        .collect();
    (!spreads.is_empty()).then(|| spreads.iter().sum::<f64>() / spreads.len() as f64)
}

/// Mean acceleration of all keypoints, m/s^2.
fn mean_acceleration(path: &JointTrajectory, fps: f64) -> Option<f64> {
    let (mut sum, mut n) = (0.0, 0usize);
    for window in path.points.windows(3) {
        for k in 0..window[0].len() {
            if let (Some(a), Some(b), Some(c)) = (window[0][k], window[1][k], window[2][k]) {
                sum += (a - b * 2.0 + c).norm() * fps * fps;
                n += 1;
            }
        }
    }
    (n > 0).then(|| sum / n as f64)
}
