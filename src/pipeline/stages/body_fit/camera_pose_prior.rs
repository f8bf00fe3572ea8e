//! Given poses of the cameras as a prior of the adjusted ones.

use super::terms::camera_unknowns::POSE;
use crate::geometry::{Rigid, rotation};
use crate::pipeline::calibration::PosedCamera;
use nalgebra::{Vector3, Vector6};

/// Normal prior of the cameras' poses about those given.
#[derive(Debug, Clone)]
pub(super) struct CameraPosePrior {
    /// `camera_from_world` by camera.
    pub given: Vec<Rigid>,
}

/// Standard deviation of a given centre per axis, m: what a calibration with a board or a wand in the middle of a room leaves, some
/// thousandths of the distance.
const SIGMA_POSITION: f64 = 0.02;

/// Standard deviation of a given orientation per axis, rad: 0.3 degrees, what a tripod turns when it is brushed against.
const SIGMA_ANGLE: f64 = 0.005;

impl CameraPosePrior {
    /// `sum |C - C_0|^2 / (2 sigma_position^2) + |log(R R_0^T)|^2 / (2 sigma_angle^2)`.
    pub(super) fn cost(&self, cameras: &[PosedCamera]) -> f64 {
        cameras.iter().zip(&self.given).map(|(camera, given)| cost(&camera.camera_from_world, given)).sum()
    }

    /// Gradient by each camera's left increment (rho, phi).
    pub(super) fn gradients(&self, cameras: &[PosedCamera]) -> Vec<Vector6<f64>> {
        cameras.iter().zip(&self.given).map(|(camera, given)| gradient(&camera.camera_from_world, given)).collect()
    }

    /// Second derivative by each of these unknowns, to first order in the distance from what was given.
    pub(super) fn precisions() -> [f64; POSE] {
        std::array::from_fn(|k| if k < 3 { SIGMA_POSITION.powi(-2) } else { SIGMA_ANGLE.powi(-2) })
    }
}

/// Centre and orientation against those given: `-R (C - C_0)`, in which a left increment rho is added, and `log(R R_0^T)`.
fn difference(pose: &Rigid, given: &Rigid) -> (Vector3<f64>, Vector3<f64>) {
    (pose.rotation * (given.center() - pose.center()), rotation::log(&(pose.rotation * given.rotation.transpose())))
}

fn cost(pose: &Rigid, given: &Rigid) -> f64 {
    let (shift, turn) = difference(pose, given);
    0.5 * (shift.norm_squared() / SIGMA_POSITION.powi(2) + turn.norm_squared() / SIGMA_ANGLE.powi(2))
}

/// A rotation's logarithm is its own gradient: `d |log(exp(phi) Q)|^2 / 2 = log(Q)^T phi`.
fn gradient(pose: &Rigid, given: &Rigid) -> Vector6<f64> {
    let (shift, turn) = difference(pose, given);
    let (shift, turn) = (shift / SIGMA_POSITION.powi(2), turn / SIGMA_ANGLE.powi(2));
    Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residuals::derivative_check::assert_gradient;

    #[test]
    fn gradient_matches_differences() {
        let given =
            Rigid { rotation: rotation::exp(&Vector3::new(0.3, -0.8, 0.2)), translation: Vector3::new(0.2, -0.4, 4.0) };
        let pose = given.perturbed_left(&Vector3::new(0.03, -0.01, 0.02), &Vector3::new(-0.01, 0.02, 0.004));
        assert_gradient(gradient(&pose, &given).as_slice(), |d| {
            cost(
                &pose.perturbed_left(&Vector3::from_column_slice(&d[..3]), &Vector3::from_column_slice(&d[3..])),
                &given,
            )
        });
        assert_eq!(cost(&given, &given), 0.0);
    }

    /// A standard deviation along one axis costs a half.
    #[test]
    fn a_standard_deviation_costs_a_half() {
        let given = Rigid::identity();
        let shifted = Rigid { translation: Vector3::x() * SIGMA_POSITION, ..given };
        let turned = Rigid { rotation: rotation::exp(&(Vector3::y() * SIGMA_ANGLE)), ..given };
        assert!((cost(&shifted, &given) - 0.5).abs() < 1e-12);
        assert!((cost(&turned, &given) - 0.5).abs() < 1e-9);
    }
}
