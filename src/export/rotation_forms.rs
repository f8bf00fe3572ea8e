//! Rotations as Euler angles and quaternions that are continuous over time.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use std::f64::consts::{PI, TAU};

/// Angles about z, x and y, rad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ZxyAngles {
    pub(super) z: f64,
    pub(super) x: f64,
    pub(super) y: f64,
}

/// Below this cosine of x the rotations about z and y have the same axis: y is set to 0.
const GIMBAL_LOCK: f64 = 1e-9;

/// Angles of `R = R_z(z) R_x(x) R_y(y)`, with x between -90 and 90 degrees.
pub(super) fn zxy_angles(r: &Matrix3<f64>) -> ZxyAngles {
    let cos_x = r.m31.hypot(r.m33);
    let x = r.m32.atan2(cos_x);
    if cos_x < GIMBAL_LOCK {
        return ZxyAngles { z: r.m21.atan2(r.m11), x, y: 0.0 };
    }
    ZxyAngles { z: (-r.m12).atan2(r.m22), x, y: (-r.m31).atan2(r.m33) }
}

/// Angles of `R = R_y(y) R_x(x) R_z(z)`: those of the transpose with opposite signs.
pub(super) fn yxz_angles(r: &Matrix3<f64>) -> ZxyAngles {
    let ZxyAngles { z, x, y } = zxy_angles(&r.transpose());
    ZxyAngles { z: -z, x: -x, y: -y }
}

/// The angles of the same rotation that are nearest to those of the previous frame, for curves without jumps.
pub(super) fn nearest_angles(angles: ZxyAngles, before: ZxyAngles) -> ZxyAngles {
    let other = ZxyAngles { z: angles.z + PI, x: PI - angles.x, y: angles.y + PI };
    let [a, b] = [angles, other].map(|c| ZxyAngles {
        z: c.z - ((c.z - before.z) / TAU).round() * TAU,
        x: c.x - ((c.x - before.x) / TAU).round() * TAU,
        y: c.y - ((c.y - before.y) / TAU).round() * TAU,
    });
    let distance = |c: &ZxyAngles| (c.z - before.z).abs() + (c.x - before.x).abs() + (c.y - before.y).abs();
    if distance(&b) < distance(&a) { b } else { a }
}

/// The quaternion `x y z w` with w >= 0.
pub(super) fn quaternion_xyzw(r: &Matrix3<f64>) -> [f64; 4] {
    let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*r));
    let [x, y, z, w] = [q.i, q.j, q.k, q.w];
    if w < 0.0 { [-x, -y, -z, -w] } else { [x, y, z, w] }
}

/// Quaternions of one joint over time; of `q` and `-q` the one nearer to the previous frame, since readers interpolate them.
pub(super) fn quaternions_xyzw<'a>(rotations: impl Iterator<Item = &'a Matrix3<f64>>) -> Vec<[f64; 4]> {
    let mut quaternions: Vec<[f64; 4]> = rotations.map(quaternion_xyzw).collect();
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
        let locked = [about(0, PI / 2.0) * about(1, 0.4), about(2, 1.1) * about(0, -PI / 2.0)];
        (0..40).map(|i| exp(&turn(i))).chain(locked).collect()
    }

    #[test]
    fn angles_reproduce_the_rotation() {
        let mut before = ZxyAngles { z: 0.0, x: 0.0, y: 0.0 };
        for r in some_rotations() {
            let a = zxy_angles(&r);
            assert!((about(2, a.z) * about(0, a.x) * about(1, a.y) - r).norm() < 1e-8);
            let b = yxz_angles(&r);
            assert!((about(1, b.y) * about(0, b.x) * about(2, b.z) - r).norm() < 1e-8);
            let c = nearest_angles(a, before);
            assert!((about(2, c.z) * about(0, c.x) * about(1, c.y) - r).norm() < 1e-8);
            before = c;
        }
    }

    #[test]
    fn full_turns_have_no_jumps() {
        let turns: Vec<_> = (0..200).map(|i| about(1, 0.1 * f64::from(i)) * about(0, 0.3)).collect();
        let mut before = zxy_angles(&turns[0]);
        for r in &turns {
            let angles = nearest_angles(zxy_angles(r), before);
            assert!((angles.z - before.z).abs() + (angles.x - before.x).abs() + (angles.y - before.y).abs() < 0.5);
            before = angles;
        }
        let quaternions = quaternions_xyzw(turns.iter());
        let dot = |pair: &[[f64; 4]]| pair[0].iter().zip(pair[1]).map(|(a, b)| a * b).sum::<f64>();
        assert!(quaternions.windows(2).all(|pair| dot(pair) > 0.99));
    }
}
