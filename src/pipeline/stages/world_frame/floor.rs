//! The floor under standing feet.

use super::up_direction::{UpDirection, tangents};
use crate::body::human_speeds::STANDING_FOOT_M_S;
use crate::session::JointTrajectory;
use crate::session::recording::Session;
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// Noise of a triangulated foot point, m.
const FOOT_NOISE_M: f64 = 0.03;

/// Error of feet that more of them do not average, as the detector's are slow: that of the plane over its extent, m. With the way up
/// from cameras that roll by 3 degrees, 72 captures are 2.2 degrees off without feet, 1.9 with 30 mm, 1.7 with 20.
const COMMON_FOOT_ERROR_M: f64 = 0.02;

/// Fewest points of feet that are taken for a floor.
const MIN_POINTS: usize = 30;

/// Rounds of weights by distance from the floor.
const ROUNDS: usize = 10;

/// Largest squared distance between the floor's normal and the way up, in their standard deviations: 95 % of two dimensions. Feet on
/// stairs, on rungs and in the air stand on no floor.
const MAX_DISTANCE: f64 = 6.0;

/// Heights of keypoints above the sole of a standing foot, m (lateral malleolus 68 mm, ANSUR II; toe and heel points on
/// the shoe).
const SOLE: [(&str, f64); 4] = [("ankle", 0.075), ("heel", 0.025), ("big_toe", 0.02), ("small_toe", 0.02)];

/// A foot that stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StandingPoint {
    /// In the solution.
    pub(super) position: Vector3<f64>,
    /// Height above the sole, m.
    pub(super) height: f64,
}

/// Points of feet that do not move.
pub(super) fn standing_feet(session: &Session, people: &[JointTrajectory], metres_per_unit: f64) -> Vec<StandingPoint> {
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
            for &(k, height) in &soles {
                let (Some(before), Some(position), Some(after)) =
                    (person.points[t - span][k], person.points[t][k], person.points[t + span][k])
                else {
                    continue;
                };
                if (after - before).norm() < limit * 2.0 * span as f64 {
                    feet.push(StandingPoint { position, height });
                }
            }
        }
    }
    feet
}

/// The way up with what the floor under standing feet says of it, each by its uncertainty.
pub(super) fn levelled(up: &UpDirection, feet: &[StandingPoint], metres_per_unit: f64) -> Vector3<f64> {
    let by_floor = || {
        let known = up.covariance.try_inverse()?;
        let Slope { pull, precision } = Slope::under(feet, up, &known, metres_per_unit)?;
        let free = (precision + Matrix2::identity()).try_inverse()?; // a radian where feet say nothing
        let slope = (precision + Matrix2::identity() + known).try_inverse()? * pull;
        let distance = pull.dot(&(free * pull)) - pull.dot(&slope);
        (distance < MAX_DISTANCE).then_some(slope)
    };
    let tilted = |slope| up.direction - tangents(&up.direction) * slope;
    by_floor().map_or(up.direction, |slope| tilted(slope).normalize())
}

/// How the floor rises along the two [`tangents`] of the way up, as a least-squares problem.
struct Slope {
    /// Normal equations: `precision * slope = pull`, 1/rad^2.
    precision: Matrix2<f64>,
    pull: Vector2<f64>,
}

impl Slope {
    /// Heights of soles over their places, re-weighted; `known`: precision with which the floor is level.
    fn under(feet: &[StandingPoint], up: &UpDirection, known: &Matrix2<f64>, metres_per_unit: f64) -> Option<Self> {
        if feet.len() < MIN_POINTS {
            return None;
        }
        let tilts = tangents(&up.direction);
        let place = |foot: &StandingPoint| tilts.tr_mul(&foot.position) * metres_per_unit;
        let height = |foot: &StandingPoint| up.direction.dot(&foot.position) * metres_per_unit - foot.height;
        let points: Vec<Vector3<f64>> = feet.iter().map(|foot| place(foot).push(height(foot))).collect();
        let mut weights = vec![1.0; points.len()];
        let mut found = Self { precision: Matrix2::zeros(), pull: Vector2::zeros() };
        for _ in 0..ROUNDS {
            let total: f64 = weights.iter().sum();
            let center = points.iter().zip(&weights).map(|(p, w)| p * *w).sum::<Vector3<f64>>() / total;
            let spread = points.iter().zip(&weights).map(|(p, w)| (p - center) * (p - center).transpose() * *w);
            let spread = spread.sum::<Matrix3<f64>>() / (total * COMMON_FOOT_ERROR_M.powi(2));
            found = Self {
                precision: spread.fixed_view::<2, 2>(0, 0).into(),
                pull: spread.fixed_view::<2, 1>(0, 2).into(),
            };
            let slope = (found.precision + known).try_inverse()? * found.pull;
            for (point, weight) in points.iter().zip(&mut weights) {
                let off = (point - center).z - slope.dot(&(point - center).xy());
                *weight = (1.0 + (off / FOOT_NOISE_M).powi(2)).powi(-2);
            }
        }
        Some(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rotation;

    fn feet_on(normal_from_up: &Matrix3<f64>) -> Vec<StandingPoint> {
        let foot = |i: usize| {
            let (x, z) = ((i % 20) as f64 * 0.1, (i / 20) as f64 * 0.1);
            let lifted = if i % 9 == 0 { 0.3 } else { 0.0 };
            StandingPoint { position: normal_from_up * Vector3::new(x, 0.02 + lifted, z), height: 0.02 }
        };
        (0..400).map(foot).collect()
    }

    fn known_to(sigma: f64) -> UpDirection {
        UpDirection { direction: Vector3::y(), covariance: Matrix2::identity() * sigma * sigma, rival: None }
    }

    #[test]
    fn finds_a_tilted_floor_with_outliers() {
        let tilt = rotation::exp(&Vector3::new(0.1, 0.0, -0.05));
        let found = levelled(&known_to(0.2), &feet_on(&tilt), 1.0);
        assert!(found.angle(&(tilt * Vector3::y())) < 0.005, "{found}");
    }

    /// Feet on rungs and stairs leant the floor by up to 15 degrees.
    #[test]
    fn feet_on_a_slope_are_no_floor_where_the_way_up_is_known() {
        let slope = rotation::exp(&Vector3::new(0.2, 0.0, 0.0));
        let found = levelled(&known_to(0.02), &feet_on(&slope), 1.0);
        assert!(found.angle(&Vector3::y()) < 0.01, "{found}");
    }

    #[test]
    fn feet_in_a_line_level_it_along_the_line_alone() {
        let tilt = rotation::exp(&Vector3::new(0.05, 0.0, 0.1));
        let in_line =
            |i: usize| StandingPoint { position: tilt * Vector3::new(0.01 * i as f64, 0.0, 0.0), height: 0.0 };
        let feet: Vec<StandingPoint> = (0..200).map(in_line).collect();
        let found = levelled(&known_to(0.1), &feet, 1.0);
        assert!((found.x + 0.1).abs() < 0.015 && found.z.abs() < 0.003, "{found}");
    }
}
