//! Occlusion: people as capsules between the camera and a point.

use super::skeleton::joint;
use crate::body::skeleton::N_JOINTS;
use nalgebra::Vector3;

/// Capsules of a body: two joints and a radius, m.
const CAPSULES: [(usize, usize, f64); 11] = [
    (joint("pelvis"), joint("neck"), 0.14),
    (joint("left_shoulder"), joint("left_elbow"), 0.05),
    (joint("right_shoulder"), joint("right_elbow"), 0.05),
    (joint("left_elbow"), joint("left_wrist"), 0.04),
    (joint("right_elbow"), joint("right_wrist"), 0.04),
    (joint("left_hip"), joint("left_knee"), 0.08),
    (joint("right_hip"), joint("right_knee"), 0.08),
    (joint("left_knee"), joint("left_ankle"), 0.055),
    (joint("right_knee"), joint("right_ankle"), 0.055),
    (joint("neck"), joint("head"), 0.10),
    (joint("head"), joint("head"), 0.12),
];

/// A body hides points of other people that are farther behind it than this, m.
const GAP_OTHER: f64 = 0.10;
/// A body hides its own points only if they are farther behind than this, since they lie on its surface, m.
const GAP_OWN: f64 = 0.25;
/// Relative thickness of the capsules that hide a person's own points.
const OWN_THICKNESS: f64 = 0.6;

/// Whether a capsule of any of `people` blocks the line of sight from `center` to a point of person `owner`.
pub fn is_hidden(
    center: &Vector3<f64>,
    point: &Vector3<f64>,
    owner: usize,
    people: &[&[Vector3<f64>; N_JOINTS]],
) -> bool {
    let distance = (point - center).norm();
    people.iter().enumerate().any(|(person, joints)| {
        let (thickness, gap) = if person == owner { (OWN_THICKNESS, GAP_OWN) } else { (1.0, GAP_OTHER) };
        CAPSULES.iter().any(|&(a, b, radius)| {
            let nearest = nearest_on_segments(center, point, &joints[a], &joints[b]);
            nearest.distance < radius * thickness && (1.0 - nearest.along_first) * distance > gap
        })
    })
}

/// The nearest points of two segments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nearest {
    /// Distance, m.
    pub distance: f64,
    /// Position on the first segment, 0 to 1.
    pub along_first: f64,
}

/// Nearest points of the segments `p0 p1` and `q0 q1`; either may be a point.
///
/// With `s`, `t` along them: minimise `|p(s) - q(t)|^2` freely, clamp `s`, solve for `t`, clamp, solve for `s` again
/// (Ericson, Real-Time Collision Detection, 5.1.9).
pub fn nearest_on_segments(p0: &Vector3<f64>, p1: &Vector3<f64>, q0: &Vector3<f64>, q1: &Vector3<f64>) -> Nearest {
    const TINY: f64 = 1e-12;
    let (d1, d2, r) = (p1 - p0, q1 - q0, p0 - q0);
    let (a, e) = (d1.norm_squared().max(TINY), d2.norm_squared().max(TINY));
    let (b, c, f) = (d1.dot(&d2), d1.dot(&r), d2.dot(&r));
    let free = ((b * f - c * e) / (a * e - b * b).max(TINY)).clamp(0.0, 1.0);
    let t = ((b * free + f) / e).clamp(0.0, 1.0);
    let s = ((b * t - c) / a).clamp(0.0, 1.0);
    Nearest { distance: (p0 + d1 * s - (q0 + d2 * t)).norm(), along_first: s }
}
