//! World frame of the result: metres, the chosen axis up, origin on the floor under the people.
//!
//! Standing feet level the likeliest way up.

mod floor;

use crate::geometry::{Rigid, Similarity};
use crate::pipeline::up_direction::{UpRival, up_direction};
use crate::session::JointTrajectory;
use crate::session::recording::{Session, UpAxis};
use floor::{floor_height, levelled, standing_feet};
use nalgebra::{Matrix3, Vector3};

/// The world of a result.
#[derive(Debug, Clone, Copy)]
pub struct World {
    /// Scaled by `metres_per_unit`, the up axis up, floor at height zero, origin under the people's centre, first placed camera's right
    /// axis along +x as far as the floor allows.
    pub world_from_solution: Similarity,
    /// Another way up, as far as there is one.
    pub rival: Option<UpRival>,
}

/// The world in which people stand on the floor.
pub fn world(
    session: &Session,
    cameras: &[Option<Rigid>],
    people: &[JointTrajectory],
    metres_per_unit: f64,
    up_axis: UpAxis,
) -> World {
    let feet = standing_feet(session, people, metres_per_unit);
    let likeliest = up_direction(session.convention, cameras, people);
    let up = levelled(&likeliest, &feet, metres_per_unit);
    let level_from_solution = level_rotation(&up, cameras, up_axis);
    let height = up_axis.index();
    let height_of = |p: &Vector3<f64>| (level_from_solution * p)[height] * metres_per_unit;
    let mut origin = middle(people).map_or_else(Vector3::zeros, |m| level_from_solution * m * metres_per_unit);
    origin[height] = floor_height(session.convention, people, &feet, height_of);
    let world_from_solution =
        Similarity { scale: metres_per_unit, rotation: level_from_solution, translation: -origin };
    World { world_from_solution, rival: likeliest.rival }
}

/// Rotation that takes `up` to the up axis and the first camera's right axis as near to +x (or +y for x up) as possible.
fn level_rotation(up: &Vector3<f64>, cameras: &[Option<Rigid>], up_axis: UpAxis) -> Matrix3<f64> {
    let right = cameras.iter().flatten().next().map_or_else(Vector3::x, |c| c.rotation.row(0).transpose());
    let mut side = right - up * right.dot(up);
    if side.norm() < 1e-6 {
        side = up.cross(&Vector3::new(0.3, 0.5, 0.8));
    }
    let side = side.normalize();
    let third = side.cross(up);
    // Rows are the solution's directions that become the world's x, y, z; both choices are right-handed.
    match up_axis {
        UpAxis::Y => Matrix3::from_rows(&[side.transpose(), up.transpose(), third.transpose()]),
        UpAxis::Z => Matrix3::from_rows(&[side.transpose(), -third.transpose(), up.transpose()]),
        UpAxis::X => Matrix3::from_rows(&[up.transpose(), side.transpose(), -third.transpose()]),
    }
}

fn middle(people: &[JointTrajectory]) -> Option<Vector3<f64>> {
    let points = || people.iter().flat_map(|person| person.points.iter().flatten()).flatten();
    let n = points().count();
    (n > 0).then(|| points().sum::<Vector3<f64>>() / n as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn level_rotation_is_proper_and_maps_up() {
        let up = Vector3::new(0.1, -0.9, 0.3).normalize();
        for (axis, unit) in [(UpAxis::X, Vector3::x()), (UpAxis::Y, Vector3::y()), (UpAxis::Z, Vector3::z())] {
            let r = level_rotation(&up, &[Some(Rigid::identity())], axis);
            assert!((r.determinant() - 1.0).abs() < 1e-12);
            assert!((r * up - unit).norm() < 1e-12);
        }
    }
}
