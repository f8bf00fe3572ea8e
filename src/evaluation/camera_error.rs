//! Errors of solved cameras.

use super::alignment::{Alignment, truth_from_solved};
use crate::geometry::{Distortion, Intrinsics, Rigid, Similarity, rotation};
use crate::session::reconstruction::SolvedCamera;
use crate::session::{Session, View};
use nalgebra::{Vector2, Vector3};
use serde::Serialize;
use std::collections::BTreeMap;

/// A camera with its true and its solved pose.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraPair {
    /// Its name.
    pub id: String,
    /// Its intrinsics; reprojection errors ignore the distortion of both cameras.
    pub intrinsics: Intrinsics,
    /// True `camera_from_world`.
    pub truth: Rigid,
    /// Solved `camera_from_world`, in the solution's own world.
    pub solved: Rigid,
}

/// Pairs the solved cameras of a result with the true ones (`camera_from_world`), in the session's order.
pub fn camera_pairs(session: &Session, truth: &[Rigid], solved: &[SolvedCamera]) -> Vec<CameraPair> {
    let views = session.views.iter().zip(truth).zip(solved);
    let pair = |((view, truth), solved): ((&View, &Rigid), &SolvedCamera)| {
        let (id, intrinsics) = (view.id.clone(), view.intrinsics);
        Some(CameraPair { id, intrinsics, truth: *truth, solved: solved.camera_from_world? })
    };
    views.filter_map(pair).collect()
}

/// [`truth_from_solved`] by the two poses of every camera.
pub fn truth_from_pairs(pairs: &[CameraPair], alignment: Alignment) -> Similarity {
    let (solved, truth): (Vec<Rigid>, Vec<Rigid>) = pairs.iter().map(|pair| (pair.solved, pair.truth)).unzip();
    truth_from_solved(&solved, &truth, alignment)
}

/// Errors of all cameras after one alignment; means over cameras.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CameraErrors {
    /// Distance of the centres, mm.
    pub position_mm: Option<f64>,
    /// Angle between the orientations, degrees.
    pub angle_deg: Option<f64>,
    /// Distance between projections of the true joints by the true and the solved camera, px.
    pub reprojection_px: Option<f64>,
    /// The alignment.
    pub mode: Alignment,
    /// Scale of the alignment, truth over solution.
    pub scale: f64,
    /// Number of solved cameras.
    pub n_cameras: usize,
    /// Errors by camera.
    pub per_camera: BTreeMap<String, CameraError>,
}

/// Errors of one camera after alignment.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CameraError {
    /// Distance of the centres, mm.
    pub position_mm: f64,
    /// Angle between the orientations, degrees.
    pub angle_deg: f64,
    /// Mean distance between projections, px; `None` where the true camera sees no joint.
    pub reprojection_px: Option<f64>,
}

/// Smallest depth of a joint that is compared, m.
const MIN_DEPTH: f64 = 0.1;
/// Error of a joint that is behind the solved camera, px.
const BEHIND_PX: f64 = 1e4;

/// Errors after the alignment; `points`: true joints, world metres. Per camera: `|C_aligned - C_true|`, the angle of
/// `R_aligned^T R_true`, and the mean distance between the projections of the points inside the true image.
pub fn camera_errors(pairs: &[CameraPair], points: &[Vector3<f64>], alignment: Alignment) -> CameraErrors {
    let truth_from_solved = truth_from_pairs(pairs, alignment);
    let error = |pair: &CameraPair| {
        let aligned = truth_from_solved.move_camera(&pair.solved);
        CameraError {
            position_mm: 1e3 * (aligned.center() - pair.truth.center()).norm(),
            angle_deg: angle_between(&aligned, &pair.truth),
            reprojection_px: reprojection_error(pair, &aligned, points),
        }
    };
    let errors: Vec<CameraError> = pairs.iter().map(error).collect();
    CameraErrors {
        position_mm: mean(errors.iter().map(|e| e.position_mm)),
        angle_deg: mean(errors.iter().map(|e| e.angle_deg)),
        reprojection_px: mean(errors.iter().filter_map(|e| e.reprojection_px)),
        mode: alignment,
        scale: truth_from_solved.scale,
        n_cameras: pairs.len(),
        per_camera: pairs.iter().map(|p| p.id.clone()).zip(errors).collect(),
    }
}

/// Errors of relative camera poses, which need no alignment, of the worst pair.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RelativeCameraError {
    /// Largest angle between true and solved relative rotation, degrees.
    pub rotation_deg: f64,
    /// Largest angle between the true and the solved direction to another camera, seen from the first, degrees.
    pub direction_deg: f64,
    /// Number of pairs.
    pub n_pairs: usize,
}

/// Largest relative errors over all pairs of cameras, in both orders; `None` for fewer than two cameras.
///
/// With `R_ij = R_j R_i^T` and `d_ij = R_i (C_j - C_i)`: the angle between the true and the solved `R_ij`, and between the
/// true and the solved `d_ij`. Neither depends on the world or the scale.
pub fn relative_camera_error(pairs: &[CameraPair]) -> Option<RelativeCameraError> {
    let mut worst = RelativeCameraError { rotation_deg: 0.0, direction_deg: 0.0, n_pairs: 0 };
    for (i, a) in pairs.iter().enumerate() {
        for (j, b) in pairs.iter().enumerate().filter(|(j, _)| *j != i) {
            let (truth, solved) = (b.truth * a.truth.inverse(), b.solved * a.solved.inverse());
            worst.n_pairs += usize::from(i < j);
            worst.rotation_deg = worst.rotation_deg.max(angle_between(&truth, &solved));
            let directions = (truth.center(), solved.center());
            worst.direction_deg = worst.direction_deg.max(directions.0.angle(&directions.1).to_degrees());
        }
    }
    (worst.n_pairs > 0).then_some(worst)
}

/// Angle of the relative rotation of two orientations, degrees.
fn angle_between(a: &Rigid, b: &Rigid) -> f64 {
    rotation::angle_between(&a.rotation, &b.rotation).to_degrees()
}

/// Mean over the points inside the true camera's image, px.
fn reprojection_error(pair: &CameraPair, aligned: &Rigid, points: &[Vector3<f64>]) -> Option<f64> {
    let ideal = Intrinsics { dist: Distortion::None, ..pair.intrinsics };
    let (width, height) = (f64::from(ideal.width), f64::from(ideal.height));
    let project = |camera: &Rigid, point: &Vector3<f64>| {
        let p = camera.transform(point);
        (p.z > MIN_DEPTH).then(|| ideal.pixel_from_normalized(&Vector2::new(p.x / p.z, p.y / p.z)))
    };
    let error = |point: &Vector3<f64>| {
        let seen = project(&pair.truth, point)?;
        let inside = seen.x > 0.0 && seen.y > 0.0 && seen.x < width && seen.y < height;
        inside.then(|| project(aligned, point).map_or(BEHIND_PX, |pixel| (pixel - seen).norm()))
    };
    mean(points.iter().filter_map(error))
}

/// Arithmetic mean; `None` for no values.
pub(super) fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, n) = values.fold((0.0, 0_usize), |(sum, n), value| (sum + value, n + 1));
    (n > 0).then(|| sum / n as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Similarity;

    fn ring(n: usize) -> Vec<CameraPair> {
        let intrinsics = Intrinsics::PLAIN;
        (0..n)
            .map(|i| {
                let turn = rotation::exp(&Vector3::new(0.1 * i as f64, 1.1 * i as f64, 0.0));
                let truth = Rigid { rotation: turn, translation: Vector3::new(0.0, 0.1 * i as f64, 4.0) };
                CameraPair { id: i.to_string(), intrinsics, truth, solved: truth }
            })
            .collect()
    }

    #[test]
    fn a_similarity_leaves_no_error_after_alignment() {
        let moved = Similarity { scale: 0.5, rotation: rotation::exp(&Vector3::x()), translation: Vector3::y() };
        let mut pairs = ring(4);
        pairs.iter_mut().for_each(|pair| pair.solved = moved.move_camera(&pair.truth));
        let points = [Vector3::zeros(), Vector3::new(0.2, 0.1, 0.1)];
        let errors = camera_errors(&pairs, &points, Alignment::Sim3);
        assert!((errors.scale - 2.0).abs() < 1e-12);
        assert!(errors.position_mm.unwrap() < 1e-9 && errors.angle_deg.unwrap() < 1e-6);
        assert!(errors.reprojection_px.unwrap() < 1e-9);
        assert!(camera_errors(&pairs, &points, Alignment::Rigid).position_mm.unwrap() > 100.0);
        let relative = relative_camera_error(&pairs).unwrap();
        assert!(relative.rotation_deg < 1e-6 && relative.direction_deg < 1e-5 && relative.n_pairs == 6);
    }

    #[test]
    fn finds_the_worst_pair() {
        let mut pairs = ring(3);
        let angle = 3.0_f64.to_radians();
        pairs[1].solved = pairs[1].truth.perturbed_left(&Vector3::zeros(), &Vector3::new(0.0, 0.0, angle));
        let relative = relative_camera_error(&pairs).unwrap();
        assert!((relative.rotation_deg - 3.0).abs() < 1e-9);
        // The rotated camera sees the others rotated about its own axis: by at most 3 degrees, less outside the image plane.
        assert!(relative.direction_deg > 0.5 && relative.direction_deg < 3.0 + 1e-9);
        assert_eq!(relative_camera_error(&pairs[..1]), None);
    }
}
