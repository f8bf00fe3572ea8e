//! Errors of the world of a result: which way is up, and where the floor is.

use super::alignment::{Alignment, truth_from_solved};
use crate::geometry::Rigid;
use crate::session::recording::UpAxis;
use nalgebra::Vector3;
use serde::Serialize;

/// Where the cameras of a result are placed as those of the truth, in all but their common position, rotation and scale.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct WorldError {
    /// Angle between the two ways up, degrees.
    pub up_deg: f64,
    /// Height of the result's floor over the true one, below the result's origin, mm.
    pub floor_mm: f64,
}

/// `solved`, `truth`: `camera_from_world`, each with the axis that is up in its world, where height zero is the floor. `None` without cameras.
pub fn world_error(solved: (&[Rigid], UpAxis), truth: (&[Rigid], UpAxis)) -> Option<WorldError> {
    if solved.0.is_empty() {
        return None;
    }
    // Two cameras leave their axis open where they are aligned by their centres.
    let alignment = if solved.0.len() > 2 { Alignment::Sim3 } else { Alignment::RigidPose };
    let truth_from_result = truth_from_solved(solved.0, truth.0, alignment);
    let up = axis(truth.1);
    Some(WorldError {
        up_deg: (truth_from_result.rotation * axis(solved.1)).angle(&up).to_degrees(),
        floor_mm: 1e3 * truth_from_result.translation.dot(&up),
    })
}

fn axis(up: UpAxis) -> Vector3<f64> {
    match up {
        UpAxis::X => Vector3::x(),
        UpAxis::Y => Vector3::y(),
        UpAxis::Z => Vector3::z(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Similarity, rotation};

    #[test]
    fn a_tilted_world_with_its_floor_too_high_is_measured() {
        let camera = |x: f64| Rigid {
            rotation: rotation::exp(&Vector3::new(0.1 * x, 1.0 - x, 0.3)),
            translation: Vector3::new(x, 2.0 - x * x, 4.0),
        };
        let truth: Vec<Rigid> = (0..4).map(|k| camera(f64::from(k))).collect();
        let world_from_truth = Similarity {
            scale: 1.1,
            rotation: rotation::exp(&Vector3::new(0.05, 0.0, 0.0)),
            translation: Vector3::new(0.0, -0.22, 0.0),
        };
        let solved: Vec<Rigid> = truth.iter().map(|camera| world_from_truth.move_camera(camera)).collect();
        let error = world_error((&solved, UpAxis::Y), (&truth, UpAxis::Y)).unwrap();
        assert!((error.up_deg - 0.05_f64.to_degrees()).abs() < 1e-6, "{error:?}");
        assert!((error.floor_mm - 200.0 * 0.05_f64.cos()).abs() < 1e-6, "{error:?}");
        let other = world_error((&solved, UpAxis::Z), (&truth, UpAxis::Y)).unwrap();
        assert!((other.up_deg - (90.0 - 0.05_f64.to_degrees())).abs() < 1e-6, "{other:?}");
        assert_eq!(world_error((&[], UpAxis::Y), (&[], UpAxis::Y)), None);
    }
}
