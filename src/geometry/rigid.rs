//! SE(3): rigid motions, always named `target_from_source`.

use super::rotation;
use nalgebra::{Matrix3, Vector3};
use std::ops::Mul;

/// `x_target = rotation * x_source + translation`.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Rigid {
    /// Orthonormal, determinant +1.
    pub rotation: Matrix3<f64>,
    /// Metres, in the target frame.
    pub translation: Vector3<f64>,
}

impl Rigid {
    /// The motion that moves nothing.
    pub fn identity() -> Self {
        Self { rotation: Matrix3::identity(), translation: Vector3::zeros() }
    }

    /// `a_from_b.inverse()` is `b_from_a`.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// A point of the source frame in the target frame.
    pub fn transform(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.translation
    }

    /// Where the target's origin lies in the source frame; for `camera_from_world` the camera's centre.
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
