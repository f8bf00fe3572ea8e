//! Noise as measured on a real detector, on top of the rates of [`NoiseConfig`](super::NoiseConfig).
//!
//! Its source is a comparison of OpenPose's BODY_25 detections of the Shelf recording (Belagiannis et al., CVPR 2014: five
//! cameras, 25 frames a second, 301 frames, up to four people, true joints triangulated by hand) with the projected true
//! joints. "Measured" below is what this comparison shows, "fitted" a number with which the simulation shows the same,
//! "chosen" a plausible number without a measurement. Autocorrelations are those of errors below 0.15 of the person's size,
//! less the mean of each joint, which is an offset between the detector's joint and the true one.
//!
//! | process | value | source |
//! |---|---|---|
//! | autocorrelation of errors after 0.04, 0.2, 0.4, 1, 2 s | 0.84, 0.63, 0.53, 0.38, 0.23 | measured; tested |
//! | share of their variance that is constant over 12 s, per person, view and keypoint | 0.23 | measured; tested |
//! | level of errors by keypoint, hips three times the nose | table in `real_errors` | measured; tested |
//! | drift shared within face, legs, trunk and arms | 0.45 of the slow drift | fitted |
//! | outliers that last | 1/3 s | fitted; tested |
//! | holes that last: a missing joint is missing after 0.2, 0.4, 1, 2 s with probability | 0.65, 0.56, 0.43, 0.33 | measured; holes of 0.9 s fitted, tested |
//! | rank correlation of confidence and error | -0.41 | measured; tested |
//! | mean, standard deviation of confidences | 0.75, 0.14 | measured; tested |
//! | autocorrelation of confidences after 0.04, 0.2, 0.4, 1 s | 0.84, 0.58, 0.44, 0.19 | measured |
//! | ghosts, half detections, merged limbs | [`RealNoise::MEASURED`] | fitted |
//!
//! The rates of outliers, missing joints and detections, swaps and flips and the level `jitter_of_size` are those of the
//! preset.

use serde::Serialize;

/// What a real detector does to whole detections.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RealNoise {
    /// Mean number of ghosts around a camera, 0 to 0.9: detections without a person, each for half a second at one place
    /// 2.5 to 6 m from the centre of the scene. Some half of them lie in the image.
    pub ghosts: f64,
    /// Share of detections without knees and feet.
    pub half_detection_rate: f64,
    /// Probability per frame that one of two detections that overlap reports an arm or a leg of the other.
    pub merged_limb_rate: f64,
}

impl RealNoise {
    /// As fitted to the source of this module: 0.12 ghosts, 5 % half detections, 15 % merged limbs.
    pub const MEASURED: Self = Self { ghosts: 0.12, half_detection_rate: 0.05, merged_limb_rate: 0.15 };

    /// Name, value, lowest and highest value of each field, and its range in words.
    pub(super) fn ranges(&self) -> [(&'static str, f64, f64, f64, &'static str); 3] {
        [
            ("ghosts", self.ghosts, 0.0, 0.9, "0 to 0.9"),
            ("half_detection_rate", self.half_detection_rate, 0.0, 1.0, "0 to 1"),
            ("merged_limb_rate", self.merged_limb_rate, 0.0, 1.0, "0 to 1"),
        ]
    }
}
