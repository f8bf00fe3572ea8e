//! Every keypoint of every person as one smooth path through all rays that saw it, under fixed cameras.
//!
//! For a keypoint the path x_0 … x_T minimises
//! $\sum_{t,v} \rho(\lVert \pi_v(x_t) - u_{tv} \rVert / \sigma) + \sum_t \lVert x_{t+1} - 2 x_t + x_{t-1} \rVert^2 / (\tfrac23 q\,dt^3)$:
//! triangulation, smoothing and the filling of gaps are one problem, so a joint that a single view sees is still held to
//! that view's ray. `q` is the spectral density of white acceleration (m^2/s^3), hence independent of the frame rate.

use crate::body::detector_noise::DetectorNoise;
use crate::body::detector_profile::DETECTOR;
use crate::geometry::Rigid;
use crate::geometry::projection::NEAR_PLANE;
use crate::optim::point_chain::PointChain;
use crate::optim::robust::{OUTLIER_SIGMAS, geman_mcclure};
use crate::progress::{Canceled, Progress};
use crate::residuals::reprojection;
use crate::session::recording::{FrameIndex, Session};
use crate::session::{JointTrajectory, PersonTrack};
use nalgebra::{Matrix3, Vector2, Vector3};
use rayon::prelude::*;

/// Weights of the paths.
#[derive(Debug, Clone)]
pub struct TrajectoryConfig {
    /// Spectral density of acceleration of hands and feet, m^2/s^3: 12 m/s^2 (a brisk gesture) held for a thirtieth of a
    /// second.
    pub limb_acceleration: f64,
    /// The same of head and trunk: 5 m/s^2.
    pub trunk_acceleration: f64,
    /// Geman-McClure scale, standard deviations.
    pub robust_scale: f64,
    /// Re-weighted Gauss-Newton steps.
    pub iterations: usize,
}

impl Default for TrajectoryConfig {
    fn default() -> Self {
        Self { limb_acceleration: 5.0, trunk_acceleration: 0.8, robust_scale: OUTLIER_SIGMAS, iterations: 8 }
    }
}

/// What the paths are made of.
pub struct TrajectoryInput<'a> {
    /// The recording.
    pub session: &'a Session,
    /// How far the detector errs.
    pub noise: &'a DetectorNoise,
    /// `camera_from_world`.
    pub cameras: &'a [Option<Rigid>],
    /// Who is where.
    pub tracks: &'a [PersonTrack],
    /// First guess of each person's points, same frames as the track; holes allowed.
    pub start: &'a [JointTrajectory],
    /// Metres that one unit of the cameras' world stands for.
    pub metres_per_unit: f64,
    /// How firmly each step holds a point where it is.
    pub hold: Hold,
}

/// How firmly each step of the solver holds a point where it is, standard deviation in m.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hold {
    /// 10 m, a whisper, so that a frame that nothing reaches keeps its place.
    Whisper,
    /// 0.1 m: a single view leaves the depth open, which would run away along the rays; across them a detector's 0.02 m is
    /// still reached within the steps.
    OnRay,
}

impl Hold {
    /// Weight per m^2.
    fn weight(self) -> f64 {
        match self {
            Self::Whisper => 0.01,
            Self::OnRay => 100.0,
        }
    }
}

/// Estimates all paths, in parallel over people and keypoints.
///
/// # Errors
/// [`Canceled`].
pub fn joint_trajectories(
    input: &TrajectoryInput,
    config: &TrajectoryConfig,
    progress: &Progress,
) -> Result<Vec<JointTrajectory>, Canceled> {
    let names = input.session.convention.names();
    let mut people = Vec::with_capacity(input.tracks.len());
    for (track, start) in input.tracks.iter().zip(input.start) {
        progress.check()?;
        let rays = rays_by_keypoint(input, track);
        let paths: Vec<Path> = (0..names.len())
            .into_par_iter()
            .map(|k| {
                let limb =
                    ["wrist", "elbow", "ankle", "knee", "toe", "heel", "hand", "foot", "index", "pinky", "thumb"];
                let is_limb = limb.iter().any(|part| names[k].ends_with(part));
                let density = if is_limb { config.limb_acceleration } else { config.trunk_acceleration };
                path(input, &rays[k], interpolated(start, k), density, config)
            })
            .collect();
        people.push(transposed(track, &rays, &paths));
    }
    Ok(people)
}

/// One keypoint over time; empty where it was never located.
type Path = Vec<Vector3<f64>>;

/// One sight of a keypoint.
struct Ray {
    /// Index of the path's point.
    t: usize,
    view: usize,
    pixel: Vector2<f64>,
    /// Standard deviation per axis on the body, m.
    sigma_m: f64,
}

/// `[keypoint]`, by time.
fn rays_by_keypoint(input: &TrajectoryInput, track: &PersonTrack) -> Vec<Vec<Ray>> {
    let mut rays: Vec<Vec<Ray>> = input.noise.sigmas_m().iter().map(|_| Vec::new()).collect();
    for (t, claims) in track.detections.iter().enumerate() {
        for (view, detection) in claims.iter().enumerate() {
            let (Some(detection), Some(_)) = (detection, &input.cameras[view]) else { continue };
            let keypoints = &input.session.views[view].frames[track.first.0 + t][*detection].keypoints;
            for (k, (seen, rays)) in
                keypoints.iter().zip(&mut rays).enumerate().filter(|(_, (k, _))| k.confidence > DETECTOR.min_confidence)
            {
                rays.push(Ray { t, view, pixel: seen.pixel, sigma_m: input.noise.sigma_m(k, seen.confidence) });
            }
        }
    }
    rays
}

fn path(input: &TrajectoryInput, rays: &[Ray], start: Option<Path>, density: f64, config: &TrajectoryConfig) -> Path {
    let Some(mut points) = start else { return Path::new() };
    let unit = input.metres_per_unit;
    let dt = input.session.frame_interval();
    let smoothness = PointChain::of_second_differences(points.len(), unit * unit / (density * dt.powi(3) * 2.0 / 3.0));
    // From ten times the robust scale down: the guess may be a hand's length off.
    for iteration in 0..config.iterations {
        let widening = (10.0f64).powf(1.0 - iteration as f64 / (config.iterations - 1).max(1) as f64);
        let scale = config.robust_scale * widening;
        if !step(input, rays, &mut points, &smoothness, scale) {
            break;
        }
    }
    points
}

/// The guess without holes: straight lines between known points, constant at the ends; `None` with no point at all.
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

/// One re-weighted Gauss-Newton step on a whole path; false where the system has no solution.
fn step(
    input: &TrajectoryInput,
    rays: &[Ray],
    points: &mut [Vector3<f64>],
    smoothness: &PointChain,
    robust_scale: f64,
) -> bool {
    let mut gradient = smoothness.times(points);
    let mut system = smoothness.clone();
    let hold = Matrix3::from_diagonal_element(input.metres_per_unit * input.metres_per_unit * input.hold.weight());
    system.diagonal.iter_mut().for_each(|block| *block += hold);
    for ray in rays {
        if let Some((by_point, hessian)) = pull(input, ray, &points[ray.t], robust_scale) {
            gradient[ray.t] += by_point;
            system.diagonal[ray.t] += hessian;
        }
    }
    let Some(delta) = system.solve(gradient) else { return false };
    points.iter_mut().zip(delta).for_each(|(point, delta)| *point -= delta);
    true
}

/// Gradient and Gauss-Newton Hessian of one ray's cost by its point.
fn pull(
    input: &TrajectoryInput,
    ray: &Ray,
    point: &Vector3<f64>,
    robust_scale: f64,
) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let camera = input.cameras[ray.view].as_ref()?;
    let intrinsics = &input.session.views[ray.view].intrinsics;
    let depth = camera.transform(point).z * input.metres_per_unit;
    if depth < NEAR_PLANE {
        return None;
    }
    let sigma_px = intrinsics.focal() * ray.sigma_m / depth;
    let r = reprojection::linearize(intrinsics, camera, point, &ray.pixel, sigma_px)?;
    let weight = geman_mcclure(r.residual.norm_squared(), robust_scale).weight;
    Some((r.by_point.tr_mul(&r.residual) * weight, r.by_point.tr_mul(&r.by_point) * weight))
}

fn transposed(track: &PersonTrack, rays: &[Vec<Ray>], paths: &[Path]) -> JointTrajectory {
    let n = track.detections.len();
    let points = (0..n).map(|t| paths.iter().map(|path| path.get(t).copied()).collect()).collect();
    let mut n_views = vec![vec![0; rays.len()]; n];
    for (k, rays) in rays.iter().enumerate() {
        rays.iter().for_each(|ray| n_views[ray.t][k] += 1);
    }
    JointTrajectory { person: track.person, first: FrameIndex(track.first.0), points, n_views }
}
