//! SO(3): exponential, logarithm, their Jacobians, rotations between directions.

use nalgebra::{Matrix3, Matrix3x2, Vector3};

/// `[a]x`, so that `[a]x b = a x b`.
pub fn skew(a: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -a.z, a.y, a.z, 0.0, -a.x, -a.y, a.x, 0.0)
}

/// The vector a of `A - A^T = [a]x`, twice the antisymmetric part of a matrix: an increment `A exp(e)` changes the trace
/// by `-e . a`.
pub fn axial(m: &Matrix3<f64>) -> Vector3<f64> {
    Vector3::new(m.m32 - m.m23, m.m13 - m.m31, m.m21 - m.m12)
}

/// Below this angle (rad) the closed forms lose digits and their Taylor series are exact to rounding.
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
    let (w, v) = half_turn(r);
    let s2 = v.norm_squared();
    if s2 < MAX_SQUARED_SINE {
        return v * (2.0 * series(&ARC_SINE, s2));
    }
    let s = s2.sqrt();
    v * (2.0 * s.atan2(w) / s)
}

/// `log(A^T B)`: the rotation vector of the step between two rotations, in the frame of `from`, rad.
///
/// Known limit: steps of more than half a circle are taken the short way round.
pub fn step(from: &Matrix3<f64>, to: &Matrix3<f64>) -> Vector3<f64> {
    log(&(from.transpose() * to))
}

/// The rotation a share of the way from one to another, about a fixed axis.
pub fn towards(from: &Matrix3<f64>, to: &Matrix3<f64>, share: f64) -> Matrix3<f64> {
    from * exp(&(step(from, to) * share))
}

/// Cosine of half the angle, not negative, and the axis times the sine of half the angle: a unit quaternion. Half angles are well
/// conditioned both near 0 and near pi, where the trace is not.
fn half_turn(r: &Matrix3<f64>) -> (f64, Vector3<f64>) {
    let trace = r.trace();
    // Below 120 degrees, as most rotations are.
    if trace > 0.0 {
        let w = 0.5 * (1.0 + trace).sqrt();
        return (w, axial(r) * (0.25 / w));
    }
    let q = nalgebra::UnitQuaternion::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(*r));
    if q.w < 0.0 { (-q.w, -q.imag()) } else { (q.w, q.imag()) }
}

/// Power series of `asin(s) / s` in `s^2`, exact to rounding below this `s^2`: most rotations from frame to frame are below the 16
/// degrees that it stands for.
const MAX_SQUARED_SINE: f64 = 0.02;
const ARC_SINE: [f64; 9] = [
    1.0,
    1.0 / 6.0,
    3.0 / 40.0,
    5.0 / 112.0,
    35.0 / 1152.0,
    63.0 / 2816.0,
    231.0 / 13312.0,
    143.0 / 10240.0,
    6435.0 / 557056.0,
];

/// Power series of `(1 - (t / 2) cot(t / 2)) / t^2` in `t^2`, `|B_2k| t^(2k-2) / (2k)!`, exact to rounding below this `t^2`.
const MAX_SQUARED_ANGLE: f64 = 0.5;
const HALF_COTANGENT: [f64; 8] = [
    1.0 / 12.0,
    1.0 / 720.0,
    1.0 / 30_240.0,
    1.0 / 1_209_600.0,
    1.0 / 47_900_160.0,
    691.0 / 1_307_674_368_000.0,
    1.0 / 74_724_249_600.0,
    3617.0 / 10_670_622_842_880_000.0,
];

fn series<const N: usize>(coefficients: &[f64; N], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, coefficient| sum * x + coefficient)
}

/// `J_l(w) = I + (1 - cos t) / t^2 [w]x + (t - sin t) / t^3 [w]x^2`, `t = |w|`: `exp(w + d) = exp(J_l d) exp(w)` to
/// first order in d.
pub fn left_jacobian(w: &Vector3<f64>) -> Matrix3<f64> {
    let t2 = w.norm_squared();
    let t = t2.sqrt();
    let (a, b) = if t < SMALL_ANGLE {
        (0.5 - t2 / 24.0, 1.0 / 6.0 - t2 / 120.0)
    } else {
        let half_chord = (0.5 * t).sin() / t; // 1 - cos t = 2 sin^2(t / 2), without its cancellation
        (2.0 * half_chord * half_chord, (t - t.sin()) / (t2 * t))
    };
    let k = skew(w);
    Matrix3::identity() + k * a + k * k * b
}

/// `J_r(w) = J_l(-w)`: `exp(w + d) = exp(w) exp(J_r d)` to first order in d.
pub fn right_jacobian(w: &Vector3<f64>) -> Matrix3<f64> {
    left_jacobian(&-w)
}

/// `J_l(w)^-1 = I - [w]x / 2 + (1 - (t / 2) cot(t / 2)) / t^2 [w]x^2`: `log(exp(d) exp(w)) = w + J_l^-1 d` to first
/// order in d. It does not exist at `t = 2 pi`; regular at pi.
pub fn left_jacobian_inverse(w: &Vector3<f64>) -> Matrix3<f64> {
    let t2 = w.norm_squared();
    let b = if t2 < MAX_SQUARED_ANGLE {
        series(&HALF_COTANGENT, t2)
    } else {
        let half = 0.5 * t2.sqrt();
        (1.0 - half / half.tan()) / t2
    };
    let k = skew(w);
    Matrix3::identity() - k * 0.5 + k * k * b
}

/// `J_r(w)^-1 = J_l(-w)^-1`: `log(exp(w) exp(d)) = w + J_r^-1 d` to first order in d.
pub fn right_jacobian_inverse(w: &Vector3<f64>) -> Matrix3<f64> {
    left_jacobian_inverse(&-w)
}

/// Angle between two rotations, rad, 0 to pi.
pub fn angle_between(a: &Matrix3<f64>, b: &Matrix3<f64>) -> f64 {
    step(a, b).norm()
}

/// The smallest rotation from the direction of `a` to that of `b`; for opposite directions about an arbitrary axis
/// perpendicular to `a`. The identity where one of them is zero.
pub fn rotation_between(a: &Vector3<f64>, b: &Vector3<f64>) -> Matrix3<f64> {
    let (Some(a), Some(b)) = (a.try_normalize(0.0), b.try_normalize(0.0)) else {
        return Matrix3::identity();
    };
    let cross = a.cross(&b);
    let angle = cross.norm().atan2(a.dot(&b));
    // The axis of nearly opposite directions is mostly rounding error: its component along a is removed.
    let across = cross.try_normalize(1e-300).and_then(|axis| (axis - a * a.dot(&axis)).try_normalize(0.5));
    exp(&(across.unwrap_or_else(|| any_perpendicular(&a)) * angle))
}

/// A unit vector perpendicular to `a` and to the axis of the smallest component of `a`.
pub fn any_perpendicular(a: &Vector3<f64>) -> Vector3<f64> {
    let mut axis = Vector3::zeros();
    axis[a.iamin()] = 1.0;
    a.cross(&axis).normalize()
}

/// Two unit vectors perpendicular to a unit vector and to each other: tangents of the sphere at `direction`.
pub fn tangents(direction: &Vector3<f64>) -> Matrix3x2<f64> {
    let first = any_perpendicular(direction);
    Matrix3x2::from_columns(&[first, direction.cross(&first)])
}

#[cfg(test)]
mod tests;
