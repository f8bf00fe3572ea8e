//! SE(3): rigid motions, always named `target_from_source`.

use super::rotation;
use nalgebra::{Matrix3, Vector3};
use std::ops::Mul;

/// `x_target = rotation * x_source + translation`.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Rigid {
    /// Rotation matrix of determinant +1.
    pub rotation: Matrix3<f64>,
    /// Position of the source's origin in the target frame, m.
    pub translation: Vector3<f64>,
}

impl Rigid {
    /// The identity.
    pub fn identity() -> Self {
        Self { rotation: Matrix3::identity(), translation: Vector3::zeros() }
    }

    /// The inverse motion: `a_from_b.inverse()` is `b_from_a`.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// Maps a point of the source frame to the target frame.
    pub fn transform(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.translation
    }

    /// Position of the target's origin in the source frame; for `camera_from_world` the camera's centre.
    pub fn center(&self) -> Vector3<f64> {
        -(self.rotation.transpose() * self.translation)
    }

    /// `Exp(xi) * self` with `xi = (rho, phi)` to first order in rho: the left increment of the solvers.
    ///
    /// `rotation <- exp(phi) rotation`, `translation <- exp(phi) translation + rho`; its derivative at zero is that of
    /// the group exponential, `d x_target = rho + phi x x_target`.
    pub fn perturbed_left(&self, rho: &Vector3<f64>, phi: &Vector3<f64>) -> Self {
        let turn = rotation::exp(phi);
        Self { rotation: turn * self.rotation, translation: turn * self.translation + rho }
    }
}

impl Mul for Rigid {
    type Output = Rigid;
    fn mul(self, b: Rigid) -> Rigid {
        Rigid { rotation: self.rotation * b.rotation, translation: self.transform(&b.translation) }
    }
}
