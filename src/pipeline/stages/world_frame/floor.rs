//! The floor under standing feet.

use crate::body::human_speeds::STANDING_FOOT_M_S;
use crate::body::skeleton::KeypointConvention;
use crate::geometry::rotation::tangents;
use crate::optim::robust::{median, quantile};
use crate::pipeline::up_direction::UpDirection;
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

/// Height above the lowest keypoints at which feet stand on no floor, m: those of people who lie.
const MAX_ABOVE_LOWEST_M: f64 = 0.15;

/// Heights above the floor of people whose feet no camera shows, m: of knees, also of people who sit, and of hips (ANSUR II, medians of
/// men and women).
const ABOVE_FLOOR: [(&str, f64); 2] = [("knee", 0.48), ("hip", 0.88)];

/// Share of the places of hips for which ankles are known, above which cameras show feet.
const SEEN: f64 = 0.1;

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

/// Height of the floor, m: under standing feet, or under the lowest keypoints where feet are in the air; without feet as far below the lowest
/// joints of legs as people have them.
pub(super) fn floor_height(
    convention: KeypointConvention,
    people: &[JointTrajectory],
    feet: &[StandingPoint],
    height_of: impl Fn(&Vector3<f64>) -> f64,
) -> f64 {
    let heights_of = |is_meant: &dyn Fn(&str) -> bool| -> Vec<f64> {
        let names = convention.names();
        let of_frame = |points: &Vec<Option<Vector3<f64>>>| -> Vec<f64> {
            let meant = points.iter().zip(names).filter(|(_, name)| is_meant(name));
            meant.filter_map(|(point, _)| point.as_ref().map(&height_of)).collect()
        };
        people.iter().flat_map(|person| &person.points).flat_map(of_frame).collect()
    };
    let heights_of_joints = |joint: &str| heights_of(&|name| name.ends_with(joint));
    let n_hips = heights_of_joints("hip").len() as f64;
    let are_seen = |joint: &str| heights_of_joints(joint).len() as f64 > SEEN * n_hips;
    if !are_seen("ankle") {
        let lowest = ABOVE_FLOOR.into_iter().find(|(joint, _)| are_seen(joint));
        let below = |(joint, above): (&str, f64)| Some(median(&mut heights_of_joints(joint))? - above);
        return lowest.and_then(below).unwrap_or(0.0);
    }
    let mut soles: Vec<f64> = feet.iter().map(|foot| height_of(&foot.position) - foot.height).collect();
    let lowest = quantile(&mut heights_of(&|_| true), 0.05).unwrap_or(0.0);
    quantile(&mut soles, 0.2).filter(|floor| *floor < lowest + MAX_ABOVE_LOWEST_M).unwrap_or(lowest)
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
    use crate::session::{FrameIndex, PersonId};

    fn feet_on(normal_from_up: &Matrix3<f64>) -> Vec<StandingPoint> {
        let foot = |i: usize| {
            let (x, z) = ((i % 20) as f64 * 0.1, (i / 20) as f64 * 0.1);
            let lifted = if i.is_multiple_of(9) { 0.3 } else { 0.0 };
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

    /// Heights of the joints of a person, by the ends of their names, at every frame.
    fn floor_of(heights: &[(&str, f64)], feet: &[StandingPoint]) -> f64 {
        let convention = KeypointConvention::Coco17;
        let known = |name: &&str| heights.iter().find(|(joint, _)| name.ends_with(joint));
        let point = |name| known(name).map(|(_, height)| Vector3::new(0.0, *height, 0.0));
        let points: Vec<_> = vec![convention.names().iter().map(point).collect(); 30];
        let n_views = points.iter().map(|points: &Vec<_>| vec![2; points.len()]).collect();
        let person = JointTrajectory { person: PersonId(0), first: FrameIndex(0), points, n_views };
        floor_height(convention, &[person], feet, |point| point.y)
    }

    /// Half bodies had the floor at their hips.
    #[test]
    fn without_feet_the_floor_lies_below_the_lowest_joints_of_legs() {
        let sitting = [("shoulder", 3.0), ("hip", 2.45), ("knee", 2.48)];
        assert!((floor_of(&sitting, &[]) - 2.0).abs() < 1e-9);
        assert!((floor_of(&sitting[..2], &[]) - 1.57).abs() < 1e-9);
        assert_eq!(floor_of(&sitting[..1], &[]), 0.0);
    }

    #[test]
    fn people_who_lie_with_their_legs_raised_lie_on_the_floor() {
        let lying = [("shoulder", 0.1), ("hip", 0.1), ("knee", 0.4), ("ankle", 0.6)];
        let raised = [StandingPoint { position: Vector3::new(0.0, 0.6, 0.0), height: 0.075 }; 40];
        assert_eq!(floor_of(&lying, &raised), 0.1);
        let standing = [("hip", 0.9), ("ankle", 0.07)];
        let below = [StandingPoint { position: Vector3::new(0.0, 0.07, 0.0), height: 0.075 }; 40];
        assert!((floor_of(&standing, &below) + 0.005).abs() < 1e-9);
    }
}
