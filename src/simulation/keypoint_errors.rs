//! The errors of a detector's keypoints on one person: the interface of the two kinds of noise, and their common parts.

use super::config::NoiseConfig;
use super::projection::Projected;
use super::random::normal;
use crate::body::skeleton::KeypointConvention;
use crate::session::Keypoint;
use nalgebra::Vector2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StudentT;

/// Errors of one person's keypoints over time.
pub(super) trait KeypointErrors {
    /// Advances by one frame, also where the person is not detected.
    fn advance(&mut self, points: &[Projected], rng: &mut ChaCha8Rng);

    /// Points with errors; `size`: apparent size of the person, px.
    fn disturbed(&mut self, points: &[Projected], size: f64, rng: &mut ChaCha8Rng) -> Vec<Disturbed>;

    /// The keypoints that the detector reports; `disturbed` are the points after flips.
    fn reported(
        &mut self,
        points: &[Projected],
        disturbed: &[Disturbed],
        size: f64,
        rng: &mut ChaCha8Rng,
    ) -> Vec<Keypoint>;
}

/// A point with its error.
#[derive(Debug, Clone, Copy)]
pub(super) struct Disturbed {
    pub(super) pixel: Vector2<f64>,
    pub(super) is_outlier: bool,
    /// Standard deviation of the error per axis, but for outliers, px.
    pub(super) sigma_px: f64,
}

/// A keypoint that is not reported.
pub(super) const MISSING: Keypoint = Keypoint::MISSING;

/// Hidden points have errors of this relative size. Chosen.
const HIDDEN_JITTER: f64 = 2.5;
/// Hidden points are outliers this many times as often. Chosen.
const HIDDEN_OUTLIERS: f64 = 4.0;
/// The confidence of hidden points is lower by this. Chosen.
const HIDDEN_CONFIDENCE: f64 = 0.20;

impl Projected {
    /// Relative size of the error.
    pub(super) fn jitter(&self) -> f64 {
        if self.hidden { HIDDEN_JITTER } else { 1.0 }
    }

    /// Share of the time that the point is an outlier.
    pub(super) fn outlier_rate(&self, noise: &NoiseConfig) -> f64 {
        noise.outlier_rate * if self.hidden { HIDDEN_OUTLIERS } else { 1.0 }
    }

    /// Loss of confidence.
    pub(super) fn lost_confidence(&self) -> f64 {
        if self.hidden { HIDDEN_CONFIDENCE } else { 0.0 }
    }
}

/// The error of an outlier, px: heavy tails, at most the person's size.
pub(super) fn gross_error(noise: &NoiseConfig, size: f64, rng: &mut ChaCha8Rng) -> Vector2<f64> {
    let heavy = StudentT::new(1.8).expect("1.8 degrees of freedom are positive");
    let mut gross = || (rng.sample(heavy) * noise.outlier_of_size * size * 0.35).clamp(-size, size);
    Vector2::new(gross(), gross())
}

/// Whether a point is lost in this frame alone, at random or because it is hidden.
pub(super) fn is_dropped(point: &Projected, noise: &NoiseConfig, rng: &mut ChaCha8Rng) -> bool {
    let dropped = rng.random::<f64>() < noise.missed_joint_rate;
    let dropped_hidden = rng.random::<f64>() < noise.occluded_joint_missing_rate && point.hidden;
    dropped || dropped_hidden || !point.in_view
}

/// Inserts the points of a convention that have no names, behind those that have.
pub(super) fn with_unnamed(keypoints: &mut Vec<Keypoint>, convention: KeypointConvention) {
    let n_named = convention.names().len();
    keypoints.splice(n_named..n_named, std::iter::repeat_n(MISSING, convention.n_keypoints() - n_named));
}

/// Distribution of a confidence.
pub(super) struct Confidences {
    /// Standard deviation of its white noise.
    pub(super) sd: f64,
    pub(super) lowest: f64,
    pub(super) highest: f64,
}

impl Confidences {
    /// A confidence of mean `best - lost`, to a thousandth.
    pub(super) fn draw(&self, best: f64, lost: f64, rng: &mut ChaCha8Rng) -> f64 {
        ((best + normal(rng, self.sd) - lost).clamp(self.lowest, self.highest) * 1e3).round() / 1e3
    }
}

/// The keypoint of a point: pixels to a hundredth.
pub(super) fn keypoint(pixel: &Vector2<f64>, confidence: f64) -> Keypoint {
    Keypoint::new(pixel.map(|v| (v * 1e2).round() / 1e2), confidence)
}
