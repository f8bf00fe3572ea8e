//! Noise of detectors' keypoints: distances from the body's landmarks, in metres on the body.

use super::skeleton::KeypointConvention;
use serde::{Deserialize, Serialize};

/// White noise of a good detector, m: 1 % of a standing person's apparent size (OpenPose and COCO detectors reach 0.6 to
/// 1.5 %).
const JITTER_M: f64 = 0.015;

/// Systematic differences between views by body part, m. Markerless joint centres lie 30 to 50 mm off at hips and knees
/// and up to 15 mm at ankles (Needham et al., Scientific Reports 11, 2021); shoulders are labelled on the skin; points of face and
/// feet are seen directly.
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

/// The same for all other points: eyes, nose, ears, toes, heels.
const SURFACE_BIAS_M: f64 = 0.008;

/// Noise of a session's detector by keypoint and confidence.
///
/// Standard deviation per axis on the body: $\sigma(k, c) = \sigma_k f(c)$.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DetectorNoise {
    /// $\sigma_k$, m.
    sigmas_m: Vec<f64>,
    /// Knots of $f$: confidence and $\ln f$, linear between knots and constant beyond them; without knots $f = 1/c$.
    knots: Vec<[f64; 2]>,
}

impl DetectorNoise {
    /// Published noise, before this detector's noise is measured.
    pub fn published(convention: KeypointConvention) -> Self {
        Self { sigmas_m: keypoint_sigmas(convention), knots: Vec::new() }
    }

    /// The same keypoints with a measured $f$; `knots`: confidences (rising) and $\ln f$.
    pub fn with_knots(self, knots: Vec<[f64; 2]>) -> Self {
        Self { knots, ..self }
    }

    /// The noise with standard deviations `factor` times as large.
    pub fn scaled(mut self, factor: f64) -> Self {
        self.sigmas_m.iter_mut().for_each(|sigma| *sigma *= factor);
        self
    }

    /// The measured confidences, ascending, and the standard deviation of the most precise keypoints at each, m.
    pub fn levels(&self) -> impl Iterator<Item = (f64, f64)> {
        let best = self.sigmas_m.iter().copied().fold(f64::INFINITY, f64::min);
        self.knots.iter().map(move |[confidence, ln]| (*confidence, best * ln.exp()))
    }

    /// $\sigma_k$ by keypoint, m.
    pub fn sigmas_m(&self) -> &[f64] {
        &self.sigmas_m
    }

    /// Standard deviation per axis on the body, m.
    pub fn sigma_m(&self, keypoint: usize, confidence: f64) -> f64 {
        self.sigmas_m[keypoint] * self.factor(confidence)
    }

    /// $f(c)$.
    pub fn factor(&self, confidence: f64) -> f64 {
        let above = self.knots.partition_point(|[c, _]| *c < confidence);
        match (above.checked_sub(1).map(|i| self.knots[i]), self.knots.get(above)) {
            (None, None) => confidence.recip(),
            (Some([_, ln]), None) => ln.exp(),
            (None, Some([_, ln])) => ln.exp(),
            (Some([from, low]), Some([to, high])) => (low + (high - low) * (confidence - from) / (to - from)).exp(),
        }
    }
}

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
    fn noise_follows_knots_or_the_inverse_of_confidence() {
        let published = DetectorNoise::published(KeypointConvention::Coco17);
        assert_eq!(published.sigma_m(0, 0.5), 2.0 * published.sigmas_m()[0]);
        assert_eq!(published.clone().scaled(3.0).sigma_m(0, 0.5), 3.0 * published.sigma_m(0, 0.5));
        assert_eq!(published.levels().count(), 0);
        let measured = published.with_knots(vec![[0.4, 1.0], [0.8, -1.0]]);
        for (confidence, ln) in [(0.1, 1.0), (0.4, 1.0), (0.5, 0.5), (0.8, -1.0), (1.0, -1.0)] {
            assert!((measured.factor(confidence).ln() - ln).abs() < 1e-12, "{confidence}");
        }
        assert_eq!(measured.levels().next(), Some((0.4, measured.sigmas_m()[0] * 1f64.exp())));
    }

    #[test]
    fn hips_are_noisiest_and_the_face_least() {
        let sigmas = keypoint_sigmas(KeypointConvention::Body25);
        let of = |name| sigmas[KeypointConvention::Body25.index_of(name).unwrap()];
        assert!(of("left_hip") > of("left_shoulder") && of("left_shoulder") > of("nose"));
        assert_eq!(of("mid_hip"), of("right_hip"));
    }
}
