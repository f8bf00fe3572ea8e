//! Normalised projection of world points into posed cameras.

use super::rigid::Rigid;
use nalgebra::{Vector2, Vector3};

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
