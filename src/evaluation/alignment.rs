//! Alignment of the result's world to the truth's.

use crate::geometry::{Rigid, Similarity};
use nalgebra::{Matrix3, Matrix4, SymmetricEigen, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Kind of alignment: which transform is fitted, and to what.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Alignment {
    /// Rotation and translation, to the camera centres. Needs three centres off one line.
    Rigid,
    /// Rotation, translation and scale, to the camera centres. Needs three centres off one line.
    Sim3,
    /// Rotation to the orientations (chordal mean), then translation to the centres. Needs one camera.
    RigidPose,
    /// Rotation to the orientations (chordal mean), then translation and scale to the centres. Needs two cameras.
    Sim3Pose,
    /// No alignment: both worlds are the same.
    None,
}

impl Alignment {
    /// The name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rigid => "rigid",
            Self::Sim3 => "sim3",
            Self::RigidPose => "rigid_pose",
            Self::Sim3Pose => "sim3_pose",
            Self::None => "none",
        }
    }
}

/// The transform `truth_from_solved` for two lists of corresponding cameras; the identity for empty lists.
///
/// `solved`, `truth`: `camera_from_world`, metres, lists of the same length.
pub fn truth_from_solved(solved: &[Rigid], truth: &[Rigid], alignment: Alignment) -> Similarity {
    let centers = |cameras: &[Rigid]| cameras.iter().map(Rigid::center).collect::<Vec<_>>();
    let (source, target) = (centers(solved), centers(truth));
    match alignment {
        Alignment::Rigid => align_points(&source, &target, Scale::One),
        Alignment::Sim3 => align_points(&source, &target, Scale::Free),
        Alignment::RigidPose => align_with_rotation(&mean_rotation(solved, truth), &source, &target, Scale::One),
        Alignment::Sim3Pose => align_with_rotation(&mean_rotation(solved, truth), &source, &target, Scale::Free),
        Alignment::None => align_points(&[], &[], Scale::One),
    }
}

/// Scale of the alignment in [`align_points`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// Fixed to 1.
    One,
    /// Estimated.
    Free,
}

/// Least-squares alignment of corresponding points.
///
/// min over s, Q, b of `sum |y_i - (s Q x_i + b)|^2` (Umeyama, PAMI 1991). The rotation is found as Horn's quaternion
/// (J. Opt. Soc. Am. A 4, 1987), which never is a reflection.
///
/// `source`, `target`: n points each. Returns `target_from_source`; the identity for no points.
///
/// Known limit: the rotation about the line is arbitrary where the points lie on one.
pub fn align_points(source: &[Vector3<f64>], target: &[Vector3<f64>], scale: Scale) -> Similarity {
    let (source_mean, target_mean) = (mean(source), mean(target));
    let pairs = source.iter().zip(target).map(|(x, y)| (x - source_mean, y - target_mean));
    let covariance: Matrix3<f64> = pairs.map(|(x, y)| y * x.transpose()).sum();
    align_with_rotation(&best_rotation(&covariance), source, target, scale)
}

/// The chordal mean of the rotations `truth_from_solved` of all cameras' orientations.
fn mean_rotation(solved: &[Rigid], truth: &[Rigid]) -> Matrix3<f64> {
    let sum: Matrix3<f64> = solved.iter().zip(truth).map(|(s, t)| t.rotation.transpose() * s.rotation).sum();
    best_rotation(&sum)
}

/// [`align_points`] where the rotation Q is known: `s = sum y_i^T Q x_i / |X|^2` of the centred points.
fn align_with_rotation(
    rotation: &Matrix3<f64>,
    source: &[Vector3<f64>],
    target: &[Vector3<f64>],
    scale: Scale,
) -> Similarity {
    let (source_mean, target_mean) = (mean(source), mean(target));
    let pairs = || source.iter().zip(target).map(|(x, y)| (rotation * (x - source_mean), y - target_mean));
    let spread: f64 = pairs().map(|(x, _)| x.norm_squared()).sum();
    let fitted: f64 = pairs().map(|(x, y)| y.dot(&x)).sum();
    let scale = if scale == Scale::Free && spread > 0.0 { fitted / spread } else { 1.0 };
    Similarity { scale, rotation: *rotation, translation: target_mean - rotation * source_mean * scale }
}

fn mean(points: &[Vector3<f64>]) -> Vector3<f64> {
    points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64
}

/// The rotation Q that maximises `tr(Q^T covariance)`: the eigenvector of Horn's 4x4 matrix with the largest eigenvalue.
fn best_rotation(covariance: &Matrix3<f64>) -> Matrix3<f64> {
    if covariance.norm_squared() == 0.0 {
        return Matrix3::identity();
    }
    let s = covariance.transpose();
    let trace = s.trace();
    let axial = Vector3::new(s[(1, 2)] - s[(2, 1)], s[(2, 0)] - s[(0, 2)], s[(0, 1)] - s[(1, 0)]);
    let mut horn = Matrix4::zeros();
    horn[(0, 0)] = trace;
    horn.fixed_view_mut::<3, 1>(1, 0).copy_from(&axial);
    horn.fixed_view_mut::<1, 3>(0, 1).copy_from(&axial.transpose());
    horn.fixed_view_mut::<3, 3>(1, 1).copy_from(&(s + s.transpose() - Matrix3::identity() * trace));
    let eigen = SymmetricEigen::new(horn);
    let best = eigen.eigenvalues.imax();
    let q = eigen.eigenvectors.column(best);
    let quaternion = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q[0], q[1], q[2], q[3]));
    quaternion.to_rotation_matrix().into_inner()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rotation;

    fn points() -> Vec<Vector3<f64>> {
        (0..7).map(f64::from).map(|i| Vector3::new(i.sin(), (2.0 * i).cos(), 0.3 * i)).collect()
    }

    #[test]
    fn recovers_a_similarity() {
        let truth = Similarity {
            scale: 1.7,
            rotation: rotation::exp(&Vector3::new(2.0, -1.5, 1.0)),
            translation: Vector3::new(3.0, -4.0, 5.0),
        };
        let target: Vec<_> = points().iter().map(|p| truth.transform(p)).collect();
        let found = align_points(&points(), &target, Scale::Free);
        assert!((found.scale - truth.scale).abs() < 1e-12);
        assert!((found.rotation - truth.rotation).norm() < 1e-12);
        assert!((found.translation - truth.translation).norm() < 1e-11);
        assert_eq!(align_points(&points(), &target, Scale::One).scale, 1.0);
    }

    #[test]
    fn aligns_mirrored_points_by_a_rotation() {
        let target: Vec<_> = points().iter().map(|p| Vector3::new(-p.x, p.y, p.z)).collect();
        let found = align_points(&points(), &target, Scale::Free);
        assert!((found.rotation.determinant() - 1.0).abs() < 1e-12);
        assert!(found.scale > 0.0 && found.scale < 1.0);
    }

    #[test]
    fn two_cameras_determine_rotation_and_scale() {
        let cameras = [Vector3::x(), Vector3::new(0.3, 2.0, -1.0)]
            .map(|translation| Rigid { rotation: rotation::exp(&(translation * 0.7)), translation });
        let rotation = rotation::exp(&Vector3::new(0.4, -0.2, 0.9));
        let moved = Similarity { scale: 0.4, rotation, translation: Vector3::y() };
        let solved = cameras.map(|camera| moved.move_camera(&camera));
        let found = truth_from_solved(&solved, &cameras, Alignment::Sim3Pose);
        let point = Vector3::new(1.0, -2.0, 0.5);
        assert!((found.transform(&moved.transform(&point)) - point).norm() < 1e-12);
    }

    #[test]
    fn one_camera_determines_rotation() {
        let camera =
            Rigid { rotation: rotation::exp(&Vector3::new(0.3, 0.2, 0.1)), translation: Vector3::new(1.0, 2.0, 3.0) };
        let moved = Similarity { scale: 1.0, rotation: rotation::exp(&Vector3::y()), translation: Vector3::x() };
        let solved = moved.move_camera(&camera);
        let found = truth_from_solved(&[solved], &[camera], Alignment::RigidPose);
        let back = found.move_camera(&solved);
        assert!((back.rotation - camera.rotation).norm() < 1e-12);
        assert!((back.translation - camera.translation).norm() < 1e-12);
    }
}
