//! A point from several views, some of them wrong, in pixels and with its covariance.

use super::descent::{QuadraticModel, descend};
use super::{geman_mcclure, geman_mcclure_weight};
use crate::geometry::triangulation::{PointObservation, triangulate_linear};
use crate::geometry::{Intrinsics, Rigid};
use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};

/// One view's detection of a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RayObservation<'a> {
    /// The view's pose.
    pub camera_from_world: &'a Rigid,
    /// The view's intrinsics.
    pub intrinsics: &'a Intrinsics,
    /// As detected (distorted).
    pub pixel: Vector2<f64>,
    /// Standard deviation along each axis, px; not finite or not positive: the observation is ignored.
    pub sigma_px: f64,
}

/// A point that views agree on.
#[derive(Debug, Clone, PartialEq)]
pub struct TriangulatedPoint {
    /// World position, m.
    pub point: Vector3<f64>,
    /// Which observations lie within [`INLIER_SIGMAS`] of the point, in the order given; at least two.
    pub inliers: Vec<bool>,
    /// Geman-McClure cost of all observations, sigma^2: each costs at most `INLIER_SIGMAS^2`.
    pub cost: f64,
    /// Covariance of the point (m^2) from the inliers: `(sum J^T J / sigma^2)^-1`. Exact cameras are assumed.
    pub covariance: Matrix3<f64>,
}

/// Scale of the robust loss, and the distance within which an observation counts as an inlier: a right one stays
/// within it with 98.9 % (two degrees of freedom).
pub const INLIER_SIGMAS: f64 = 3.0;

const SCALE2: f64 = INLIER_SIGMAS * INLIER_SIGMAS;

/// Linearisations of the refinement; from a linear start three or four suffice.
const ITERATIONS: usize = 10;

/// View pairs that are tried at most: all of 12 views. Of more views an even selection is taken.
const MAX_PAIRS: usize = 66;

/// Finds the point with the least Geman-McClure cost of reprojection errors in units of their sigma.
///
/// All views together come first; only where they do not all agree is every pair of views tried as a start. `None` where
/// fewer than two views agree in front of their cameras, or the rays are too parallel to tell the depth.
///
/// Known limit: two views agree about any two rays that meet; with two views alone an outlier shows only by its cost.
pub fn triangulate_robust(observations: &[RayObservation<'_>]) -> Option<TriangulatedPoint> {
    let point_observations: Vec<PointObservation<'_>> = observations.iter().map(point_observation).collect();
    let together = triangulate_linear(&point_observations).map(|start| refine(start, observations));
    if let Some(point) = together {
        let judged = judge(&point, observations);
        if judged.as_ref().is_some_and(|j| agrees_with_all(j, &point_observations)) {
            return judged;
        }
    }
    let best = best_pair_point(&point_observations, observations).map(|start| refine(start, observations));
    let cost = |point: &Vector3<f64>| robust_cost(point, observations);
    let point = [together, best].into_iter().flatten().min_by(|a, b| cost(a).total_cmp(&cost(b)))?;
    judge(&point, observations)
}

/// Weighted by the inverse of the angular variance.
fn point_observation<'a>(observation: &RayObservation<'a>) -> PointObservation<'a> {
    let RayObservation { camera_from_world, intrinsics, pixel, sigma_px } = *observation;
    let angular_sigma = sigma_px / intrinsics.focal();
    let usable = is_usable(observation) && angular_sigma.is_finite() && angular_sigma > 0.0;
    let weight = if usable { 1.0 / (angular_sigma * angular_sigma) } else { 0.0 };
    PointObservation { camera_from_world, normalized: intrinsics.normalized_from_pixel(&pixel), weight }
}

fn is_usable(observation: &RayObservation<'_>) -> bool {
    let RayObservation { pixel, sigma_px, .. } = observation;
    *sigma_px > 0.0 && sigma_px.is_finite() && pixel.x.is_finite() && pixel.y.is_finite()
}

fn agrees_with_all(judged: &TriangulatedPoint, point_observations: &[PointObservation<'_>]) -> bool {
    judged
        .inliers
        .iter()
        .zip(point_observations)
        .all(|(&inlier, point_observation)| inlier || point_observation.weight == 0.0)
}

/// The cheapest of the points of all pairs of views.
fn best_pair_point(
    point_observations: &[PointObservation<'_>],
    observations: &[RayObservation<'_>],
) -> Option<Vector3<f64>> {
    let n = point_observations.len();
    let stride = (n * n.saturating_sub(1) / 2).div_ceil(MAX_PAIRS).max(1);
    let pairs = (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j))).step_by(stride);
    let points = pairs.filter_map(|(i, j)| triangulate_linear(&[point_observations[i], point_observations[j]]));
    let priced = points.map(|point| (robust_cost(&point, observations), point));
    priced.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, point)| point)
}

/// Squared reprojection error in sigma^2; infinite behind the camera.
fn squared_error(point: &Vector3<f64>, observation: &RayObservation<'_>) -> f64 {
    let in_camera = observation.camera_from_world.transform(point);
    let projected = observation.intrinsics.pixel_from_camera(&in_camera);
    projected.map_or(f64::INFINITY, |p| (p - observation.pixel).norm_squared() / observation.sigma_px.powi(2))
}

fn robust_cost(point: &Vector3<f64>, observations: &[RayObservation<'_>]) -> f64 {
    let cost = |o: &RayObservation<'_>| {
        let squared = squared_error(point, o);
        if squared.is_finite() { geman_mcclure(squared, SCALE2) } else { SCALE2 }
    };
    observations.iter().filter(|o| is_usable(o)).map(cost).sum()
}

fn refine(start: Vector3<f64>, observations: &[RayObservation<'_>]) -> Vector3<f64> {
    descend(start, ITERATIONS, |point| Some(linearize(point, observations)), |point, step| point + step)
}

fn linearize(point: &Vector3<f64>, observations: &[RayObservation<'_>]) -> QuadraticModel<3> {
    let mut model = QuadraticModel::zeros();
    for observation in observations.iter().filter(|o| is_usable(o)) {
        let Some((residual, jacobian)) = whitened(point, observation) else {
            model.cost += SCALE2;
            continue;
        };
        let squared = residual.norm_squared();
        let weight = geman_mcclure_weight(squared, SCALE2);
        model.cost += geman_mcclure(squared, SCALE2);
        (0..2).for_each(|axis| model.add(residual[axis], &jacobian.row(axis).transpose(), weight, 0.0));
    }
    model
}

/// Reprojection error in sigmas and its derivative to the point (1 / m); `None` behind the camera.
fn whitened(point: &Vector3<f64>, observation: &RayObservation<'_>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
    let camera = observation.camera_from_world;
    let (projected, by_point) = observation.intrinsics.project_with_jacobian(&camera.transform(point))?;
    let scale = 1.0 / observation.sigma_px;
    Some(((projected - observation.pixel) * scale, by_point * camera.rotation * scale))
}

/// Inliers and covariance of a point; `None` with fewer than two inliers or where they leave the point open.
fn judge(point: &Vector3<f64>, observations: &[RayObservation<'_>]) -> Option<TriangulatedPoint> {
    let inliers: Vec<bool> = observations.iter().map(|o| is_usable(o) && squared_error(point, o) < SCALE2).collect();
    let agreeing = observations.iter().zip(&inliers).filter(|(_, inlier)| **inlier).map(|(o, _)| o);
    let covariance = covariance(point, agreeing)?;
    Some(TriangulatedPoint { point: *point, inliers, cost: robust_cost(point, observations), covariance })
}

/// Covariance of a point (m^2) that two observations or more agree on: `(sum J^T J / sigma^2)^-1`.
///
/// Backward transport of covariance, Hartley and Zisserman 2003, section 5.2. `None` with fewer than two observations in
/// front of their cameras, or where they leave the point open. Exact cameras and independent errors are assumed.
pub fn covariance<'a>(
    point: &Vector3<f64>,
    observations: impl Iterator<Item = &'a RayObservation<'a>>,
) -> Option<Matrix3<f64>> {
    let (mut information, mut n) = (Matrix3::zeros(), 0);
    for (_, jacobian) in observations.filter_map(|observation| whitened(point, observation)) {
        information += jacobian.tr_mul(&jacobian);
        n += 1;
    }
    if n < 2 { None } else { Some(information.cholesky()?.inverse()) }
}

#[cfg(test)]
mod tests;
