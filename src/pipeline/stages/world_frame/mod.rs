//! World frame of the result: metres, the chosen axis up, origin on the floor under the people.

use crate::body::human_speeds::STANDING_FOOT_M_S;
use crate::geometry::{Rigid, Similarity};
use crate::optim::robust::quantile;
use crate::session::JointTrajectory;
use crate::session::recording::{Session, UpAxis};
use nalgebra::{Matrix3, Vector3};

/// Largest tilt of the floor under feet against the axis of bodies, rad; beyond it feet are on steps or wrong.
const MAX_TILT: f64 = 0.26; // 15 degrees

/// Smallest spread of standing feet in both directions that defines a plane, m.
const MIN_SPREAD: f64 = 0.25;

/// Heights of keypoints above the sole of a standing foot, m (lateral malleolus 68 mm, ANSUR II; toe and heel points on
/// the shoe).
const SOLE: [(&str, f64); 4] = [("ankle", 0.075), ("heel", 0.025), ("big_toe", 0.02), ("small_toe", 0.02)];

/// `world_from_solution`: scaled by `metres_per_unit`, `up_axis` up, floor at height zero, origin under the people's
/// centre, first placed camera's right axis along +x as far as the floor allows.
pub fn world_from_solution(
    session: &Session,
    cameras: &[Option<Rigid>],
    people: &[JointTrajectory],
    metres_per_unit: f64,
    up_axis: UpAxis,
) -> Similarity {
    let up_of_bodies = body_axis(session, people).or_else(|| camera_axis(cameras)).unwrap_or(-Vector3::y());
    let feet = standing_feet(session, people, metres_per_unit);
    let up = floor_normal(&feet, &up_of_bodies, metres_per_unit).unwrap_or(up_of_bodies);
    let level_from_solution = level_rotation(&up, cameras, up_axis);
    let scaled = |p: &Vector3<f64>| level_from_solution * p * metres_per_unit;
    let height = axis_index(up_axis);
    let mut heights: Vec<f64> = feet.iter().map(|(p, sole)| scaled(p)[height] - sole).collect();
    let floor = quantile(&mut heights, 0.2).unwrap_or(0.0);
    let mut origin = middle(people).map_or_else(Vector3::zeros, |m| scaled(&m));
    origin[height] = floor;
    Similarity { scale: metres_per_unit, rotation: level_from_solution, translation: -origin }
}

fn axis_index(up_axis: UpAxis) -> usize {
    match up_axis {
        UpAxis::X => 0,
        UpAxis::Y => 1,
        UpAxis::Z => 2,
    }
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

/// Mean direction from ankles (or hips) to shoulders.
fn body_axis(session: &Session, people: &[JointTrajectory]) -> Option<Vector3<f64>> {
    let index = |name: &str| session.convention.index_of(name);
    let pairs: Vec<(usize, usize)> = ["left", "right"]
        .iter()
        .flat_map(|side| {
            ["hip", "knee", "ankle"].map(|low| (index(&format!("{side}_{low}")), index(&format!("{side}_shoulder"))))
        })
        .filter_map(|(low, high)| Some((low?, high?)))
        .collect();
    let mut sum = Vector3::zeros();
    for points in people.iter().flat_map(|p| &p.points) {
        for &(low, high) in &pairs {
            if let (Some(low), Some(high)) = (points[low], points[high]) {
                sum += (high - low).try_normalize(1e-9).unwrap_or_else(Vector3::zeros);
            }
        }
    }
    sum.try_normalize(1e-6)
}

/// Mean up direction of the cameras, most of which stand upright.
fn camera_axis(cameras: &[Option<Rigid>]) -> Option<Vector3<f64>> {
    cameras.iter().flatten().map(|c| -c.rotation.row(1).transpose()).sum::<Vector3<f64>>().try_normalize(1e-6)
}

/// Points of feet that do not move, with their height above the sole (m).
fn standing_feet(session: &Session, people: &[JointTrajectory], metres_per_unit: f64) -> Vec<(Vector3<f64>, f64)> {
    let names = session.convention.names();
    let soles: Vec<(usize, f64)> = names
        .iter()
        .enumerate()
        .filter_map(|(k, n)| SOLE.iter().find(|(part, _)| n.ends_with(part)).map(|(_, h)| (k, *h)))
        .collect();
    let limit = STANDING_FOOT_M_S / session.fps / metres_per_unit;
    let span = ((session.fps * 0.1).round() as usize).max(1); // a tenth of a second averages detector noise
    let mut feet = Vec::new();
    for person in people {
        for t in span..person.points.len().saturating_sub(span) {
            for &(k, sole) in &soles {
                let (Some(before), Some(now), Some(after)) =
                    (person.points[t - span][k], person.points[t][k], person.points[t + span][k])
                else {
                    continue;
                };
                if (after - before).norm() < limit * 2.0 * span as f64 {
                    feet.push((now, sole));
                }
            }
        }
    }
    feet
}

/// Normal of the plane through standing feet, by re-weighted least squares; `None` where they do not define one.
fn floor_normal(feet: &[(Vector3<f64>, f64)], up: &Vector3<f64>, metres_per_unit: f64) -> Option<Vector3<f64>> {
    if feet.len() < 30 {
        return None;
    }
    let mut normal = *up;
    let mut weights = vec![1.0; feet.len()];
    for _ in 0..10 {
        let on_sole = |(p, sole): &(Vector3<f64>, f64)| p - normal * (sole / metres_per_unit);
        let points: Vec<Vector3<f64>> = feet.iter().map(on_sole).collect();
        let total: f64 = weights.iter().sum();
        let center = points.iter().zip(&weights).map(|(p, w)| p * *w).sum::<Vector3<f64>>() / total;
        let spread = points.iter().zip(&weights).map(|(p, w)| (p - center) * (p - center).transpose() * *w);
        let eigen = (spread.sum::<Matrix3<f64>>() / total).symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
        if eigen.eigenvalues[order[1]].max(0.0).sqrt() * metres_per_unit < MIN_SPREAD {
            return None;
        }
        let found: Vector3<f64> = eigen.eigenvectors.column(order[0]).into_owned();
        normal = if found.dot(up) < 0.0 { -found } else { found };
        for (point, weight) in points.iter().zip(&mut weights) {
            let off = normal.dot(&(point - center)) * metres_per_unit / FLOOR_NOISE_M;
            *weight = 1.0 / (1.0 + off * off).powi(2);
        }
    }
    (normal.angle(up) < MAX_TILT).then_some(normal)
}

/// Noise of a triangulated foot point, m.
const FLOOR_NOISE_M: f64 = 0.03;

fn middle(people: &[JointTrajectory]) -> Option<Vector3<f64>> {
    let (mut sum, mut n) = (Vector3::zeros(), 0usize);
    for point in people.iter().flat_map(|p| p.points.iter().flatten()).flatten() {
        sum += point;
        n += 1;
    }
    (n > 0).then(|| sum / n as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rotation;

    #[test]
    fn level_rotation_is_proper_and_maps_up() {
        let up = Vector3::new(0.1, -0.9, 0.3).normalize();
        for (axis, unit) in [(UpAxis::X, Vector3::x()), (UpAxis::Y, Vector3::y()), (UpAxis::Z, Vector3::z())] {
            let r = level_rotation(&up, &[Some(Rigid::identity())], axis);
            assert!((r.determinant() - 1.0).abs() < 1e-12);
            assert!((r * up - unit).norm() < 1e-12);
        }
    }

    #[test]
    fn finds_a_tilted_floor_with_outliers() {
        let tilt = rotation::exp(&Vector3::new(0.1, 0.0, -0.05));
        let normal = tilt * Vector3::y();
        let feet: Vec<(Vector3<f64>, f64)> = (0..400)
            .map(|i| {
                let (x, z) = ((i % 20) as f64 * 0.1, (i / 20) as f64 * 0.1);
                let lifted = if i % 9 == 0 { 0.3 } else { 0.0 };
                (tilt * Vector3::new(x, 0.02 + lifted, z), 0.02)
            })
            .collect();
        let found = floor_normal(&feet, &Vector3::y(), 1.0).unwrap();
        assert!(found.angle(&normal) < 0.005, "{} rad", found.angle(&normal));
    }
}
