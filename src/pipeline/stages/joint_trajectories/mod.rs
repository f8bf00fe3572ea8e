//! Smooth trajectories of all keypoints through their detections in all views, under fixed cameras.
//!
//! For a keypoint the trajectory x_0 … x_T minimises
//! $\sum_{t,v} \rho(\lVert \pi_v(x_t) - u_{tv} \rVert / \sigma) + \sum_t \lVert x_{t+1} - 2 x_t + x_{t-1} \rVert^2 / (\tfrac23 q\,dt^3)$:
//! triangulation, smoothing and gap filling are one problem, so a joint that a single view sees stays near that view's
//! ray. `q` is the spectral density of white acceleration (m^2/s^3), hence independent of the frame rate.

use crate::body::detector_profile::DETECTOR;
use crate::body::keypoint_accelerations::{acceleration_density, second_difference_variance};
use crate::geometry::projection::NEAR_PLANE;
use crate::optim::point_chain::PointChain;
use crate::optim::robust::{OUTLIER_SIGMAS, geman_mcclure};
use crate::pipeline::calibration::TrackedPeople;
use crate::progress::{Canceled, Progress};
use crate::residuals::reprojection;
use crate::session::recording::FrameIndex;
use crate::session::{JointTrajectory, PersonTrack};
use nalgebra::{Matrix3, Vector2, Vector3};
use rayon::prelude::*;

/// Number of re-weighted Gauss-Newton steps.
const N_STEPS: usize = 8;

/// Weight per m^2 of a point's current position in a solver step: 10 m, so that a frame without any constraint keeps its
/// position.
const DAMPING: f64 = 0.01;
/// The same for a single view, which does not constrain depth: 0.1 m, or depth would diverge along the rays; across them the
/// detector's 0.02 m is still reached within the steps.
const MONOCULAR_DAMPING: f64 = 100.0;

/// Estimates all trajectories, in parallel over people and keypoints; the points of `input` are the start, and may have gaps.
pub fn joint_trajectories(input: &TrackedPeople, progress: &Progress) -> Result<Vec<JointTrajectory>, Canceled> {
    let names = input.session.convention.names();
    let of_person = |(track, start): (&PersonTrack, &JointTrajectory)| {
        progress.check()?;
        let rays = rays_by_keypoint(input, track);
        let paths: Vec<Path> = (0..names.len())
            .into_par_iter()
            .map(|k| path(input, &rays[k], interpolated(start, k), acceleration_density(names[k])))
            .collect();
        Ok(transposed(track, &rays, &paths))
    };
    input.tracks.par_iter().zip(input.points).map(of_person).collect()
}

/// Positions of one keypoint over time; empty where it has no start.
type Path = Vec<Vector3<f64>>;

/// One detected keypoint.
struct KeypointRay {
    /// Index of the point on the path.
    t: usize,
    view: usize,
    pixel: Vector2<f64>,
    /// Standard deviation per axis on the body, m.
    sigma_m: f64,
}

/// All detections of a person: `[keypoint]`, ordered by time.
fn rays_by_keypoint(input: &TrackedPeople, track: &PersonTrack) -> Vec<Vec<KeypointRay>> {
    let mut rays: Vec<Vec<KeypointRay>> = input.noise.sigmas_m().iter().map(|_| Vec::new()).collect();
    for (t, assignments) in track.detections.iter().enumerate() {
        for (view, detection) in assignments.iter().enumerate() {
            let (Some(detection), Some(_)) = (detection, &input.cameras[view]) else { continue };
            let keypoints = &input.session.views[view].frames[track.first.0 + t][*detection].keypoints;
            for (k, (seen, rays)) in
                keypoints.iter().zip(&mut rays).enumerate().filter(|(_, (k, _))| k.confidence > DETECTOR.min_confidence)
            {
                rays.push(KeypointRay { t, view, pixel: seen.pixel, sigma_m: input.noise.sigma_m(k, seen.confidence) });
            }
        }
    }
    rays
}

fn path(input: &TrackedPeople, rays: &[KeypointRay], start: Option<Path>, density: f64) -> Path {
    let Some(mut points) = start else { return Path::new() };
    let dt = input.session.frame_interval();
    let smoothness = PointChain::of_second_differences(points.len(), 1.0 / second_difference_variance(density, dt));
    // From ten times the robust scale down: the start may be 0.2 m off.
    for iteration in 0..N_STEPS {
        let widening = (10.0f64).powf(1.0 - iteration as f64 / (N_STEPS - 1) as f64);
        if !step(input, rays, &mut points, &smoothness, OUTLIER_SIGMAS * widening) {
            break;
        }
    }
    points
}

/// The start without gaps: linear between known points, constant at the ends; `None` without any point.
fn interpolated(start: &JointTrajectory, keypoint: usize) -> Option<Path> {
    let points = &start.points;
    let known: Vec<(usize, Vector3<f64>)> =
        points.iter().enumerate().filter_map(|(t, p)| p[keypoint].map(|p| (t, p))).collect();
    let (first, last) = (known.first()?, known.last()?);
    let mut filled = Vec::with_capacity(points.len());
    filled.resize(first.0, first.1);
    for pair in known.windows(2) {
        let ((s, a), (e, b)) = (pair[0], pair[1]);
        filled.extend((s..e).map(|t| a + (b - a) * ((t - s) as f64 / (e - s) as f64)));
    }
    filled.resize(points.len(), last.1);
    Some(filled)
}

/// One re-weighted Gauss-Newton step on a whole path; false where the system cannot be solved.
fn step(
    input: &TrackedPeople,
    rays: &[KeypointRay],
    points: &mut [Vector3<f64>],
    smoothness: &PointChain,
    robust_scale: f64,
) -> bool {
    let mut gradient = smoothness.times(points);
    let mut system = smoothness.clone();
    let is_monocular = input.session.views.len() == 1;
    let damping = Matrix3::from_diagonal_element(if is_monocular { MONOCULAR_DAMPING } else { DAMPING });
    system.diagonal.iter_mut().for_each(|block| *block += damping);
    for ray in rays {
        if let Some((by_point, hessian)) = linearize(input, ray, &points[ray.t], robust_scale) {
            gradient[ray.t] += by_point;
            system.diagonal[ray.t] += hessian;
        }
    }
    let Some(delta) = system.solve(gradient) else { return false };
    points.iter_mut().zip(delta).for_each(|(point, delta)| *point -= delta);
    true
}

/// Gradient and Gauss-Newton Hessian of one detection's cost by its point.
fn linearize(
    input: &TrackedPeople,
    ray: &KeypointRay,
    point: &Vector3<f64>,
    robust_scale: f64,
) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let camera = input.cameras[ray.view].as_ref()?;
    let intrinsics = &input.session.views[ray.view].intrinsics;
    let depth = camera.transform(point).z;
    if depth < NEAR_PLANE {
        return None;
    }
    let sigma_px = intrinsics.focal() * ray.sigma_m / depth;
    let r = reprojection::linearize(intrinsics, camera, point, &ray.pixel, sigma_px)?;
    let weight = geman_mcclure(r.residual.norm_squared(), robust_scale).weight;
    Some((r.by_point.tr_mul(&r.residual) * weight, r.by_point.tr_mul(&r.by_point) * weight))
}

fn transposed(track: &PersonTrack, rays: &[Vec<KeypointRay>], paths: &[Path]) -> JointTrajectory {
    let n = track.detections.len();
    let points = (0..n).map(|t| paths.iter().map(|path| path.get(t).copied()).collect()).collect();
    let mut n_views = vec![vec![0; rays.len()]; n];
    for (k, rays) in rays.iter().enumerate() {
        rays.iter().for_each(|ray| n_views[ray.t][k] += 1);
    }
    JointTrajectory { person: track.person, first: FrameIndex(track.first.0), points, n_views }
}
