//! Confidence thresholds of keypoint detectors, and the angle within which a keypoint counts as explained.

use crate::geometry::Intrinsics;

/// How far each step relies on a keypoint detector's confidence (0 to 1), and how exact its keypoints are.
///
/// The thresholds rise with the harm that a wrong keypoint does: a missing keypoint costs little while persons are compared
/// by medians, and a wrong one is expensive where cameras are computed from single points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectorProfile {
    /// Keypoints below this are missing: here OpenPose and COCO detectors guess.
    pub min_confidence: f64,
    /// Keypoints from here on are compared between detections, and with a predicted person. Medians over a whole
    /// body bear the occasional wrong one. Less confident keypoints are as noisy as those at this threshold.
    pub comparable: f64,
    /// Keypoints from here on enter least-squares problems of cameras, and the accuracy reported of a result.
    pub judged: f64,
    /// Keypoints from here on are correct as a rule: minimal samples are drawn from them, and a result has to explain them.
    pub confident: f64,
    /// A keypoint within this angle of its reprojection is explained, rad: 24 px at a focal length of 1,060 px, six times
    /// a detector's own noise on persons 4 m away; it grows with [`error_scale`]. Beyond it the detection is wrong: counted as
    /// rejected, not averaged.
    pub explained_radius: f64,
}

/// Good for OpenPose, AlphaPose and detectors trained on COCO, whose confidences are heat map peaks.
pub const DETECTOR: DetectorProfile =
    DetectorProfile { min_confidence: 0.1, comparable: 0.2, judged: 0.3, confident: 0.4, explained_radius: 0.0225 };

/// Distance for which angular tolerances are stated, m.
const REFERENCE_DISTANCE_M: f64 = 4.0;

/// Focal length over the larger side of the image from which lenses are long: an image of 45 degrees.
const LONG_LENS: f64 = 1.2;

/// How many times larger a detector's errors are on people at a distance (m) than 4 m away, as angles: they are a share of the
/// apparent size. At least that of the lens ([`least_error_scale`]).
pub fn error_scale(distance: f64, least: f64) -> f64 {
    (REFERENCE_DISTANCE_M / distance).max(least)
}

/// What pixels and blur leave of a detector's errors on people far away, in units of those 4 m away: 1, and of long lenses, whose
/// images show a smaller angle, as much less. With 1 for all, an image of 18 degrees had tolerances of a sixth of people's
/// height, and of 24 recordings 18 m away 2 lost their cameras.
pub fn least_error_scale(intrinsics: &Intrinsics) -> f64 {
    (LONG_LENS * f64::from(intrinsics.width.max(intrinsics.height)) / intrinsics.focal()).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Distortion;

    #[test]
    fn errors_far_away_fall_with_the_angle_of_the_image() {
        let lens = |degrees: f64| {
            let focal = 960.0 / (degrees.to_radians() / 2.0).tan();
            Intrinsics::guessed([1920, 1080], Distortion::OpenCv5([0.0; 5])).with_focal_factor(focal / 1920.0)
        };
        let [wide, long] = [65.0, 18.0].map(|degrees| error_scale(18.0, least_error_scale(&lens(degrees))));
        assert!(wide == 1.0 && (long - 0.38).abs() < 0.01, "{wide}, {long}");
        assert_eq!(error_scale(2.0, least_error_scale(&lens(18.0))), 2.0);
    }
}
