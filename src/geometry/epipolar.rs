//! Geometry of two views: essential matrix, Sampson distance, depths, Plücker rays.
//!
//! Points are ideal normalised coordinates, `a` in the first view, `b` in the second; `E = [t]x R` of
//! `second_from_first`, so that `(b, 1)^T E (a, 1) = 0`.

use super::rigid::Rigid;
use super::{rotation, svd};
use nalgebra::{Matrix3, Vector2, Vector3};

/// A pair of corresponding points: ideal normalised coordinates in the first and in the second view.
pub type PointPair = (Vector2<f64>, Vector2<f64>);

/// `E = [t]x R`; Frobenius norm sqrt 2 for a baseline of length 1.
pub fn essential_from_pose(second_from_first: &Rigid) -> Matrix3<f64> {
    rotation::skew(&second_from_first.translation) * second_from_first.rotation
}

/// Squared Sampson distance (normalised units; times the focal length squared: px^2).
///
/// `(b^T E a)^2 / ((E a)_1^2 + (E a)_2^2 + (E^T b)_1^2 + (E^T b)_2^2)`: Hartley and Zisserman, Eq. (11.9). Independent
/// of the scale of E. Where both points are epipoles it is 0 / 0, reported as 0.
pub fn sampson_squared(essential: &Matrix3<f64>, a: &Vector2<f64>, b: &Vector2<f64>) -> f64 {
    let e = essential;
    let (lx, ly) = (e.m11 * a.x + e.m12 * a.y + e.m13, e.m21 * a.x + e.m22 * a.y + e.m23);
    let (mx, my) = (e.m11 * b.x + e.m21 * b.y + e.m31, e.m12 * b.x + e.m22 * b.y + e.m32);
    let algebraic = b.x * lx + b.y * ly + e.m31 * a.x + e.m32 * a.y + e.m33;
    let slope2 = lx * lx + ly * ly + mx * mx + my * my;
    if slope2 > 0.0 { algebraic * algebraic / slope2 } else { 0.0 }
}

/// The four relative poses (`second_from_first`, baseline 1) of an essential matrix; its sign does not matter.
///
/// `R = U W V^T` or `U W^T V^T`, `t = +-u_3`: Hartley and Zisserman, result 9.19. A matrix with unequal singular values
/// gives the poses of the nearest essential matrix.
pub fn poses_from_essential(essential: &Matrix3<f64>) -> [Rigid; 4] {
    let svd = svd::decompose(essential);
    // The third singular value is zero: flipping its vectors makes both factors rotations.
    let proper = |mut m: Matrix3<f64>| {
        let sign = m.determinant().signum();
        m.column_mut(2).scale_mut(sign);
        m
    };
    let (u, v) = (proper(svd.u), proper(svd.v));
    let quarter = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    let (one, other) = (u * quarter * v.transpose(), u * quarter.transpose() * v.transpose());
    let translation: Vector3<f64> = u.column(2).into_owned();
    [(one, translation), (one, -translation), (other, translation), (other, -translation)]
        .map(|(rotation, translation)| Rigid { rotation, translation })
}

/// Depths (z, in units of the baseline's length) of one point in two views.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PairDepths {
    /// In the first view.
    pub first: f64,
    /// In the second view.
    pub second: f64,
}

/// Depths of a point pair by linear triangulation, from `z_b b = z_a R a + t`: least-squares solutions of
/// `z_a (b x R a) = t x b` and `z_b (b x R a) = t x R a`. `None` for parallel rays.
pub fn pair_depths(second_from_first: &Rigid, a: &Vector2<f64>, b: &Vector2<f64>) -> Option<PairDepths> {
    let t = &second_from_first.translation;
    let (q, b) = (second_from_first.rotation * a.push(1.0), b.push(1.0));
    let normal = b.cross(&q);
    let squared = normal.norm_squared();
    if squared <= 1e-24 * q.norm_squared() * b.norm_squared() {
        return None;
    }
    Some(PairDepths { first: t.cross(&b).dot(&normal) / squared, second: t.cross(&q).dot(&normal) / squared })
}

/// Whether the point of a pair lies in front of both views.
pub fn in_front(second_from_first: &Rigid, a: &Vector2<f64>, b: &Vector2<f64>) -> bool {
    pair_depths(second_from_first, a, b).is_some_and(|z| z.first > 0.0 && z.second > 0.0)
}

/// A line of sight in the world in Plücker coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PluckerRay {
    /// Unit direction, away from the camera.
    pub direction: Vector3<f64>,
    /// `point x direction` of any point on the line, m.
    pub moment: Vector3<f64>,
}

/// Below this sine of their angle two rays count as parallel: the gap's numerator would be rounding error.
const PARALLEL_SINE: f64 = 1e-9;

impl PluckerRay {
    /// The ray through ideal normalised coordinates of a camera.
    pub fn through(camera_from_world: &Rigid, normalized: &Vector2<f64>) -> Self {
        let direction = camera_from_world.rotation.tr_mul(&normalized.push(1.0)).normalize();
        Self { direction, moment: camera_from_world.center().cross(&direction) }
    }

    /// The line's nearest point to the world's origin.
    pub fn foot(&self) -> Vector3<f64> {
        self.direction.cross(&self.moment)
    }
}

/// Distance of a point from a ray's line, m: `|x x n - l|`.
pub fn ray_point_distance(ray: &PluckerRay, point: &Vector3<f64>) -> f64 {
    (point.cross(&ray.direction) - ray.moment).norm()
}

/// The gap between two rays' lines, m: `|n_i . l_j + n_j . l_i| / |n_i x n_j|`; for parallel lines their distance.
///
/// The numerator alone is the gap times the sine of the angle, too small for nearly parallel rays. Depths are not
/// checked: the lines may be nearest behind the cameras.
pub fn ray_ray_distance(one: &PluckerRay, other: &PluckerRay) -> f64 {
    let sine = one.direction.cross(&other.direction).norm();
    if sine < PARALLEL_SINE {
        return ray_point_distance(one, &other.foot());
    }
    (one.direction.dot(&other.moment) + other.direction.dot(&one.moment)).abs() / sine
}

#[cfg(test)]
mod tests;
