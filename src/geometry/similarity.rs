//! Sim(3): similarity transforms and their least-squares estimate from points.

use super::Rigid;
use nalgebra::{Matrix3, Vector3};

/// `x_target = scale * rotation * x_source + translation`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity {
    /// Target units per source unit, positive.
    pub scale: f64,
    /// Orthonormal, determinant +1.
    pub rotation: Matrix3<f64>,
    /// In the target frame.
    pub translation: Vector3<f64>,
}

impl Similarity {
    /// A point of the source frame in the target frame.
    pub fn transform(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point * self.scale + self.translation
    }

    /// `a_from_b.inverse()` is `b_from_a`.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self { scale: 1.0 / self.scale, rotation, translation: -(rotation * self.translation) / self.scale }
    }

    /// The same camera seen from the target world: `camera_from_source` becomes `camera_from_target`.
    ///
    /// Images do not change: the camera's own frame takes the target's unit of length.
    pub fn move_camera(&self, camera_from_source: &Rigid) -> Rigid {
        let center = self.transform(&camera_from_source.center());
        let rotation = camera_from_source.rotation * self.rotation.transpose();
        Rigid { rotation, translation: -(rotation * center) }
    }
}
