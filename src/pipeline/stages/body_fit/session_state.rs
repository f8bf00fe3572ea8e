//! The unknowns that all persons of a session share: offsets of the detector's keypoints, and the cameras.

use super::terms::camera_unknowns::FOCAL;
use super::terms::unknowns::CameraColumns;
use crate::pipeline::calibration::PosedCamera;
use nalgebra::{DVector, Vector3};

/// Values of the unknowns of a session.
#[derive(Debug, Clone)]
pub(super) struct SessionState {
    /// Offsets of the keypoints by kind, m.
    pub offsets: Vec<Vector3<f64>>,
    pub cameras: Vec<PosedCamera>,
}

impl SessionState {
    /// After a step of the offsets, then of the cameras where `columns` has them.
    pub(super) fn moved(&self, step: &DVector<f64>, columns: CameraColumns) -> Self {
        let offset = |(k, offset): (usize, &Vector3<f64>)| offset + step.fixed_rows::<3>(3 * k);
        let (first, n) = (3 * self.offsets.len(), columns.unknowns.len());
        let camera = |(i, camera): (usize, &PosedCamera)| {
            let part = |k: usize| step.fixed_rows::<3>(first + n * i + k).into_owned();
            let focal_factor = if columns.unknowns.focal { step[first + n * i + FOCAL].exp() } else { 1.0 };
            PosedCamera {
                intrinsics: camera.intrinsics.with_focal_factor(focal_factor),
                camera_from_world: camera.camera_from_world.perturbed_left(&part(0), &part(3)),
            }
        };
        let cameras = match columns.n_cameras {
            0 => self.cameras.clone(),
            _ => self.cameras.iter().enumerate().map(camera).collect(),
        };
        Self { offsets: self.offsets.iter().enumerate().map(offset).collect(), cameras }
    }
}
