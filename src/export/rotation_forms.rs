//! Rotations as Euler angles and quaternions that are continuous over time.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use std::f64::consts::{PI, TAU};

/// Angles about three different axes, rad: `R = R_outer R_middle R_inner`, where the inner rotation is applied first.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct EulerAngles {
    pub(super) outer: f64,
    pub(super) middle: f64,
    pub(super) inner: f64,
}

/// Below this cosine of the middle angle the outer and the inner rotation have the same axis: the inner is set to 0.
const GIMBAL_LOCK: f64 = 1e-9;

/// Angles of `R = R_z R_x R_y`, with x between -90 and 90 degrees.
pub(super) fn zxy_angles(r: &Matrix3<f64>) -> EulerAngles {
    let cos_x = r.m31.hypot(r.m33);
    let middle = r.m32.atan2(cos_x);
    if cos_x < GIMBAL_LOCK {
        return EulerAngles { outer: r.m21.atan2(r.m11), middle, inner: 0.0 };
    }
    EulerAngles { outer: (-r.m12).atan2(r.m22), middle, inner: (-r.m31).atan2(r.m33) }
}

/// Angles of `R = R_y R_x R_z`: those of the transpose with opposite signs.
pub(super) fn yxz_angles(r: &Matrix3<f64>) -> EulerAngles {
    let EulerAngles { outer, middle, inner } = zxy_angles(&r.transpose());
    EulerAngles { outer: -inner, middle: -middle, inner: -outer }
}

/// Angles of `R = R_z R_y R_x`, with y between -90 and 90 degrees.
pub(super) fn zyx_angles(r: &Matrix3<f64>) -> EulerAngles {
    let cos_y = r.m32.hypot(r.m33);
    let middle = (-r.m31).atan2(cos_y);
    if cos_y < GIMBAL_LOCK {
        return EulerAngles { outer: (-r.m12).atan2(r.m22), middle, inner: 0.0 };
    }
    EulerAngles { outer: r.m21.atan2(r.m11), middle, inner: r.m32.atan2(r.m33) }
}

/// The angles of the same rotation that are nearest to those of the previous frame, for curves without jumps.
pub(super) fn nearest_angles(angles: EulerAngles, before: EulerAngles) -> EulerAngles {
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

/// The quaternion `x y z w` with w >= 0.
pub(super) fn quaternion_xyzw(r: &Matrix3<f64>) -> [f64; 4] {
    let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*r));
    let [x, y, z, w] = [q.i, q.j, q.k, q.w];
    if w < 0.0 { [-x, -y, -z, -w] } else { [x, y, z, w] }
}

/// Quaternions of one joint over time; of `q` and `-q` the one nearer to the previous frame, since readers interpolate them.
pub(super) fn quaternions_xyzw(rotations: impl Iterator<Item = Matrix3<f64>>) -> Vec<[f64; 4]> {
    let mut quaternions: Vec<[f64; 4]> = rotations.map(|r| quaternion_xyzw(&r)).collect();
    for t in 1..quaternions.len() {
        let (before, q) = (quaternions[t - 1], quaternions[t]);
        if before.iter().zip(q).map(|(a, b)| a * b).sum::<f64>() < 0.0 {
            quaternions[t] = q.map(|c| -c);
        }
    }
    quaternions
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
            let forms = [([2, 0, 1], zxy_angles(&r)), ([1, 0, 2], yxz_angles(&r)), ([2, 1, 0], zyx_angles(&r))];
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
            let [a, b] = [angles, before].map(|a| nalgebra::Vector3::new(a.outer, a.middle, a.inner));
            assert!((a - b).abs().sum() < 0.5);
            before = angles;
        }
        let quaternions = quaternions_xyzw(turns.iter().copied());
        let dot = |pair: &[[f64; 4]]| pair[0].iter().zip(pair[1]).map(|(a, b)| a * b).sum::<f64>();
        assert!(quaternions.windows(2).all(|pair| dot(pair) > 0.99));
    }
}
