//! Noise of hands and faces, and whose hand a detection shows.

use crate::body::hand::Side;
use serde::Serialize;

/// Noise of the points of hands and face. A share "of size" is relative to the image of the whole hand or face.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct HandNoise {
    /// Standard deviation of a point's error, of size. COCO-WholeBody states the deviations of its annotators as 1.7 to 4.7 %
    /// of the hand's box, and 0.7 to 4.2 % of the face's (Jin et al., ECCV 2020, and its evaluation code): detectors are
    /// hardly better.
    pub jitter_of_size: f64,
    /// Share of points that are outliers.
    pub outlier_rate: f64,
    /// Share of points missing at random.
    pub missed_point_rate: f64,
    /// Share of hands and faces missing at random; x 20 where the middle knuckle is hidden.
    pub missed_rate: f64,
    /// Share of the frames of a view in which two hands are exchanged: of one person, or of two.
    pub swap_rate: f64,
}

impl Default for HandNoise {
    fn default() -> Self {
        Self { jitter_of_size: 0.04, outlier_rate: 0.02, missed_point_rate: 0.02, missed_rate: 0.04, swap_rate: 0.0 }
    }
}

impl HandNoise {
    /// Field, value, smallest and largest value, range in words.
    pub(in crate::simulation) fn ranges(&self) -> [(&'static str, f64, f64, f64, &'static str); 5] {
        [
            ("hands.jitter_of_size", self.jitter_of_size, 0.0, 1.0, "0 to 1"),
            ("hands.outlier_rate", self.outlier_rate, 0.0, 1.0, "0 to 1"),
            ("hands.missed_point_rate", self.missed_point_rate, 0.0, 1.0, "0 to 1"),
            ("hands.missed_rate", self.missed_rate, 0.0, 1.0, "0 to 1"),
            ("hands.swap_rate", self.swap_rate, 0.0, 1.0, "0 to 1"),
        ]
    }
}

/// Whose hand a detection's hand is: person and side.
pub type HandSource = (usize, Side);

/// Sources of the left and the right hand of a detection; `None` for ghosts.
pub(in crate::simulation) type SeenHands = [Option<HandSource>; 2];
