//! How far detectors' keypoints lie from where a body carries them, in metres on the body.

use super::skeleton::KeypointConvention;

/// White noise of a good detector, m: 1 % of a standing person's apparent size (OpenPose and COCO detectors reach 0.6 to
/// 1.5 %).
const JITTER_M: f64 = 0.015;

/// Systematic disagreement between views by body part, m. Markerless joint centres lie 30 to 50 mm off at hips and knees
/// and up to 15 mm at ankles (Needham et al., Scientific Reports 11, 2021); shoulders are labelled on the surface; points of face
/// and feet are seen directly.
const BIAS_M: [(&str, f64); 8] = [
    ("mid_hip", 0.040),
    ("hip", 0.040),
    ("neck", 0.025),
    ("shoulder", 0.020),
    ("knee", 0.020),
    ("elbow", 0.010),
    ("wrist", 0.010),
    ("ankle", 0.010),
];

/// Everything else: eyes, nose, ears, toes, heels.
const SURFACE_BIAS_M: f64 = 0.008;

/// Standard deviation of each named keypoint, m on the body.
pub fn keypoint_sigmas(convention: KeypointConvention) -> Vec<f64> {
    let sigma = |name: &&str| {
        let bias = BIAS_M.iter().find(|(part, _)| name.ends_with(part)).map_or(SURFACE_BIAS_M, |(_, bias)| *bias);
        (JITTER_M * JITTER_M + bias * bias).sqrt()
    };
    convention.names().iter().map(sigma).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hips_count_least_and_the_face_most() {
        let sigmas = keypoint_sigmas(KeypointConvention::Body25);
        let of = |name| sigmas[KeypointConvention::Body25.index_of(name).unwrap()];
        assert!(of("left_hip") > of("left_shoulder") && of("left_shoulder") > of("nose"));
        assert_eq!(of("mid_hip"), of("right_hip"));
    }
}
