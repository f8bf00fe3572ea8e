//! Smooth trajectories of all keypoints through their detections in all views, under fixed cameras.
//!
//! For a keypoint the trajectory x_0 … x_T minimises
//! $\sum_{t,v} \rho(\lVert \pi_v(x_t) - u_{tv} \rVert / \sigma) + \sum_t \rho_a(\lVert x_{t+1} - 2 x_t + x_{t-1} \rVert / \sqrt{\tfrac23 q\,dt^3})$:
//! triangulation, smoothing and gap filling are one problem, so a joint that a single view sees stays near that view's
//! ray. `q` is the spectral density of white acceleration (m^2/s^3), hence independent of the frame rate.
//!
//! $\rho_a$ is the square. Kicks, throws and punches accelerate ten times as much as usual motion, and smooth paths would take what
//! all views show of them for errors: for accelerations that points show on which enough views agree, it is Cauchy's cost.

use crate::body::detector_profile::DETECTOR;
use crate::body::keypoint_accelerations::{acceleration_density, second_difference_variance};
use crate::geometry::projection::NEAR_PLANE;
use crate::geometry::{Intrinsics, Rigid};
use crate::optim::point_chain::PointChain;
use crate::optim::robust::{OUTLIER_SIGMAS, cauchy_weight, geman_mcclure};
use crate::pipeline::calibration::TrackedPeople;
use crate::progress::{Canceled, Progress};
use crate::residuals::acceleration::second_difference;
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
            .map(|k| path(input, &rays[k], interpolated(of_keypoint(start, k)), acceleration_density(names[k])))
            .collect();
        Ok(transposed(track, &rays, &paths))
    };
    input.tracks.par_iter().zip(input.points).map(of_person).collect()
}

fn of_keypoint(points: &JointTrajectory, keypoint: usize) -> Vec<Option<Vector3<f64>>> {
    points.points.iter().map(|of_frame| of_frame[keypoint]).collect()
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

/// Lens and `camera_from_world` of a view.
type PosedView<'a> = (&'a Intrinsics, &'a Rigid);

impl KeypointRay {
    /// The view, and the standard deviation in its image, px, if the keypoint is at `point`; `None` behind the camera.
    fn seen_at<'a>(&self, input: &'a TrackedPeople, point: &Vector3<f64>) -> Option<(PosedView<'a>, f64)> {
        let camera = input.cameras[self.view].as_ref()?;
        let intrinsics = &input.session.views[self.view].intrinsics;
        let depth = camera.transform(point).z;
        (depth >= NEAR_PLANE).then(|| ((intrinsics, camera), intrinsics.focal() * self.sigma_m / depth))
    }
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
    let precision = second_difference_variance(density, dt).recip();
    let is_agreed = agreed(input, rays, &points);
    let longest = (MAX_BRIDGED_SECS / dt).round() as usize;
    let (mut system, mut bridged, mut gradient) = (PointChain::zeros(points.len()), Vec::new(), Vec::new());
    // From ten times the robust scale down: the start may be 0.2 m off.
    for iteration in 0..N_STEPS {
        let widening = (10.0f64).powf(1.0 - iteration as f64 / (N_STEPS - 1) as f64);
        bridged.clear();
        bridged.extend(points.iter().zip(&is_agreed).map(|(point, is_agreed)| is_agreed.then_some(*point)));
        bridge(&mut bridged, longest);
        system.set_second_differences(smoothness(&points, &bridged, precision));
        system.times(&points, &mut gradient);
        if step(input, rays, &mut points, (&mut system, &mut gradient), OUTLIER_SIGMAS * widening).is_none() {
            break;
        }
    }
    points
}

/// Points without gaps: linear between known ones, constant at the ends; `None` without any.
fn interpolated(mut points: Vec<Option<Vector3<f64>>>) -> Option<Path> {
    bridge(&mut points, usize::MAX);
    let first = points.iter().find_map(|point| *point)?;
    let mut last = first;
    let filled = points.into_iter().map(|point| {
        last = point.unwrap_or(last);
        last
    });
    Some(filled.collect())
}

/// Fills in the points between known ones at most `longest` frames apart, on the line through these.
fn bridge(points: &mut [Option<Vector3<f64>>], longest: usize) {
    let mut before: Option<(usize, Vector3<f64>)> = None;
    for e in 0..points.len() {
        let Some(b) = points[e] else { continue };
        if let Some((s, a)) = before.filter(|(s, _)| e - s <= longest) {
            (s + 1..e).for_each(|t| points[t] = Some(a + (b - a) * ((t - s) as f64 / (e - s) as f64)));
        }
        before = Some((e, b));
    }
}

/// Fewest views that agree on a point: of two, one may be wrong and the point still near both rays.
const MIN_AGREEING: u32 = 3;

/// By frame, whether enough views agree on the point.
fn agreed(input: &TrackedPeople, rays: &[KeypointRay], points: &[Vector3<f64>]) -> Vec<bool> {
    let mut n_agreeing = vec![0; points.len()];
    for ray in rays {
        let is_near = |(view, sigma_px): (PosedView, f64)| {
            let residual = reprojection::residual(view.0, view.1, &points[ray.t], &ray.pixel, sigma_px);
            residual.is_some_and(|r| r.norm() < OUTLIER_SIGMAS)
        };
        n_agreeing[ray.t] += u32::from(ray.seen_at(input, &points[ray.t]).is_some_and(is_near));
    }
    n_agreeing.into_iter().map(|n| n >= MIN_AGREEING).collect()
}

/// Accelerations beyond this many standard deviations are those of a few moments: 50 m/s^2 of limbs, 20 of head and trunk at 30 frames
/// a second. With 2 to 5 in its place joints in fast motion come 1 % closer or farther.
const ACCELERATION_SIGMAS: f64 = 5.0;

/// Longest time between points that views agree on over which they show an acceleration, s: a strike and its return take longer.
const MAX_BRIDGED_SECS: f64 = 0.3;

/// Weights of the second differences, for the cost of accelerations at `points`; `precision`: inverse variance of a second difference.
///
/// An acceleration counts as one where the points that views agree on show it as well, those between them taken as linear (`bridged`):
/// the start of others may be far off.
fn smoothness(points: &[Vector3<f64>], bridged: &[Option<Vector3<f64>>], precision: f64) -> impl Fn(usize) -> f64 {
    move |t| {
        let (Some(a), Some(b), Some(c)) = (bridged[t - 1], bridged[t], bridged[t + 1]) else { return precision };
        let shown = second_difference([a, b, c]).norm_squared();
        let own = second_difference([points[t - 1], points[t], points[t + 1]]).norm_squared();
        precision * cauchy_weight(own.min(shown) * precision, ACCELERATION_SIGMAS)
    }
}

/// One re-weighted Gauss-Newton step on a whole path, from system and gradient of the smoothness, which are used up; `None` where
/// the system cannot be solved.
fn step(
    input: &TrackedPeople,
    rays: &[KeypointRay],
    points: &mut [Vector3<f64>],
    (system, gradient): (&mut PointChain, &mut [Vector3<f64>]),
    robust_scale: f64,
) -> Option<()> {
    let is_monocular = input.session.views.len() == 1;
    let damping = Matrix3::from_diagonal_element(if is_monocular { MONOCULAR_DAMPING } else { DAMPING });
    system.diagonal.iter_mut().for_each(|block| *block += damping);
    for ray in rays {
        if let Some((by_point, hessian)) = linearize(input, ray, &points[ray.t], robust_scale) {
            gradient[ray.t] += by_point;
            system.diagonal[ray.t] += hessian;
        }
    }
    system.solve(gradient)?;
    points.iter_mut().zip(gradient).for_each(|(point, delta)| *point -= *delta);
    Some(())
}

/// Gradient and Gauss-Newton Hessian of one detection's cost by its point.
fn linearize(
    input: &TrackedPeople,
    ray: &KeypointRay,
    point: &Vector3<f64>,
    robust_scale: f64,
) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let ((intrinsics, camera), sigma_px) = ray.seen_at(input, point)?;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::detector_noise::DetectorNoise;
    use crate::simulation::{Preset, SimulationConfig, simulate};
    use std::ops::Range;

    const N_FRAMES: usize = 40;

    /// Where a view that errs shows the point, m.
    const ASIDE: Vector3<f64> = Vector3::new(0.0, 0.4, 0.2);

    /// Largest distance of the path from `points` if the first `n_views` cameras see them without errors, the first of them
    /// elsewhere in the frames `wrong`.
    fn largest_error_m(points: &[Vector3<f64>], n_views: usize, wrong: &Range<usize>) -> f64 {
        let config = SimulationConfig { frames: 1, views: 4, ..SimulationConfig::preset(Preset::Paper) };
        let simulated = simulate(&config).unwrap();
        let session = &simulated.session;
        let noise = DetectorNoise::published(session.convention);
        let cameras: Vec<Option<Rigid>> = simulated.truth.cameras.into_iter().map(Some).collect();
        let input = TrackedPeople { session, noise: &noise, cameras: &cameras, tracks: &[], points: &[] };
        let ray = |t: usize, view: usize| {
            let shown = points[t] + if view == 0 && wrong.contains(&t) { ASIDE } else { Vector3::zeros() };
            let in_camera = cameras[view].unwrap().transform(&shown);
            let pixel = session.views[view].intrinsics.pixel_from_camera(&in_camera).unwrap();
            KeypointRay { t, view, pixel, sigma_m: 0.015 }
        };
        let rays: Vec<KeypointRay> = (0..points.len())
            .flat_map(|t| (0..n_views).map(move |view| (t, view)))
            .map(|(t, view)| ray(t, view))
            .collect();
        let found = path(&input, &rays, Some(points.to_vec()), acceleration_density("left_wrist"));
        found.iter().zip(points).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
    }

    /// A fist that strikes at 12 m/s and stops at once. Paths that took it for errors lagged, and its keypoints were rejected.
    #[test]
    fn strikes_that_three_views_show_are_followed() {
        let place = |t: usize| Vector3::new(0.4 * t.clamp(20, 22) as f64 - 8.0, 1.2, 0.0);
        let strike: Vec<Vector3<f64>> = (0..N_FRAMES).map(place).collect();
        let [two, three, four] = [2, 3, 4].map(|n_views| largest_error_m(&strike, n_views, &(0..0)));
        assert!(three < 0.01 && four < 0.01, "{three} {four}");
        assert!(two > 0.03, "of two views one may be wrong: {two}");
    }

    #[test]
    fn a_view_that_errs_for_a_while_moves_no_path() {
        let still = vec![Vector3::new(0.1, 1.2, -0.1); N_FRAMES];
        for n_views in [3, 4] {
            let error = largest_error_m(&still, n_views, &(15..25));
            assert!(error < 0.01, "{n_views} views: {error}");
        }
    }
}
