//! Every keypoint of every person as one smooth path through all rays that saw it, under fixed cameras.
//!
//! For a keypoint the path x_0 … x_T minimises
//! $\sum_{t,v} \rho(\lVert \pi_v(x_t) - u_{tv} \rVert / \sigma) + \sum_t \lVert x_{t+1} - 2 x_t + x_{t-1} \rVert^2 / (\tfrac23 q\,dt^3)$:
//! triangulation, smoothing and the filling of gaps are one problem, so a joint that a single view sees is still held to
//! that view's ray. `q` is the spectral density of white acceleration (m^2/s^3), hence independent of the frame rate.

use crate::body::detector_noise::DetectorNoise;
use crate::geometry::Rigid;
use crate::optim::banded::BandMatrix;
use crate::optim::robust::geman_mcclure;
use crate::progress::{Canceled, Progress};
use crate::residuals::reprojection;
use crate::session::recording::{FrameIndex, Session};
use crate::session::{JointTrajectory, PersonTrack};
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

/// Weights of the paths.
#[derive(Debug, Clone)]
pub struct TrajectoryConfig {
    /// Spectral density of acceleration of hands and feet, m^2/s^3: 12 m/s^2 (a brisk gesture) held for a thirtieth of a
    /// second.
    pub limb_acceleration: f64,
    /// The same of head and trunk: 5 m/s^2.
    pub trunk_acceleration: f64,
    /// Geman-McClure scale in standard deviations: beyond three a point is more likely wrong than noisy.
    pub robust_scale: f64,
    /// Re-weighted Gauss-Newton steps.
    pub iterations: usize,
}

impl Default for TrajectoryConfig {
    fn default() -> Self {
        Self { limb_acceleration: 5.0, trunk_acceleration: 0.8, robust_scale: 3.0, iterations: 8 }
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
        let paths: Vec<Path> = (0..names.len())
            .into_par_iter()
            .map(|k| {
                let limb =
                    ["wrist", "elbow", "ankle", "knee", "toe", "heel", "hand", "foot", "index", "pinky", "thumb"];
                let is_limb = limb.iter().any(|part| names[k].ends_with(part));
                let density = if is_limb { config.limb_acceleration } else { config.trunk_acceleration };
                path(input, track, start, k, density, config)
            })
            .collect();
        people.push(transposed(track, &paths));
    }
    Ok(people)
}

/// One keypoint over time: points (empty where the keypoint was never located) and views per frame.
struct Path {
    points: Vec<Vector3<f64>>,
    n_views: Vec<u8>,
}

/// One ray of a frame.
struct Ray {
    view: usize,
    pixel: Vector2<f64>,
    /// Standard deviation per axis on the body, m.
    sigma_m: f64,
}

fn path(
    input: &TrajectoryInput,
    track: &PersonTrack,
    start: &JointTrajectory,
    keypoint: usize,
    density: f64,
    config: &TrajectoryConfig,
) -> Path {
    let rays: Vec<Vec<Ray>> = (0..track.detections.len()).map(|t| rays_at(input, track, t, keypoint)).collect();
    let n_views = rays.iter().map(|r| r.len() as u8).collect();
    let Some(mut points) = interpolated(&start.points, keypoint) else { return Path { points: Vec::new(), n_views } };
    let unit = input.metres_per_unit;
    let dt = input.session.frame_interval();
    let smoothness = unit * unit / (density * dt.powi(3) * 2.0 / 3.0);
    // From ten times the robust scale down: the guess may be a hand's length off.
    for iteration in 0..config.iterations {
        let widening = (10.0f64).powf(1.0 - iteration as f64 / (config.iterations - 1).max(1) as f64);
        let scale = config.robust_scale * widening;
        if !step(input, &rays, &mut points, smoothness, scale) {
            break;
        }
    }
    Path { points, n_views }
}

fn rays_at(input: &TrajectoryInput, track: &PersonTrack, t: usize, keypoint: usize) -> Vec<Ray> {
    let frame = track.first.0 + t;
    let mut rays = Vec::new();
    for (view, detection) in track.detections[t].iter().enumerate() {
        let (Some(detection), Some(_)) = (detection, &input.cameras[view]) else { continue };
        let k = &input.session.views[view].frames[frame][*detection].keypoints[keypoint];
        if k.confidence > 0.1 {
            rays.push(Ray { view, pixel: k.pixel, sigma_m: input.noise.sigma_m(keypoint, k.confidence) });
        }
    }
    rays
}

/// The guess without holes: straight lines between known points, constant at the ends; `None` with no point at all.
fn interpolated(points: &[Vec<Option<Vector3<f64>>>], keypoint: usize) -> Option<Vec<Vector3<f64>>> {
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
    rays: &[Vec<Ray>],
    points: &mut [Vector3<f64>],
    smoothness: f64,
    robust_scale: f64,
) -> bool {
    let n = points.len();
    let mut matrix = BandMatrix::zeros(3 * n, 8);
    let mut gradient = vec![0.0; 3 * n];
    for (t, rays) in rays.iter().enumerate() {
        for ray in rays {
            add_ray(input, ray, t, &points[t], robust_scale, &mut matrix, &mut gradient);
        }
        for a in 0..3 {
            matrix.add(3 * t + a, 3 * t + a, input.metres_per_unit * input.metres_per_unit * input.hold.weight());
        }
    }
    for t in 1..n.saturating_sub(1) {
        let bend = points[t + 1] - points[t] * 2.0 + points[t - 1];
        let weights = [(t - 1, 1.0), (t, -2.0), (t + 1, 1.0)];
        for a in 0..3 {
            for &(i, wi) in &weights {
                gradient[3 * i + a] += smoothness * wi * bend[a];
                for &(j, wj) in weights.iter().filter(|(j, _)| *j <= i) {
                    matrix.add(3 * i + a, 3 * j + a, smoothness * wi * wj);
                }
            }
        }
    }
    let Some(delta) = matrix.solve(gradient) else { return false };
    for (t, point) in points.iter_mut().enumerate() {
        *point -= Vector3::new(delta[3 * t], delta[3 * t + 1], delta[3 * t + 2]);
    }
    true
}

#[allow(clippy::too_many_arguments)] // one row of the normal equations and where it goes
fn add_ray(
    input: &TrajectoryInput,
    ray: &Ray,
    t: usize,
    point: &Vector3<f64>,
    robust_scale: f64,
    matrix: &mut BandMatrix,
    gradient: &mut [f64],
) {
    let Some(camera) = &input.cameras[ray.view] else { return };
    let intrinsics = &input.session.views[ray.view].intrinsics;
    let depth = camera.transform(point).z * input.metres_per_unit;
    if depth < 0.1 {
        return;
    }
    let sigma_px = intrinsics.focal() * ray.sigma_m / depth;
    let Some(r) = reprojection::linearize(intrinsics, camera, point, &ray.pixel, sigma_px) else { return };
    let weight = geman_mcclure(r.residual.norm_squared(), robust_scale).weight;
    let j = r.by_point;
    let g = j.transpose() * r.residual * weight;
    let h = j.transpose() * j * weight;
    for a in 0..3 {
        gradient[3 * t + a] += g[a];
        for b in 0..=a {
            matrix.add(3 * t + a, 3 * t + b, h[(a, b)]);
        }
    }
}

fn transposed(track: &PersonTrack, paths: &[Path]) -> JointTrajectory {
    let n = track.detections.len();
    let points = (0..n).map(|t| paths.iter().map(|p| p.points.get(t).copied()).collect()).collect();
    let n_views = (0..n).map(|t| paths.iter().map(|p| p.n_views[t]).collect()).collect();
    JointTrajectory { person: track.person, first: FrameIndex(track.first.0), points, n_views }
}
