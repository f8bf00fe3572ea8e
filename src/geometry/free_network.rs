//! The free network: cameras are determined up to a similarity of the world, whose seven directions no detection shows.
//!
//! Increments are left increments `(rho, phi)` of `camera_from_world`, six per camera.

use super::Rigid;
use super::rotation::skew;
use nalgebra::{DMatrix, Matrix3, Vector3};

/// Weight of orientations in the alignment, in units of the rig's radius: small, so that centres decide as in evaluation,
/// and orientations matter only for a rig whose centres lie on a line.
const ORIENTATION_WEIGHT: f64 = 1e-2;

/// Increments of all cameras under shifts, rotations and scaling of the world about their centroid. [6 cameras, 7]
///
/// The centre moves by `t + omega x arm + s arm`, and `rho = -R dC`, `phi = -R omega`.
pub fn similarity_directions(poses: &[Rigid]) -> DMatrix<f64> {
    let centroid = centroid(poses);
    let mut directions = DMatrix::zeros(6 * poses.len(), 7);
    for (k, pose) in poses.iter().enumerate() {
        let (arm, rotation) = (pose.center() - centroid, pose.rotation);
        directions.fixed_view_mut::<3, 3>(6 * k, 0).copy_from(&-rotation);
        directions.fixed_view_mut::<3, 3>(6 * k, 3).copy_from(&(rotation * skew(&arm)));
        directions.fixed_view_mut::<3, 1>(6 * k, 6).copy_from(&(-(rotation * arm)));
        directions.fixed_view_mut::<3, 3>(6 * k + 3, 3).copy_from(&Matrix3::from(-rotation));
    }
    directions
}

/// Orthonormal increments of all cameras across those of a similarity. [6 cameras, 6 cameras - 7]
pub fn basis(poses: &[Rigid]) -> DMatrix<f64> {
    let directions = similarity_directions(poses);
    let eigen = (&directions * directions.transpose()).symmetric_eigen();
    let mut order: Vec<usize> = (0..directions.nrows()).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    order.truncate(directions.nrows().saturating_sub(7));
    DMatrix::from_columns(&order.iter().map(|&k| eigen.eigenvectors.column(k)).collect::<Vec<_>>())
}

/// Projection that removes the best similarity from a joint increment of all cameras: `I - N (N^T D N)^-1 N^T D`. [6 cameras, 6 cameras]
///
/// `N`: the seven directions of a similarity, `D`: the weights of centres (1) and orientations in the alignment.
/// `None` for fewer than two cameras or coinciding centres.
pub fn projection(poses: &[Rigid]) -> Option<DMatrix<f64>> {
    let centroid = centroid(poses);
    let squared_radius =
        poses.iter().map(|p| (p.center() - centroid).norm_squared()).sum::<f64>() / poses.len().max(1) as f64;
    let directions = similarity_directions(poses);
    let orientation = ORIENTATION_WEIGHT * ORIENTATION_WEIGHT * squared_radius;
    let mut weighted = directions.clone();
    for k in 0..poses.len() {
        weighted.rows_mut(6 * k + 3, 3).scale_mut(orientation);
    }
    let normal = weighted.tr_mul(&directions).cholesky()?;
    let n = directions.nrows();
    Some(DMatrix::identity(n, n) - &directions * normal.solve(&weighted.transpose()))
}

fn centroid(poses: &[Rigid]) -> Vector3<f64> {
    poses.iter().map(Rigid::center).sum::<Vector3<f64>>() / poses.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rotation;

    fn rig() -> Vec<Rigid> {
        let pose = |k: usize| {
            let angle = k as f64;
            Rigid {
                rotation: rotation::exp(&Vector3::new(0.1, angle, 0.05 * angle)),
                translation: Vector3::new(0.2 * angle, -0.1, 4.0),
            }
        };
        (0..4).map(pose).collect()
    }

    /// A small similarity moves the cameras along the directions, to second order.
    #[test]
    fn directions_are_those_of_a_similarity() {
        let (poses, small) = (rig(), 1e-5);
        let (turn, shift, scale) = (Vector3::new(0.3, -0.5, 0.8) * small, Vector3::new(1.0, 2.0, -1.0) * small, small);
        let by = nalgebra::DVector::from_iterator(7, shift.iter().chain(turn.iter()).copied().chain([scale]));
        let increments = similarity_directions(&poses) * by;
        let centroid = centroid(&poses);
        for (k, pose) in poses.iter().enumerate() {
            let arm = pose.center() - centroid;
            let center = centroid + shift + rotation::exp(&turn) * arm * (1.0 + scale);
            let turned = pose.rotation * rotation::exp(&-turn);
            let rho = increments.fixed_rows::<3>(6 * k).into_owned();
            let phi = increments.fixed_rows::<3>(6 * k + 3).into_owned();
            let moved = pose.perturbed_left(&rho, &phi);
            assert!((moved.center() - center).norm() < 1e-8, "{k}");
            assert!((moved.rotation - turned).norm() < 1e-8, "{k}");
        }
    }

    #[test]
    fn basis_and_projection_leave_out_similarities() {
        let poses = rig();
        let directions = similarity_directions(&poses);
        let basis = basis(&poses);
        assert_eq!(basis.shape(), (24, 17));
        assert!(basis.tr_mul(&directions).amax() < 1e-9);
        assert!((projection(&poses).unwrap() * directions).amax() < 1e-9);
        assert!(projection(&poses[..1]).is_none());
    }
}
