//! Errors of the world of a result: which way is up, and where the floor is.

use super::alignment::Alignment;
use super::camera_error::{CameraPair, truth_from_pairs};
use crate::session::recording::UpAxis;
use serde::Serialize;

/// Where the cameras of a result are placed as those of the truth, in all but their common position, rotation and scale.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct WorldError {
    /// Angle between the two ways up, degrees.
    pub up_deg: f64,
    /// Height of the result's floor over the true one, below the result's origin, mm.
    pub floor_mm: f64,
}

/// `solved_up`, `true_up`: axes that are up in the two worlds, where height zero is the floor. `None` without cameras.
pub fn world_error(pairs: &[CameraPair], solved_up: UpAxis, true_up: UpAxis) -> Option<WorldError> {
    if pairs.is_empty() {
        return None;
    }
    // Two cameras leave their axis open where they are aligned by their centres.
    let alignment = if pairs.len() > 2 { Alignment::Sim3 } else { Alignment::RigidPose };
    let truth_from_result = truth_from_pairs(pairs, alignment);
    let up = true_up.direction();
    Some(WorldError {
        up_deg: (truth_from_result.rotation * solved_up.direction()).angle(&up).to_degrees(),
        floor_mm: 1e3 * truth_from_result.translation.dot(&up),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Distortion, Intrinsics, Rigid, Similarity, rotation};
    use nalgebra::Vector3;

    #[test]
    fn a_tilted_world_with_its_floor_too_high_is_measured() {
        let camera = |x: f64| Rigid {
            rotation: rotation::exp(&Vector3::new(0.1 * x, 1.0 - x, 0.3)),
            translation: Vector3::new(x, 2.0 - x * x, 4.0),
        };
        let world_from_truth = Similarity {
            scale: 1.1,
            rotation: rotation::exp(&Vector3::new(0.05, 0.0, 0.0)),
            translation: Vector3::new(0.0, -0.22, 0.0),
        };
        let matrix = [[900.0, 0.0, 320.0], [0.0, 900.0, 240.0], [0.0, 0.0, 1.0]];
        let pair = |k: i32| CameraPair {
            id: k.to_string(),
            intrinsics: Intrinsics::from_matrix([640, 480], &matrix, Distortion::None),
            truth: camera(f64::from(k)),
            solved: world_from_truth.move_camera(&camera(f64::from(k))),
        };
        let pairs: Vec<CameraPair> = (0..4).map(pair).collect();
        let error = world_error(&pairs, UpAxis::Y, UpAxis::Y).unwrap();
        assert!((error.up_deg - 0.05_f64.to_degrees()).abs() < 1e-6, "{error:?}");
        assert!((error.floor_mm - 200.0 * 0.05_f64.cos()).abs() < 1e-6, "{error:?}");
        let other = world_error(&pairs, UpAxis::Z, UpAxis::Y).unwrap();
        assert!((other.up_deg - (90.0 - 0.05_f64.to_degrees())).abs() < 1e-6, "{other:?}");
        assert_eq!(world_error(&[], UpAxis::Y, UpAxis::Y), None);
    }
}
