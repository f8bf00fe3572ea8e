//! Rotations as angles about three axes.

use nalgebra::Matrix3;
use std::f64::consts::{PI, TAU};

/// Angles about three different axes, rad: `R = R_outer R_middle R_inner`, where the inner rotation is applied first.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct EulerAngles {
    /// Applied last, rad.
    pub outer: f64,
    /// Applied second, rad.
    pub middle: f64,
    /// Applied first, rad.
    pub inner: f64,
}

/// Below this cosine (or sine, where the first and the last axis agree) of the middle angle the outer and the inner rotation have
/// the same axis: the inner one is set to 0.
const GIMBAL_LOCK: f64 = 1e-9;

/// Angles of `R = R_z R_x R_y`, with x between -90 and 90 degrees.
pub fn zxy_angles(r: &Matrix3<f64>) -> EulerAngles {
    let cos_x = r.m31.hypot(r.m33);
    let middle = r.m32.atan2(cos_x);
    if cos_x < GIMBAL_LOCK {
        return EulerAngles { outer: r.m21.atan2(r.m11), middle, inner: 0.0 };
    }
    EulerAngles { outer: (-r.m12).atan2(r.m22), middle, inner: (-r.m31).atan2(r.m33) }
}

/// Angles of `R = R_y R_x R_z`: those of the transpose with opposite signs.
pub fn yxz_angles(r: &Matrix3<f64>) -> EulerAngles {
    let EulerAngles { outer, middle, inner } = zxy_angles(&r.transpose());
    EulerAngles { outer: -inner, middle: -middle, inner: -outer }
}

/// Angles of `R = R_z R_y R_x`, with y between -90 and 90 degrees.
pub fn zyx_angles(r: &Matrix3<f64>) -> EulerAngles {
    let cos_y = r.m32.hypot(r.m33);
    let middle = (-r.m31).atan2(cos_y);
    if cos_y < GIMBAL_LOCK {
        return EulerAngles { outer: (-r.m12).atan2(r.m22), middle, inner: 0.0 };
    }
    EulerAngles { outer: r.m21.atan2(r.m11), middle, inner: r.m32.atan2(r.m33) }
}

/// Angles of `R = R_y R_x R_y'`, with x between 0 and -180 degrees: the sequence of the shoulder (Wu et al. 2005).
pub fn yxy_angles(r: &Matrix3<f64>) -> EulerAngles {
    let sin_x = r.m12.hypot(r.m32);
    let middle = -sin_x.atan2(r.m22);
    if sin_x < GIMBAL_LOCK {
        return EulerAngles { outer: (-r.m31).atan2(r.m11), middle, inner: 0.0 };
    }
    EulerAngles { outer: (-r.m12).atan2(-r.m32), middle, inner: (-r.m21).atan2(r.m23) }
}

/// The angles of the same rotation that are nearest to those of the previous frame, for curves without jumps; of sequences with
/// three different axes.
pub fn nearest_angles(angles: EulerAngles, before: EulerAngles) -> EulerAngles {
    let other = EulerAngles { outer: angles.outer + PI, middle: PI - angles.middle, inner: angles.inner + PI };
    let nearest = |angle: f64, before: f64| angle - ((angle - before) / TAU).round() * TAU;
    let [a, b] = [angles, other].map(|c| EulerAngles {
        outer: nearest(c.outer, before.outer),
        middle: nearest(c.middle, before.middle),
        inner: nearest(c.inner, before.inner),
    });
    let distance = |c: &EulerAngles| {
        (c.outer - before.outer).abs() + (c.middle - before.middle).abs() + (c.inner - before.inner).abs()
    };
    if distance(&b) < distance(&a) { b } else { a }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rotation::exp;
    use nalgebra::Vector3;

    fn about(axis: usize, angle: f64) -> Matrix3<f64> {
        exp(&Vector3::ith(axis, angle))
    }

    fn some_rotations() -> Vec<Matrix3<f64>> {
        let turn = |i: usize| Vector3::new((i as f64).sin(), (1.7 * i as f64).cos(), (0.3 * i as f64).sin()) * 2.5;
        let locked = [
            about(0, PI / 2.0) * about(1, 0.4),
            about(2, 1.1) * about(0, -PI / 2.0),
            about(2, 0.7) * about(1, PI / 2.0),
            about(1, -PI / 2.0) * about(0, 0.3),
            about(1, 0.8),
            about(1, 0.8) * about(0, PI),
        ];
        (0..40).map(|i| exp(&turn(i))).chain(locked).collect()
    }

    #[test]
    fn angles_reproduce_the_rotation() {
        let product = |axes: [usize; 3], a: EulerAngles| {
            about(axes[0], a.outer) * about(axes[1], a.middle) * about(axes[2], a.inner)
        };
        let mut before = [EulerAngles::default(); 2];
        for r in some_rotations() {
            let forms = [
                ([2, 0, 1], zxy_angles(&r)),
                ([1, 0, 2], yxz_angles(&r)),
                ([2, 1, 0], zyx_angles(&r)),
                ([1, 0, 1], yxy_angles(&r)),
            ];
            for (axes, angles) in forms {
                assert!((product(axes, angles) - r).norm() < 1e-8, "{axes:?}");
            }
            before = [(0, forms[0]), (1, forms[2])].map(|(i, (axes, angles))| {
                let near = nearest_angles(angles, before[i]);
                assert!((product(axes, near) - r).norm() < 1e-8, "{axes:?}");
                near
            });
        }
    }

    #[test]
    fn full_turns_have_no_jumps() {
        let turns: Vec<_> = (0..200).map(|i| about(1, 0.1 * f64::from(i)) * about(0, 0.3)).collect();
        let mut before = zxy_angles(&turns[0]);
        for r in &turns {
            let angles = nearest_angles(zxy_angles(r), before);
            let [a, b] = [angles, before].map(|a| Vector3::new(a.outer, a.middle, a.inner));
            assert!((a - b).abs().sum() < 0.5);
            before = angles;
        }
    }
}
