//! Images that were turned by 90 degrees after the calibration: people lie on their sides.

use crate::body::detector_profile::DETECTOR;
use crate::body::skeleton::KeypointConvention;
use crate::geometry::Intrinsics;
use crate::session::recording::{Detection, View};
use nalgebra::{Matrix3, Vector2};

/// Fewest trunks that say so.
const MIN_TRUNKS: usize = 20;
/// Share of the trunks whose shoulders point to the same side: people bend and lie down for a while.
const MOST: f64 = 0.75;

/// How the images were turned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Turn {
    /// Heads point to the right.
    Clockwise,
    /// Heads point to the left.
    Counterclockwise,
}

impl Turn {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Clockwise => "clockwise",
            Self::Counterclockwise => "counterclockwise",
        }
    }

    /// `turned_from_calibrated`: how the camera seems to have been turned about its axis.
    pub(super) fn rotation(self) -> Matrix3<f64> {
        let clockwise = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
        match self {
            Self::Clockwise => clockwise,
            Self::Counterclockwise => clockwise.transpose(),
        }
    }

    /// The lens of the turned images; `None` with a skewed K.
    pub(super) fn of_lens(self, lens: &Intrinsics) -> Option<Intrinsics> {
        match self {
            Self::Clockwise => lens.turned_clockwise(),
            Self::Counterclockwise => lens.turned_counterclockwise(),
        }
    }
}

/// How the images of a view were turned, if people stand in those that were calibrated; `None` where they do not lie on their sides.
pub(super) fn quarter_turn(convention: KeypointConvention, view: &View) -> Option<Turn> {
    let (hips, shoulders) = (convention.sides_of("hip")?, convention.sides_of("shoulder")?);
    let trunk = |detection: &Detection| Some(middle(detection, shoulders)? - middle(detection, hips)?);
    let trunks: Vec<Vector2<f64>> = view.frames.iter().flatten().filter_map(trunk).collect();
    let is_of_most = |is_counted: fn(&&Vector2<f64>) -> bool| {
        trunks.len() >= MIN_TRUNKS && trunks.iter().filter(is_counted).count() as f64 > MOST * trunks.len() as f64
    };
    if is_of_most(|trunk| trunk.x > trunk.y.abs()) {
        return Some(Turn::Clockwise);
    }
    is_of_most(|trunk| -trunk.x > trunk.y.abs()).then_some(Turn::Counterclockwise)
}

fn middle(detection: &Detection, sides: [usize; 2]) -> Option<Vector2<f64>> {
    let certain = |k: usize| detection.keypoints.get(k).filter(|k| k.confidence >= DETECTOR.judged).map(|k| k.pixel);
    Some(0.5 * (certain(sides[0])? + certain(sides[1])?))
}
