//! The image of a point against its detection.

use super::position_cost::PositionCost;
use crate::geometry::projection::{by_left_increment, project_normalized};
use crate::geometry::{Intrinsics, Rigid};
use crate::optim::robust::{Robust, geman_mcclure, geman_mcclure_ceiling};
use nalgebra::{Matrix2, Matrix2x3, Matrix2x6, Matrix3, Vector2, Vector3};

/// A reprojection residual and its derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reprojection {
    /// `(pixel_from_camera(X) - pixel) / sigma_px`.
    pub residual: Vector2<f64>,
    /// By the point in the world: `Jpi R`, per m.
    pub by_point: Matrix2x3<f64>,
    /// By the camera's left increment (rho, phi) of [`Rigid::perturbed_left`]: `Jpi [ I | -[Xc]x ]`.
    pub by_camera: Matrix2x6<f64>,
    /// By the logarithm of a common factor on both focal lengths (and the skew): pixel from the principal point.
    pub by_log_focal: Vector2<f64>,
}

impl Reprojection {
    /// The residual and its derivatives times `whitening`, the square root of the inverse of an anisotropic error's covariance.
    pub fn whitened(&self, whitening: &Matrix2<f64>) -> Self {
        Self {
            residual: whitening * self.residual,
            by_point: whitening * self.by_point,
            by_camera: whitening * self.by_camera,
            by_log_focal: whitening * self.by_log_focal,
        }
    }
}

/// The residual alone, with the roundings of [`linearize`]; `None` where the point lies behind the camera.
#[inline(always)]
pub fn residual(
    intrinsics: &Intrinsics,
    camera_from_world: &Rigid,
    point_in_world: &Vector3<f64>,
    pixel: &Vector2<f64>,
    sigma_px: f64,
) -> Option<Vector2<f64>> {
    let (predicted, _) = intrinsics.project_with_jacobian(&camera_from_world.transform(point_in_world))?;
    Some((predicted - pixel) * sigma_px.recip())
}

/// The residual with its derivatives (method.md 9.1); `None` where the point lies behind the camera.
///
/// `pixel`: as detected, distorted. `sigma_px`: its standard deviation per axis, positive.
#[inline(always)]
pub fn linearize(
    intrinsics: &Intrinsics,
    camera_from_world: &Rigid,
    point_in_world: &Vector3<f64>,
    pixel: &Vector2<f64>,
    sigma_px: f64,
) -> Option<Reprojection> {
    let p = camera_from_world.transform(point_in_world);
    let (predicted, by_p) = intrinsics.project_with_jacobian(&p)?;
    let per_sigma = sigma_px.recip();
    let by_p = by_p * per_sigma;
    Some(Reprojection {
        residual: (predicted - pixel) * per_sigma,
        by_point: by_p * camera_from_world.rotation,
        by_camera: by_left_increment(&by_p, &p),
        by_log_focal: (predicted - Vector2::new(intrinsics.cx, intrinsics.cy)) * per_sigma,
    })
}

/// Derivative of the residual by the first radial coefficient of the lens; zero where the point lies behind the camera.
#[inline(always)]
pub fn by_radial(
    intrinsics: &Intrinsics,
    camera_from_world: &Rigid,
    point_in_world: &Vector3<f64>,
    sigma_px: f64,
) -> Vector2<f64> {
    let normalized = project_normalized(camera_from_world, point_in_world).map(|seen| seen.normalized);
    normalized.map_or_else(Vector2::zeros, |n| intrinsics.by_radial(&n) * sigma_px.recip())
}

/// Geman-McClure cost of the residual as a function of the point alone.
///
/// A point behind the camera costs as much as an outlier can, with zero derivatives. `robust_scale`: in standard deviations.
pub fn pixel_cost(
    intrinsics: &Intrinsics,
    camera_from_world: &Rigid,
    point_in_world: &Vector3<f64>,
    pixel: &Vector2<f64>,
    sigma_px: f64,
    robust_scale: f64,
) -> PositionCost {
    let point_in_camera = camera_from_world.transform(point_in_world);
    let Some((predicted, by_p)) = intrinsics.project_with_jacobian(&point_in_camera) else {
        let cost = geman_mcclure_ceiling(robust_scale);
        return PositionCost { cost, gradient: Vector3::zeros(), hessian: Matrix3::zeros() };
    };
    let residual = (predicted - pixel) / sigma_px;
    let by_point = by_p * camera_from_world.rotation / sigma_px;
    let Robust { cost, weight, .. } = geman_mcclure(residual.norm_squared(), robust_scale);
    PositionCost { cost, gradient: by_point.tr_mul(&residual) * weight, hessian: by_point.tr_mul(&by_point) * weight }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Distortion, rotation};
    use crate::residuals::derivative_check::{assert_derivative, assert_gradient};
    use nalgebra::DMatrix;

    const INTRINSICS: Intrinsics = Intrinsics {
        fx: 900.0,
        fy: 910.0,
        cy: 350.0,
        skew: 3.0,
        dist: Distortion::OpenCv5([-0.2, 0.07, 0.002, -0.001, -0.01]),
        ..Intrinsics::PLAIN
    };

    #[test]
    fn derivatives_match_central_differences() {
        let camera =
            Rigid { rotation: rotation::exp(&Vector3::new(0.3, -0.8, 0.2)), translation: Vector3::new(0.2, -0.4, 4.0) };
        let (point, pixel) = (Vector3::new(0.5, -0.3, 0.6), Vector2::new(500.0, 300.0));
        let whitening = Matrix2::new(1.5, -0.4, -0.4, 0.8);
        let found = linearize(&INTRINSICS, &camera, &point, &pixel, 2.5).unwrap().whitened(&whitening);
        let mut jacobian = DMatrix::zeros(2, 11);
        jacobian.view_mut((0, 0), (2, 3)).copy_from(&found.by_point);
        jacobian.view_mut((0, 3), (2, 6)).copy_from(&found.by_camera);
        jacobian.view_mut((0, 9), (2, 1)).copy_from(&found.by_log_focal);
        let by_radial = whitening * by_radial(&INTRINSICS, &camera, &point, 2.5);
        jacobian.view_mut((0, 10), (2, 1)).copy_from(&by_radial);
        assert_derivative(&jacobian, |d| {
            let factor = d[9].exp();
            let lens = Intrinsics {
                fx: INTRINSICS.fx * factor,
                fy: INTRINSICS.fy * factor,
                skew: INTRINSICS.skew * factor,
                ..INTRINSICS.with_radial(d[10])
            };
            let moved = camera.perturbed_left(&Vector3::new(d[3], d[4], d[5]), &Vector3::new(d[6], d[7], d[8]));
            let point = point + Vector3::new(d[0], d[1], d[2]);
            (whitening * residual(&lens, &moved, &point, &pixel, 2.5).unwrap()).as_slice().to_vec()
        });
    }

    #[test]
    fn a_point_on_the_axis_projects_to_the_centre() {
        let camera = Rigid { rotation: nalgebra::Matrix3::identity(), translation: Vector3::new(0.0, 0.0, 2.0) };
        let found = residual(&INTRINSICS, &camera, &Vector3::zeros(), &Vector2::new(638.0, 353.0), 2.0).unwrap();
        assert_eq!(found, Vector2::new(1.0, -1.5));
        assert_eq!(residual(&INTRINSICS, &camera, &Vector3::new(0.0, 0.0, -3.0), &Vector2::zeros(), 1.0), None);
    }

    #[test]
    fn cost_gradient_matches_for_inlier_and_outlier() {
        let camera =
            Rigid { rotation: rotation::exp(&Vector3::new(0.1, -0.4, 0.05)), translation: Vector3::new(0.1, 0.2, 4.0) };
        let point = Vector3::new(0.3, -0.2, 0.4);
        let exact = INTRINSICS.pixel_from_camera(&camera.transform(&point)).unwrap();
        for off in [3.0, 60.0] {
            let pixel = exact + Vector2::new(off, -off);
            let cost = |d: &[f64]| {
                pixel_cost(&INTRINSICS, &camera, &(point + Vector3::from_column_slice(d)), &pixel, 5.0, 4.0)
            };
            assert_gradient(cost(&[0.0; 3]).gradient.as_slice(), |d| cost(d).cost);
        }
    }

    #[test]
    fn a_point_behind_the_camera_costs_as_an_outlier() {
        let behind = Vector3::new(0.0, 0.0, -2.0);
        let cost = pixel_cost(&INTRINSICS, &Rigid::identity(), &behind, &Vector2::zeros(), 5.0, 4.0);
        assert_eq!((cost.cost, cost.gradient), (8.0, Vector3::zeros()));
    }
}
