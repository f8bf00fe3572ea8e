//! SO(3): exponential, logarithm, their Jacobians, the 6D form.

use nalgebra::{Matrix3, Vector3};

/// `[a]x`, so that `[a]x b = a x b`.
pub fn skew(a: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -a.z, a.y, a.z, 0.0, -a.x, -a.y, a.x, 0.0)
}

/// Below this angle (rad) the closed forms lose digits and their Taylor series is exact to rounding.
const SMALL_ANGLE: f64 = 1e-4;

/// Rotation by `|w|` radians about `w` (Rodrigues).
pub fn exp(w: &Vector3<f64>) -> Matrix3<f64> {
    let t2 = w.norm_squared();
    let t = t2.sqrt();
    let (a, b) = if t < SMALL_ANGLE { (1.0 - t2 / 6.0, 0.5 - t2 / 24.0) } else { (t.sin() / t, (1.0 - t.cos()) / t2) };
    let k = skew(w);
    Matrix3::identity() + k * a + k * k * b
}

/// The axis-angle vector of a rotation, of norm at most pi; inverse of [`exp`].
pub fn log(r: &Matrix3<f64>) -> Vector3<f64> {
    let q = nalgebra::UnitQuaternion::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(*r));
    // The quaternion's half angle is well conditioned both near 0 and near pi, where the trace is not.
    let (w, v) = if q.w < 0.0 { (-q.w, -q.imag()) } else { (q.w, q.imag()) };
    let s = v.norm();
    if s < 1e-12 { v * 2.0 } else { v * (2.0 * s.atan2(w) / s) }
}

/// Some unit vector perpendicular to `a`: against the axis along which `a` is shortest.
pub fn any_perpendicular(a: &Vector3<f64>) -> Vector3<f64> {
    let mut axis = Vector3::zeros();
    axis[a.iamin()] = 1.0;
    a.cross(&axis).normalize()
}
