//! Robust triangulation from several views, and the covariance of triangulated points.

use crate::geometry::projection::{by_left_increment, squared_offset};
use crate::geometry::triangulation::{PointObservation, RayConstraint, nearest_point, triangulate_linear};
use crate::geometry::{Intrinsics, Rigid};
use crate::optim::robust::geman_mcclure_weight;
use nalgebra::{Matrix2x3, Matrix3, Matrix3x6, Vector2, Vector3};

/// Most re-weightings of a point; its weights settle in two or three.
const REWEIGHTINGS: usize = 3;

/// Weights are settled where the last one moved the point by less than this share of the robust scale: a weight changes by less
/// than 1 %.
const SETTLED: f64 = 0.003;

/// Residual of a ray whose camera has the point behind it, m: far beyond every robust scale.
const BEHIND_CAMERA_M: f64 = 1.0;

/// The point nearest to all rays, metres in the world, with wrong rays down-weighted.
///
/// Iteratively re-weighted least squares from [`triangulate_linear`]: each ray's weight is its own times Geman and
/// McClure's, of the residual `depth |projection - normalized|` (m at the point) and `robust_scale_m`. `None` with fewer than two
/// rays or where a point is undetermined or behind one of its cameras. Two rays are not re-weighted: they do not show which one
/// is wrong.
pub fn triangulate_reweighted(rays: &[PointObservation<'_>], robust_scale_m: f64) -> Option<Vector3<f64>> {
    if rays.len() <= 2 {
        return if rays.len() == 2 { triangulate_linear(rays) } else { None };
    }
    let constraints: Vec<(&PointObservation<'_>, RayConstraint)> =
        rays.iter().filter(|ray| ray.weight > 0.0).map(|ray| (ray, RayConstraint::of(ray))).collect();
    let is_in_front = |point: &Vector3<f64>| constraints.iter().all(|(ray, _)| depth(ray, point) > 0.0);
    let nearest = |weight: &dyn Fn(&PointObservation<'_>) -> f64| {
        let weighted = constraints.iter().map(|(ray, constraint)| (*constraint, weight(ray)));
        nearest_point(weighted).filter(is_in_front)
    };
    let mut point = nearest(&|ray| ray.weight)?;
    for _ in 0..REWEIGHTINGS {
        let weight = |ray: &PointObservation<'_>| {
            let squared = squared_offset(ray.camera_from_world, &point, &ray.normalized);
            let squared = squared.unwrap_or(BEHIND_CAMERA_M * BEHIND_CAMERA_M);
            ray.weight * geman_mcclure_weight(squared, robust_scale_m * robust_scale_m)
        };
        let next = nearest(&weight)?;
        let moved = (next - point).norm();
        point = next;
        if moved < SETTLED * robust_scale_m {
            break;
        }
    }
    Some(point)
}

fn depth(ray: &PointObservation<'_>, point: &Vector3<f64>) -> f64 {
    ray.camera_from_world.transform(point).z
}

/// The detected pixel of a point in one of the views.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RayObservation<'a> {
    /// The view's pose.
    pub camera_from_world: &'a Rigid,
    /// The view's intrinsics.
    pub intrinsics: &'a Intrinsics,
    /// Detected pixel (distorted).
    pub pixel: Vector2<f64>,
    /// Standard deviation along each axis, px, positive.
    pub sigma_px: f64,
}

/// Covariance of a point (m^2) from two observations or more: `(sum J^T J / sigma^2)^-1`.
///
/// Backward transport of covariance, Hartley and Zisserman 2003, section 5.2. `None` with fewer than two observations in
/// front of their cameras, or where they do not determine the point. Exact cameras and independent errors are assumed.
pub fn covariance<'a>(
    point: &Vector3<f64>,
    observations: impl Iterator<Item = &'a RayObservation<'a>>,
) -> Option<Matrix3<f64>> {
    let (mut information, mut n) = (Matrix3::zeros(), 0);
    for jacobian in observations.filter_map(|observation| whitened_jacobian(point, observation)) {
        information += jacobian.tr_mul(&jacobian);
        n += 1;
    }
    if n < 2 { None } else { Some(information.cholesky()?.inverse()) }
}

/// Movement of the point by the left increment (rho, phi) of one observation's `camera_from_world`:
/// `-C J^T J_camera / sigma^2` with `C` its [`covariance`]; `None` behind the camera.
pub fn point_by_camera(
    point: &Vector3<f64>,
    observation: &RayObservation<'_>,
    covariance: &Matrix3<f64>,
) -> Option<Matrix3x6<f64>> {
    let camera = observation.camera_from_world;
    let in_camera = camera.transform(point);
    let (_, by_point) = observation.intrinsics.project_with_jacobian(&in_camera)?;
    let by_pixel = covariance * camera.rotation.transpose() * by_point.transpose();
    Some(by_pixel * by_left_increment(&by_point, &in_camera) * -observation.sigma_px.powi(-2))
}

/// Derivative of the reprojection error in sigmas to the point (1 / m); `None` behind the camera.
fn whitened_jacobian(point: &Vector3<f64>, observation: &RayObservation<'_>) -> Option<Matrix2x3<f64>> {
    let camera = observation.camera_from_world;
    let (_, by_point) = observation.intrinsics.project_with_jacobian(&camera.transform(point))?;
    Some(by_point * camera.rotation * (1.0 / observation.sigma_px))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::projection::project_normalized;
    use crate::geometry::{free_network, rotation};
    use nalgebra::SMatrix;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};

    const SIGMA_PX: f64 = 3.0;

    /// Cameras on a circle of 5 m that look at its middle.
    fn cameras(n: usize) -> Vec<Rigid> {
        let turn = |i: usize| rotation::exp(&(Vector3::y() * (i as f64 * std::f64::consts::TAU / n as f64)));
        (0..n).map(|i| Rigid { rotation: turn(i), translation: Vector3::z() * 5.0 }).collect()
    }

    fn observe<'a>(
        cameras: &'a [Rigid],
        point: &Vector3<f64>,
        mut jitter: impl FnMut() -> f64,
    ) -> Vec<PointObservation<'a>> {
        let mut see = |camera_from_world: &'a Rigid| {
            let exact = project_normalized(camera_from_world, point).unwrap().normalized;
            PointObservation { camera_from_world, normalized: exact.map(|c| c + jitter()), weight: 1.0 }
        };
        cameras.iter().map(&mut see).collect()
    }

    fn random_point(rng: &mut ChaCha8Rng) -> Vector3<f64> {
        Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0))
    }

    #[test]
    fn one_wrong_ray_of_five_is_down_weighted() {
        let cameras = cameras(5);
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for trial in 0..100 {
            let point = random_point(&mut rng);
            let mut rays = observe(&cameras, &point, || 0.0);
            assert!((triangulate_reweighted(&rays, 0.06).unwrap() - point).norm() < 1e-9);
            rays[trial % 5].normalized += Vector2::repeat(0.03);
            let linear = (triangulate_linear(&rays).unwrap() - point).norm();
            let reweighted = (triangulate_reweighted(&rays, 0.06).unwrap() - point).norm();
            assert!(reweighted < 0.5 * linear, "{reweighted} {linear}");
        }
    }

    #[test]
    fn too_few_or_parallel_rays_give_none() {
        let cameras = cameras(5);
        let rays = observe(&cameras, &Vector3::new(0.3, 0.2, -0.1), || 0.0);
        assert_eq!(triangulate_reweighted(&[], 0.06), None);
        assert_eq!(triangulate_reweighted(&[rays[0]], 0.06), None);
        assert_eq!(triangulate_reweighted(&[rays[0]; 200], 0.06), None);
    }

    /// Images stay as they are when cameras and point move by the same similarity.
    #[test]
    fn a_point_follows_a_similarity_of_its_cameras() {
        let (cameras, point) = (cameras(4), Vector3::new(0.3, -0.2, 0.4));
        let ray = |camera_from_world| RayObservation {
            camera_from_world,
            intrinsics: &Intrinsics::PLAIN,
            pixel: Vector2::zeros(),
            sigma_px: SIGMA_PX,
        };
        let rays: Vec<RayObservation<'_>> = cameras.iter().map(ray).collect();
        let covariance = covariance(&point, rays.iter()).unwrap();
        let directions = free_network::similarity_directions(&cameras);
        let mut moved = SMatrix::<f64, 3, 7>::zeros();
        for (k, ray) in rays.iter().enumerate() {
            moved += point_by_camera(&point, ray, &covariance).unwrap() * directions.fixed_view::<6, 7>(6 * k, 0);
        }
        assert!((moved - free_network::point_directions(&cameras, &point)).norm() < 1e-9, "{moved}");
    }

    #[test]
    fn the_covariance_predicts_the_scatter() {
        let cameras = cameras(4);
        let lens = Intrinsics::PLAIN;
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let normal = Normal::new(0.0, SIGMA_PX / lens.focal()).unwrap();
        let (mut sum, n) = (0.0, 2000);
        for _ in 0..n {
            let point = random_point(&mut rng) * 0.3; // at nearly equal depths, where the linear solution is the best one
            let rays = observe(&cameras, &point, || normal.sample(&mut rng));
            let found = triangulate_linear(&rays).unwrap();
            let observations: Vec<RayObservation<'_>> = rays
                .iter()
                .map(|ray| RayObservation {
                    camera_from_world: ray.camera_from_world,
                    intrinsics: &lens,
                    pixel: lens.pixel_from_normalized(&ray.normalized),
                    sigma_px: SIGMA_PX,
                })
                .collect();
            let (error, covariance) = (found - point, covariance(&found, observations.iter()).unwrap());
            sum += error.dot(&(covariance.try_inverse().unwrap() * error));
        }
        // Chi-square of three degrees of freedom: mean 3, known to 0.055 from 2,000 points.
        let mean = sum / f64::from(n);
        assert!((2.7..3.4).contains(&mean), "{mean}");
    }
}
