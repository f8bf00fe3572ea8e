//! Normalised projection of world points into posed cameras.

use super::rigid::Rigid;
use nalgebra::{Matrix2x3, Matrix2x6, Vector2, Vector3};

/// Points nearer to the camera plane than this are not projected, m: no person stands closer to a lens. Far above
/// [`super::camera::MIN_DEPTH`], which only keeps the division finite.
pub const NEAR_PLANE: f64 = 0.1;

/// The image of a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalizedProjection {
    /// Ideal normalised image coordinates.
    pub normalized: Vector2<f64>,
    /// Distance along the optical axis, in the world's unit of length.
    pub depth: f64,
}

/// Projects a point: `(x / z, y / z)` in the camera frame. `None` behind the near plane.
pub fn project_normalized(camera_from_world: &Rigid, point_in_world: &Vector3<f64>) -> Option<NormalizedProjection> {
    let x = camera_from_world.transform(point_in_world);
    (x.z > NEAR_PLANE).then(|| NormalizedProjection { normalized: x.xy() / x.z, depth: x.z })
}

/// Derivative of a projection by the camera's left increment (rho, phi) of [`Rigid::perturbed_left`], from that by the point in the
/// camera frame: `J [ I | -[x]x ]`.
#[inline(always)]
pub fn by_left_increment(by_point_in_camera: &Matrix2x3<f64>, point_in_camera: &Vector3<f64>) -> Matrix2x6<f64> {
    let (u, v, p) = (by_point_in_camera.row(0), by_point_in_camera.row(1), point_in_camera);
    #[rustfmt::skip]
    let by_increment = Matrix2x6::new(
        u[0], u[1], u[2], u[2] * p.y - u[1] * p.z, u[0] * p.z - u[2] * p.x, u[1] * p.x - u[0] * p.y,
        v[0], v[1], v[2], v[2] * p.y - v[1] * p.z, v[0] * p.z - v[2] * p.x, v[1] * p.x - v[0] * p.y,
    );
    by_increment
}

/// `(depth |projection - normalized|)^2`: how far a point lies beside a ray at its own depth, squared, without a division by the
/// depth. `None` behind the near plane.
pub fn squared_offset(
    camera_from_world: &Rigid,
    point_in_world: &Vector3<f64>,
    normalized: &Vector2<f64>,
) -> Option<f64> {
    let x = camera_from_world.transform(point_in_world);
    (x.z > NEAR_PLANE).then(|| (x.xy() - normalized * x.z).norm_squared())
}
