//! What the place of one landmark costs, given a triangulated point or a detected pixel.

use super::evidence::{PixelEvidence, PlacedCamera, PointEvidence};
use crate::optim::robust::{Robust, geman_mcclure, geman_mcclure_ceiling};
use nalgebra::{Matrix3, Vector3};

/// A robust cost over the world position of one landmark, to second order (per m, per m^2).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PlaceCost {
    pub landmark: usize,
    pub cost: f64,
    pub gradient: Vector3<f64>,
    /// Gauss-Newton's, positive semi-definite.
    pub hessian: Matrix3<f64>,
}

/// The distance to a triangulated point in units of `sigma` (m).
pub(super) fn point_cost(point: &PointEvidence, position: &Vector3<f64>, sigma: f64, robust_scale: f64) -> PlaceCost {
    let miss = (position - point.position) / sigma;
    let Robust { cost, weight, .. } = geman_mcclure(miss.norm_squared(), robust_scale);
    PlaceCost {
        landmark: point.landmark,
        cost,
        gradient: miss * (weight / sigma),
        hessian: Matrix3::identity() * (weight / (sigma * sigma)),
    }
}

/// The distance of the projection to a detected pixel in units of `sigma_px`.
///
/// Behind the camera it costs as much as an outlier can, with no direction to improve in.
pub(super) fn pixel_cost(
    pixel: &PixelEvidence,
    camera: &PlacedCamera,
    position: &Vector3<f64>,
    sigma_px: f64,
    robust_scale: f64,
) -> PlaceCost {
    let landmark = pixel.landmark;
    let in_camera = camera.camera_from_world.transform(position);
    let Some((projected, by_point)) = camera.intrinsics.project_with_jacobian(&in_camera) else {
        let cost = geman_mcclure_ceiling(robust_scale);
        return PlaceCost { landmark, cost, gradient: Vector3::zeros(), hessian: Matrix3::zeros() };
    };
    let miss = (projected - pixel.pixel) / sigma_px;
    let by_world = by_point * camera.camera_from_world.rotation / sigma_px;
    let Robust { cost, weight, .. } = geman_mcclure(miss.norm_squared(), robust_scale);
    PlaceCost {
        landmark,
        cost,
        gradient: by_world.tr_mul(&miss) * weight,
        hessian: by_world.tr_mul(&by_world) * weight,
    }
}

/// Everything that was seen of one landmark: added up before the (longer) chain of joints is walked.
pub(super) fn sum(costs: impl Iterator<Item = PlaceCost>) -> Option<PlaceCost> {
    costs.reduce(|sum, cost| PlaceCost {
        landmark: sum.landmark,
        cost: sum.cost + cost.cost,
        gradient: sum.gradient + cost.gradient,
        hessian: sum.hessian + cost.hessian,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Intrinsics, Rigid, rotation};
    use nalgebra::Vector2;

    fn camera() -> PlacedCamera {
        let dist = [-0.1, 0.02, 0.001, -0.002, 0.0].into();
        let intrinsics =
            Intrinsics { width: 1280, height: 720, fx: 900.0, fy: 910.0, cx: 640.0, cy: 360.0, skew: 0.0, dist };
        let rotation = rotation::exp(&Vector3::new(0.1, -0.4, 0.05));
        PlacedCamera { intrinsics, camera_from_world: Rigid { rotation, translation: Vector3::new(0.1, 0.2, 4.0) } }
    }

    /// Inliers and outliers; the step of 1e-5 m leaves differences good to 1e-6 relative.
    #[test]
    fn gradients_agree_with_central_differences() {
        let position = Vector3::new(0.3, -0.2, 0.4);
        for off in [3.0, 60.0] {
            let seen = camera().intrinsics.pixel_from_camera(&camera().camera_from_world.transform(&position)).unwrap();
            let pixel =
                PixelEvidence { landmark: 0, camera: 0, pixel: seen + Vector2::new(off, -off), scale_px: 400.0 };
            let point = PointEvidence { landmark: 0, position: position + Vector3::repeat(off * 0.01) };
            let of_pixel = |p: &Vector3<f64>| pixel_cost(&pixel, &camera(), p, 5.0, 4.0);
            let of_point = |p: &Vector3<f64>| point_cost(&point, p, 0.03, 4.0);
            for cost in [&of_pixel as &dyn Fn(&Vector3<f64>) -> PlaceCost, &of_point] {
                let gradient = cost(&position).gradient;
                for axis in 0..3 {
                    let step = Vector3::ith(axis, 1e-5);
                    let difference = (cost(&(position + step)).cost - cost(&(position - step)).cost) / 2e-5;
                    assert!((difference - gradient[axis]).abs() < 1e-5 * (1.0 + gradient.norm()));
                }
            }
        }
    }

    #[test]
    fn a_point_behind_the_camera_costs_as_much_as_an_outlier() {
        let pixel = PixelEvidence { landmark: 0, camera: 0, pixel: Vector2::zeros(), scale_px: 400.0 };
        let behind = camera().camera_from_world.inverse().transform(&Vector3::new(0.0, 0.0, -2.0));
        let cost = pixel_cost(&pixel, &camera(), &behind, 5.0, 4.0);
        assert_eq!((cost.cost, cost.gradient), (8.0, Vector3::zeros()));
    }
}
