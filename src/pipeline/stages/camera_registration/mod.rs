//! Registration of cameras that camera initialisation left out, by perspective-n-point on persons already triangulated.

use crate::body::detector_profile::DETECTOR;
use crate::estimation::pnp::{PoseEstimate, estimate_pose};
use crate::geometry::Rigid;
use crate::matching::pair_hypotheses::mix;
use crate::matching::tracklets::Tracklet;
use crate::pipeline::calibration::Calibration;
use crate::pipeline::capture::Capture;
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

/// Number of the longest tracklets of the camera that are tried on every person.
const N_TRACKLETS: usize = 6;

/// Largest number of correspondences of one robust pose.
const MAX_POINTS: usize = 300;

/// Fewer correspondences than this do not identify a person.
const MIN_POINTS: usize = 40;

/// Reprojection error from which a point has no weight, rad: 10 px at a focal length of 1,060 px, of people at 4 m or farther.
const TOLERANCE: f64 = 0.01;

/// A tracklet shows the person when this share of points agrees; chance poses of another person reach a third.
const MIN_INLIERS: f64 = 0.5;

/// Places every remaining camera of which one tracklet agrees with one triangulated person.
pub fn register_remaining(capture: &Capture, tracklets: &[Vec<Tracklet>], calibration: &mut Calibration) {
    let found: Vec<(usize, Option<Rigid>)> = (0..calibration.cameras.len())
        .filter(|&v| calibration.cameras[v].is_none())
        .map(|view| (view, pose_of(capture, &tracklets[view], calibration, view)))
        .collect();
    for (view, pose) in found {
        calibration.cameras[view] = pose;
    }
}

/// The best supported pose of a camera over its tracklets and all persons.
fn pose_of(capture: &Capture, tracklets: &[Tracklet], calibration: &Calibration, view: usize) -> Option<Rigid> {
    let mut order: Vec<usize> = (0..tracklets.len()).collect();
    order.sort_by_key(|&t| (std::cmp::Reverse(tracklets[t].detections.len()), t));
    order.truncate(N_TRACKLETS);
    let people = calibration.association.points.len();
    let pairs: Vec<(usize, usize)> = order.iter().flat_map(|&t| (0..people).map(move |p| (t, p))).collect();
    let poses: Vec<Option<PoseEstimate>> = pairs
        .par_iter()
        .map(|&(t, person)| {
            let points = correspondences(capture, &tracklets[t], calibration, view, person);
            let tolerance = TOLERANCE * tracklets[t].error_scale(&capture.views[view]);
            let seed = mix(capture.options.seed, (view * 1_000_003 + t * 1009 + person) as u64);
            (points.len() >= MIN_POINTS).then(|| estimate_pose(&points, tolerance, 300, seed)).flatten()
        })
        .collect();
    let good = poses.into_iter().flatten().filter(|p| p.inlier_ratio >= MIN_INLIERS);
    good.max_by(|a, b| a.support.total_cmp(&b.support)).map(|p| p.camera_from_world)
}

/// Points of a person in space and their normalised detections in a tracklet, from evenly spread frames.
fn correspondences(
    capture: &Capture,
    tracklet: &Tracklet,
    calibration: &Calibration,
    view: usize,
    person: usize,
) -> Vec<(Vector3<f64>, Vector2<f64>)> {
    let trajectory = &calibration.association.points[person];
    let mut points = Vec::new();
    for &(frame, detection) in &tracklet.detections {
        let Some(skeleton) = frame.checked_sub(trajectory.first.0).and_then(|t| trajectory.points.get(t)) else {
            continue;
        };
        let detection = &capture.views[view].frames[frame][detection];
        for (k, point) in skeleton.iter().enumerate() {
            if let Some(point) = point.filter(|_| detection.confidence[k] > DETECTOR.judged) {
                points.push((point, detection.normalized[k]));
            }
        }
    }
    let stride = points.len().div_ceil(MAX_POINTS).max(1);
    points.into_iter().step_by(stride).collect()
}
