//! Rotations as quaternions that are continuous over time.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion};

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

    #[test]
    fn quaternions_of_full_turns_have_no_jumps() {
        let turns =
            (0..200).map(|i| exp(&Vector3::new(0.0, 0.1 * f64::from(i), 0.0)) * exp(&Vector3::new(0.3, 0.0, 0.0)));
        let quaternions = quaternions_xyzw(turns);
        let dot = |pair: &[[f64; 4]]| pair[0].iter().zip(pair[1]).map(|(a, b)| a * b).sum::<f64>();
        assert!(quaternions.windows(2).all(|pair| dot(pair) > 0.99));
    }
}
