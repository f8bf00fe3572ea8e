//! Detections of every keypoint against its reprojection, and the accuracy of its triangulation.

use crate::body::detector_noise::DetectorNoise;
use crate::body::detector_profile::{DETECTOR, error_scale, least_error_scale};
use crate::estimation::triangulation::{RayObservation, covariance, point_by_camera};
use crate::geometry::Rigid;
use crate::geometry::free_network::CameraCovariance;
use crate::pipeline::calibration::TrackedPeople;
use crate::session::recording::{Detection, Session, View};
use crate::session::{JointTrajectory, PersonTrack};
use nalgebra::{Matrix3, Matrix3xX, Vector2, Vector3};
use rayon::prelude::*;

/// Distances of detections from their reprojections.
#[derive(Debug, Clone, Default)]
pub(super) struct Misfits {
    /// Distances of explained detections, px.
    pub(super) px: Vec<f64>,
    /// The same at the point's depth, mm: `px * depth / focal`.
    pub(super) mm: Vec<f64>,
    /// Number of detections that are not explained.
    pub(super) n_rejected: usize,
}

impl Misfits {
    /// The union of several.
    pub(super) fn together<'a>(parts: impl Iterator<Item = &'a Self>) -> Self {
        parts.fold(Self::default(), |mut sum, part| {
            sum.px.extend_from_slice(&part.px);
            sum.mm.extend_from_slice(&part.mm);
            sum.n_rejected += part.n_rejected;
            sum
        })
    }

    /// Number of detections, explained or not.
    pub(super) fn n_detections(&self) -> usize {
        self.px.len() + self.n_rejected
    }

    /// Share of detections that are not explained, 0 to 1.
    pub(super) fn rejected(&self) -> f64 {
        self.n_rejected as f64 / self.n_detections().max(1) as f64
    }
}

/// One keypoint of one person.
#[derive(Debug, Clone)]
pub(super) struct KeypointStatistics {
    /// Per view.
    pub(super) by_view: Vec<Misfits>,
    /// Per frame in which two views or more agree: standard deviation in space (root of the trace of the covariance) over
    /// that of one ray of full confidence. The position dilution of precision of satellite navigation.
    pub(super) dilutions: Vec<f64>,
    /// Per such frame: variance of the point from that of the cameras, after a similarity alignment, m^2.
    pub(super) camera_variances: Vec<f64>,
    /// Per such frame: angle between two rays, of the pair nearest to a right angle, 0 to pi/2.
    pub(super) ray_angles: Vec<f64>,
    /// Explained distances of such frames as errors of one ray before the fit of the point, m on the body, scaled to a
    /// detector's factor of 1.
    pub(super) ray_errors: Vec<f64>,
    /// Over pairs of such errors of a view in successive frames: sums of products, and of mean squares.
    pub(super) over_time: [f64; 2],
    /// By view the frame of the latest error, and the error in units of its standard deviation.
    latest: Vec<Option<(usize, Vector2<f64>)>>,
}

/// One person.
#[derive(Debug, Clone)]
pub(super) struct PersonStatistics {
    /// Per keypoint.
    pub(super) keypoints: Vec<KeypointStatistics>,
    /// Number of detections in placed views.
    pub(super) n_detections: usize,
    /// Share of the track's frames in which at least two placed views see the person.
    pub(super) share_in_two_views: f64,
}

impl PersonStatistics {
    /// Misfits of all keypoints.
    pub(super) fn misfits(&self) -> Misfits {
        Misfits::together(self.keypoints.iter().flat_map(|k| &k.by_view))
    }
}

/// Compares all trajectories with all detections; persons in the order of the tracks.
///
/// `covariance`: of the placed cameras; without one they count as exact.
pub(super) fn people_statistics(
    people: &TrackedPeople,
    covariance: Option<&CameraCovariance>,
) -> Vec<PersonStatistics> {
    let rows = people.tracks.par_iter().zip(people.points);
    rows.map(|(track, path)| person_statistics(people, covariance, track, path)).collect()
}

fn person_statistics(
    people: &TrackedPeople,
    covariance: Option<&CameraCovariance>,
    track: &PersonTrack,
    path: &JointTrajectory,
) -> PersonStatistics {
    let TrackedPeople { session, cameras, noise, .. } = *people;
    let nothing = KeypointStatistics {
        by_view: vec![Misfits::default(); session.views.len()],
        dilutions: Vec::new(),
        camera_variances: Vec::new(),
        ray_angles: Vec::new(),
        ray_errors: Vec::new(),
        over_time: [0.0; 2],
        latest: vec![None; session.views.len()],
    };
    let mut keypoints = vec![nothing; path.points.first().map_or(0, Vec::len)];
    let (mut n_detections, mut n_in_two_views) = (0, 0);
    for (t, (assignment, points)) in track.detections.iter().zip(&path.points).enumerate() {
        let detections = placed_detections(session, cameras, assignment, track.first.0 + t);
        n_detections += detections.len();
        n_in_two_views += usize::from(detections.len() >= 2);
        let (mut located, mut movements) = (Vec::new(), Vec::new());
        for (k, (point, statistics)) in points.iter().zip(&mut keypoints).enumerate() {
            let Some(point) = point else { continue };
            let rays = detections.iter().filter_map(|s| s.ray(noise, k, point)).collect();
            if let Some(by_cameras) = statistics.add(t, point, rays, covariance.map_or(0, CameraCovariance::n_cameras))
            {
                located.push(k);
                movements.push((*point, by_cameras));
            }
        }
        let variances =
            covariance.map_or_else(|| vec![0.0; located.len()], |cameras| cameras.point_variances(&movements));
        located.iter().zip(variances).for_each(|(&k, variance)| keypoints[k].camera_variances.push(variance));
    }
    let share_in_two_views = n_in_two_views as f64 / track.detections.len().max(1) as f64;
    PersonStatistics { keypoints, n_detections, share_in_two_views }
}

/// A person's detection in a placed view.
struct PlacedDetection<'a> {
    index: usize,
    /// Number of the camera among the placed ones.
    placed: usize,
    view: &'a View,
    camera: &'a Rigid,
    detection: &'a Detection,
}

fn placed_detections<'a>(
    session: &'a Session,
    cameras: &'a [Option<Rigid>],
    assignment: &[Option<usize>],
    frame: usize,
) -> Vec<PlacedDetection<'a>> {
    let views = session.views.iter().zip(cameras).zip(assignment).enumerate();
    let placed =
        views.filter_map(|(index, ((view, camera), detection))| Some((index, view, camera.as_ref()?, detection)));
    let detected = placed.enumerate().filter_map(|(placed, (index, view, camera, detection))| {
        Some(PlacedDetection { index, placed, view, camera, detection: &view.frames[frame][(*detection)?] })
    });
    detected.collect()
}

/// One confident detection of a point.
struct PointRay<'a> {
    view: usize,
    /// Number of the camera among the placed ones.
    placed: usize,
    /// Its standard deviation is an error of 1 m on the body, px, times the detector's factor.
    observation: RayObservation<'a>,
    /// From its reprojection, px.
    error_px: Vector2<f64>,
    /// Metres at the point's depth per pixel.
    metres_per_px: f64,
}

impl<'a> PlacedDetection<'a> {
    fn ray(&self, noise: &DetectorNoise, keypoint: usize, point: &Vector3<f64>) -> Option<PointRay<'a>> {
        let seen = self.detection.keypoints.get(keypoint).filter(|k| k.confidence >= DETECTOR.judged)?;
        let intrinsics = &self.view.intrinsics;
        let in_camera = self.camera.transform(point);
        let error_px = seen.pixel - intrinsics.pixel_from_camera(&in_camera)?;
        let metres_per_px = in_camera.z / intrinsics.focal();
        let sigma_px = noise.factor(seen.confidence) / metres_per_px;
        let observation = RayObservation { camera_from_world: self.camera, intrinsics, pixel: seen.pixel, sigma_px };
        Some(PointRay { view: self.index, placed: self.placed, observation, error_px, metres_per_px })
    }
}

impl PointRay<'_> {
    fn distance_px(&self) -> f64 {
        self.error_px.norm()
    }

    fn is_explained(&self) -> bool {
        let intrinsics = self.observation.intrinsics;
        let focal = intrinsics.focal();
        let scale = error_scale(self.metres_per_px * focal, least_error_scale(intrinsics));
        self.distance_px() < scale * DETECTOR.explained_radius * focal
    }

    /// Unit vector from the camera to the point.
    fn direction_to(&self, point: &Vector3<f64>) -> Vector3<f64> {
        (point - self.observation.camera_from_world.center()).normalize()
    }
}

impl KeypointStatistics {
    /// Adds the detections of a point in frame `t`. Where two views or more agree, returns the movement of the point by the placed
    /// cameras. [3, 6 `n_cameras`]
    fn add(
        &mut self,
        t: usize,
        point: &Vector3<f64>,
        mut rays: Vec<PointRay>,
        n_cameras: usize,
    ) -> Option<Matrix3xX<f64>> {
        for ray in &rays {
            let misfits = &mut self.by_view[ray.view];
            if ray.is_explained() {
                misfits.px.push(ray.distance_px());
                misfits.mm.push(1e3 * ray.distance_px() * ray.metres_per_px);
            } else {
                misfits.n_rejected += 1;
            }
        }
        rays.retain(PointRay::is_explained);
        let of_unit_rays = covariance(point, rays.iter().map(|ray| &ray.observation))?;
        self.dilutions.push(of_unit_rays.trace().sqrt());
        self.ray_angles.push(widest_crossing(point, &rays));
        let factor = error_per_residual(rays.len());
        self.ray_errors.extend(rays.iter().map(|ray| factor * ray.distance_px() / ray.observation.sigma_px));
        for ray in &rays {
            let error = ray.error_px / ray.observation.sigma_px;
            if let Some((_, before)) = self.latest[ray.view].filter(|(frame, _)| frame + 1 == t) {
                self.over_time[0] += error.dot(&before);
                self.over_time[1] += 0.5 * (error.norm_squared() + before.norm_squared());
            }
            self.latest[ray.view] = Some((t, error));
        }
        Some(by_cameras(point, &rays, &of_unit_rays, n_cameras))
    }
}

/// Movement of a point by its cameras; `of_unit_rays`: its covariance from unit rays. Empty without cameras.
fn by_cameras(
    point: &Vector3<f64>,
    rays: &[PointRay],
    of_unit_rays: &Matrix3<f64>,
    n_cameras: usize,
) -> Matrix3xX<f64> {
    let mut by_cameras = Matrix3xX::zeros(6 * n_cameras);
    if n_cameras == 0 {
        return by_cameras;
    }
    for ray in rays {
        if let Some(by_camera) = point_by_camera(point, &ray.observation, of_unit_rays) {
            by_cameras.fixed_columns_mut::<6>(6 * ray.placed).copy_from(&by_camera);
        }
    }
    by_cameras
}

/// Ratio of error to residual of a point triangulated from `n` views: the point absorbs three of `2 n` degrees of freedom,
/// so the residual is `sqrt(1 - 3 / 2n)` of the error (Hartley and Zisserman 2003, result 5.1).
fn error_per_residual(n: usize) -> f64 {
    (1.0 - 1.5 / n as f64).sqrt().recip()
}

/// Angle between two of the rays to a point, of the pair nearest to a right angle, 0 to pi/2.
fn widest_crossing(point: &Vector3<f64>, rays: &[PointRay]) -> f64 {
    let directions: Vec<Vector3<f64>> = rays.iter().map(|ray| ray.direction_to(point)).collect();
    let pairs = directions.iter().enumerate().flat_map(|(i, a)| directions[..i].iter().map(move |b| a.dot(b).abs()));
    pairs.fold(1.0, f64::min).acos()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::triangulation::{PointObservation, triangulate_linear};
    use crate::geometry::{Intrinsics, rotation};
    use crate::optim::robust::{MEDIAN_LENGTH_IN_PLANE, median};
    use nalgebra::Vector2;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};

    const LENS: Intrinsics = Intrinsics::PLAIN;

    /// Cameras that look at the origin from 4 m, given by their angles about the vertical, degrees.
    fn cameras(angles_deg: &[f64]) -> Vec<Rigid> {
        let turn = |angle: &f64| rotation::exp(&(Vector3::y() * angle.to_radians()));
        angles_deg.iter().map(|a| Rigid { rotation: turn(a), translation: Vector3::z() * 4.0 }).collect()
    }

    /// Detections of `point` at these pixels with full confidence.
    fn rays<'a>(cameras: &'a [Rigid], pixels: &[Vector2<f64>], point: &Vector3<f64>) -> Vec<PointRay<'a>> {
        let ray = |(view, (camera, pixel)): (usize, (&'a Rigid, &Vector2<f64>))| {
            let in_camera = camera.transform(point);
            let metres_per_px = in_camera.z / LENS.focal();
            let observation = RayObservation {
                camera_from_world: camera,
                intrinsics: &LENS,
                pixel: *pixel,
                sigma_px: metres_per_px.recip(),
            };
            let error_px = pixel - LENS.pixel_from_camera(&in_camera).unwrap();
            PointRay { view, placed: view, observation, error_px, metres_per_px }
        };
        cameras.iter().zip(pixels).enumerate().map(ray).collect()
    }

    fn statistics(n_views: usize) -> KeypointStatistics {
        let by_view = vec![Misfits::default(); n_views];
        let (dilutions, camera_variances, ray_angles, ray_errors, over_time) = Default::default();
        let latest = vec![None; n_views];
        KeypointStatistics { by_view, dilutions, camera_variances, ray_angles, ray_errors, over_time, latest }
    }

    #[test]
    fn dilution_of_two_rays_follows_their_angle() {
        for (angle_deg, folded_deg) in [(90.0, 90.0), (30.0, 30.0), (170.0, 10.0)] {
            let cameras = cameras(&[0.0, angle_deg]);
            let mut found = statistics(2);
            let middle = [Vector2::new(LENS.cx, LENS.cy); 2];
            found.add(0, &Vector3::zeros(), rays(&cameras, &middle, &Vector3::zeros()), 0);
            // Information of two planes across the rays: 2, 1 + cos a, 1 - cos a.
            let cosine = f64::to_radians(angle_deg).cos();
            let expected = (0.5 + 1.0 / (1.0 + cosine) + 1.0 / (1.0 - cosine)).sqrt();
            assert!((found.dilutions[0] / expected - 1.0).abs() < 1e-9, "{angle_deg}");
            assert!((found.ray_angles[0].to_degrees() - folded_deg).abs() < 1e-6, "{angle_deg}");
        }
    }

    #[test]
    fn stated_sigma_matches_the_scatter_of_points() {
        const SIGMA_PX: f64 = 4.0;
        let cameras = cameras(&[0.0, 60.0, 130.0, 200.0]);
        let noise = Normal::new(0.0, SIGMA_PX).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut found = statistics(cameras.len());
        let (mut squared, n) = (0.0, 2000);
        for _ in 0..n {
            let pixels: Vec<Vector2<f64>> = cameras
                .iter()
                .map(|_| Vector2::new(LENS.cx + noise.sample(&mut rng), LENS.cy + noise.sample(&mut rng)))
                .collect();
            let observation = |(camera_from_world, pixel)| {
                let normalized = LENS.normalized_from_pixel(pixel);
                PointObservation { camera_from_world, normalized, weight: 1.0 }
            };
            let observations: Vec<PointObservation> = cameras.iter().zip(&pixels).map(observation).collect();
            let point = triangulate_linear(&observations).unwrap();
            squared += point.norm_squared();
            found.add(0, &point, rays(&cameras, &pixels, &point), 0);
        }
        let scatter = (squared / n as f64).sqrt();
        let ray_sigma = median(&mut found.ray_errors).unwrap() / MEDIAN_LENGTH_IN_PLANE;
        assert!((ray_sigma / (SIGMA_PX * 4.0 / 1000.0) - 1.0).abs() < 0.05, "{ray_sigma} m");
        let stated = ray_sigma * median(&mut found.dilutions).unwrap();
        assert!((stated / scatter - 1.0).abs() < 0.06, "{stated} m stated, {scatter} m found");
        assert_eq!(found.by_view[0].n_rejected, 0);
    }

    #[test]
    fn far_detections_are_rejected_and_not_triangulated() {
        let cameras = cameras(&[0.0, 90.0]);
        let mut found = statistics(2);
        let pixels = [Vector2::new(LENS.cx, LENS.cy), Vector2::new(LENS.cx + 30.0, LENS.cy)];
        found.add(0, &Vector3::zeros(), rays(&cameras, &pixels, &Vector3::zeros()), 0);
        assert_eq!((found.by_view[0].px.len(), found.by_view[1].n_rejected), (1, 1));
        assert!(found.dilutions.is_empty());
        assert_eq!(Misfits::together(found.by_view.iter()).rejected(), 0.5);
    }

    #[test]
    fn millimetres_are_measured_at_the_depth_of_the_point() {
        let cameras = cameras(&[0.0, 90.0]);
        let mut found = statistics(2);
        let pixels = [Vector2::new(LENS.cx + 10.0, LENS.cy), Vector2::new(LENS.cx, LENS.cy)];
        found.add(0, &Vector3::zeros(), rays(&cameras, &pixels, &Vector3::zeros()), 0);
        assert!((found.by_view[0].mm[0] - 40.0).abs() < 1e-9, "10 px at 4 m and 1000 px");
    }
}
