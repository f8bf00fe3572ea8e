//! The noise of the presets: errors that are independent from keypoint to keypoint and, but for a short drift, from frame
//! to frame; a confidence that falls with the error.

use super::config::{NoiseConfig, SimulationConfig};
use super::keypoint_errors::{Confidences, Disturbed, KeypointErrors, MISSING, gross_error, is_dropped, keypoint};
use super::processes::{Drift, white};
use super::projection::Projected;
use crate::session::Keypoint;
use nalgebra::Vector2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Correlation of the detector's drift after 1/30 s.
const DRIFT_MEMORY_30HZ: f64 = 0.9;
/// Shares of drift and of white jitter in a joint's error; their squares sum to one.
const DRIFT_SHARE: f64 = 0.6;
const WHITE_SHARE: f64 = 0.8;
/// Chosen; points below 0.05 are not reported.
const CONFIDENCES: Confidences = Confidences { sd: 0.08, lowest: 0.02, highest: 1.0 };

pub(super) struct PresetErrors {
    noise: NoiseConfig,
    process: Drift,
    drift: Vec<Vector2<f64>>,
}

impl PresetErrors {
    pub(super) fn new(config: &SimulationConfig, rng: &mut ChaCha8Rng) -> Self {
        Self {
            noise: config.noise,
            process: Drift::with_memory(DRIFT_MEMORY_30HZ.powf(30.0 / config.fps)),
            drift: config.point_names().iter().map(|_| white(rng)).collect(),
        }
    }
}

impl KeypointErrors for PresetErrors {
    fn advance(&mut self, _: &[Projected], rng: &mut ChaCha8Rng) {
        self.process.advance(&mut self.drift, rng);
    }

    fn disturbed(&mut self, points: &[Projected], size: f64, rng: &mut ChaCha8Rng) -> Vec<Disturbed> {
        let noise = &self.noise;
        let disturb = |(point, drift): (&Projected, &Vector2<f64>)| {
            let sigma = noise.jitter_of_size * size * point.jitter();
            let jitter = (drift * DRIFT_SHARE + white(rng) * WHITE_SHARE) * sigma;
            let is_outlier = rng.random::<f64>() < point.outlier_rate(noise);
            let error = if is_outlier { jitter + gross_error(noise, size, rng) } else { jitter };
            Disturbed { pixel: point.pixel + error, is_outlier, sigma_px: sigma }
        };
        points.iter().zip(&self.drift).map(disturb).collect()
    }

    /// The confidence falls with the error.
    fn reported(
        &mut self,
        points: &[Projected],
        disturbed: &[Disturbed],
        size: f64,
        rng: &mut ChaCha8Rng,
    ) -> Vec<Keypoint> {
        let report = |(point, found): (&Projected, &Disturbed)| {
            let error_of_size = (found.pixel - point.pixel).norm() / size;
            let best = 0.95 * (-error_of_size / 0.10).exp();
            let confidence = CONFIDENCES.draw(best, point.lost_confidence(), rng);
            let is_lost = is_dropped(point, &self.noise, rng) || confidence < 0.05;
            if is_lost { MISSING } else { keypoint(&found.pixel, confidence) }
        };
        points.iter().zip(disturbed).map(report).collect()
    }
}
