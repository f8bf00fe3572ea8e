//! How well a detected hand continues an arm.

use crate::body::hand::{HandPoint, Side, hand_keypoints, hand_points};
use crate::body::skeleton::KeypointConvention;
use crate::geometry::{Intrinsics, Rigid};
use crate::session::Keypoint;
use nalgebra::{Vector2, Vector3};

/// Wrist and knuckles of a detected hand, px.
pub(super) struct SeenHand {
    wrist: Option<Vector2<f64>>,
    knuckles: Option<Vector2<f64>>,
}

impl SeenHand {
    /// `None` where neither was detected.
    pub(super) fn of(keypoints: &[Keypoint], convention: KeypointConvention, side: Side) -> Option<Self> {
        let hand = keypoints.get(hand_keypoints(convention, side)?)?;
        let mut knuckles: Vec<Vector2<f64>> = Vec::new();
        let mut wrist = None;
        for (keypoint, point) in hand.iter().zip(hand_points()).filter(|(keypoint, _)| keypoint.is_present()) {
            match point {
                HandPoint::Wrist => wrist = Some(keypoint.pixel),
                HandPoint::Joint { finger: 0..4, place: 0 } => knuckles.push(keypoint.pixel),
                HandPoint::Joint { .. } => {}
            }
        }
        let middle = |of: &[f64]| of[of.len() / 2];
        let median = |axis: usize| {
            let mut values: Vec<f64> = knuckles.iter().map(|pixel| pixel[axis]).collect();
            values.sort_by(f64::total_cmp);
            middle(&values)
        };
        let knuckles = (!knuckles.is_empty()).then(|| Vector2::new(median(0), median(1)));
        (wrist.is_some() || knuckles.is_some()).then_some(Self { wrist, knuckles })
    }
}

/// A forearm in space: the wrist, and where the knuckles are when the hand continues it, world, m.
#[derive(Debug, Clone, Copy)]
pub(super) struct Arm {
    wrist: Vector3<f64>,
    knuckles: Vector3<f64>,
}

/// From the wrist to the knuckles, m.
const PALM: f64 = 0.09;
/// Standard deviation of a hand's wrist about the projected wrist, m on the body: both detections and the trajectory.
const WRIST_SIGMA: f64 = 0.025;
/// The same of the knuckles: a wrist bends by 40 degrees.
const KNUCKLES_SIGMA: f64 = 0.06;
/// Largest squared misfit of one point: beyond five standard deviations it is an outlier.
const MAX_MISFIT: f64 = 25.0;

impl Arm {
    /// From a person's points in the order of the convention; `None` where they are not known.
    pub(super) fn of(points: &[Option<Vector3<f64>>], convention: KeypointConvention, side: Side) -> Option<Self> {
        let point = |part: &str| *points.get(convention.index_of(&format!("{}_{part}", side.name()))?)?;
        let wrist = point("wrist")?;
        let along = point("elbow").and_then(|elbow| (wrist - elbow).try_normalize(1e-6));
        Some(Self { wrist, knuckles: wrist + along.unwrap_or_else(Vector3::zeros) * PALM })
    }

    /// Sum of squared distances in standard deviations, each bounded.
    pub(super) fn misfit(&self, seen: &SeenHand, camera_from_world: &Rigid, intrinsics: &Intrinsics) -> f64 {
        let of = |place: &Vector3<f64>, seen: Option<Vector2<f64>>, sigma: f64| {
            let Some(seen) = seen else { return 0.0 };
            let in_camera = camera_from_world.transform(place);
            let Some(expected) = intrinsics.pixel_from_camera(&in_camera) else { return MAX_MISFIT };
            let metres = (expected - seen).norm() * in_camera.z / intrinsics.focal();
            (metres / sigma).powi(2).min(MAX_MISFIT)
        };
        of(&self.wrist, seen.wrist, WRIST_SIGMA) + of(&self.knuckles, seen.knuckles, KNUCKLES_SIGMA)
    }
}
