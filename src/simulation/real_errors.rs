//! Errors of a real detector's keypoints; [`super::real_noise`] names the source of the constants.
//!
//! Error of keypoint $k$ of a person of apparent size $S$ px:
//! $e_k = \sigma S\, h\, l_k\, e^{a d_k} (w\, n_k + f\, u_k + s\, (\sqrt{1 - c^2}\, v_k + c\, v_r))$, with white noise $n$, a
//! fast drift $u$, a slow drift $v$ of each keypoint and one of its region $r$, the difficulty $d$, and $h$ = 2.5 where the
//! point is hidden. An outlier adds an offset that stays. The confidence follows the difficulty, not the error.

use super::config::{NoiseConfig, SimulationConfig};
use super::keypoint_errors::{Confidences, Disturbed, KeypointErrors, MISSING, gross_error, is_dropped, keypoint};
use super::processes::{Drift, Episode, Odds, white};
use super::projection::Projected;
use super::random::normal;
use super::real_noise::RealNoise;
use crate::session::Keypoint;
use nalgebra::Vector2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// $\sigma$ relative to `jitter_of_size`, without unit: 1 % of the size for `Preset::Paper`. Fitted.
const LEVEL: f64 = 0.83;
/// $l_k$ by part of the name, without unit; the first that fits. Measured for the joints of BODY_25, taken over for their
/// neighbours.
const LEVELS: [(&str, f64); 22] = [
    ("nose", 0.6),
    ("eye", 0.65),
    ("mouth", 0.65),
    ("ear", 0.7),
    ("head", 0.7),
    ("neck", 0.9),
    ("mid_hip", 1.6),
    ("pelvis", 1.6),
    ("hip", 1.75),
    ("shoulder", 1.0),
    ("collar", 1.0),
    ("spine", 1.0),
    ("elbow", 0.85),
    ("wrist", 0.95),
    ("hand", 0.95),
    ("pinky", 0.95),
    ("index", 0.95),
    ("thumb", 0.95),
    ("knee", 1.2),
    ("ankle", 0.9),
    ("toe", 1.05),
    ("heel", 1.0),
];
/// Level of all other keypoints.
const OTHER_LEVEL: f64 = 1.0;

/// $w$, $f$, $s$: standard deviations of white noise, fast and slow drift; their squares sum to one. Fitted to the measured
/// autocorrelation together with the two times below.
const WHITE: f64 = 0.15;
const FAST: f64 = 0.475;
const SLOW: f64 = 0.867;
/// Time after which the fast drift is correlated by 1/e, s. Fitted.
const FAST_SECS: f64 = 0.07;
/// The same of the slow drift, s. Fitted.
const SLOW_SECS: f64 = 2.2;
/// $c$: part of the slow drift that the keypoints of a region share. Fitted.
const SHARED: f64 = 0.45;

/// $a$: logarithm of the factor by which the error grows with one standard deviation of difficulty. Fitted to the rank
/// correlation of confidence and error.
const DIFFICULTY_SPREAD: f64 = 0.35;
/// Time after which the difficulty is correlated by 1/e, s. Fitted to the autocorrelation of confidences.
const DIFFICULTY_SECS: f64 = 0.7;

/// Mean duration of an outlier, s. Fitted.
const OUTLIER_SECS: f64 = 1.0 / 3.0;
/// Mean duration of a hole, s. Fitted to the persistence of missing joints.
const HOLE_SECS: f64 = 0.9;
/// Holes that begin in a second, of a point that is seen and of one that is hidden; the first is relative to
/// `missed_joint_rate`. Fitted.
const HOLES_PER_SEC: f64 = 2.0;
const HIDDEN_HOLES_PER_SEC: f64 = 0.25;

/// Mean confidence of a point of mean difficulty. Fitted: the mean of all points is 0.77, measured 0.75.
const CONFIDENCE: f64 = 0.78;
/// Loss of confidence with one standard deviation of difficulty. Fitted: the standard deviation is 0.14, as measured.
const CONFIDENCE_OF_DIFFICULTY: f64 = 0.15;
/// Loss of confidence of an outlier. Fitted.
const CONFIDENCE_OF_OUTLIER: f64 = 0.08;
/// White noise (fitted: a tenth of the variance, as the autocorrelation after 0.04 s shows) and range of the confidences.
const CONFIDENCES: Confidences = Confidences { sd: 0.05, lowest: 0.05, highest: 0.97 };

/// Parts of a name that belong to the lower half of a leg, which half detections lack.
const LOWER_LEG: [&str; 5] = ["knee", "ankle", "foot", "toe", "heel"];
const FACE: [&str; 5] = ["nose", "eye", "ear", "mouth", "head"];

pub(super) struct RealErrors {
    noise: NoiseConfig,
    real: RealNoise,
    fps: f64,
    fast_drift: Drift,
    slow_drift: Drift,
    difficulty_drift: Drift,
    /// Slow drift of face, legs, trunk and arms.
    regions: [Vector2<f64>; 3],
    keypoints: Vec<KeypointState>,
    /// Errors of all keypoints, relative to their standard deviation.
    fast: Vec<Vector2<f64>>,
    slow: Vec<Vector2<f64>>,
    difficulty: Vec<f64>,
}

/// What one keypoint keeps from frame to frame besides its drifts.
struct KeypointState {
    level: f64,
    region: usize,
    is_lower_leg: bool,
    outlier: Episode,
    /// Offset of the outlier, of the person's size.
    offset: Vector2<f64>,
    hole: Episode,
}

impl RealErrors {
    pub(super) fn new(real: RealNoise, config: &SimulationConfig, rng: &mut ChaCha8Rng) -> Self {
        let names = config.point_names();
        Self {
            noise: config.noise,
            real,
            fps: config.fps,
            fast_drift: Drift::with_time(FAST_SECS, config.fps),
            slow_drift: Drift::with_time(SLOW_SECS, config.fps),
            difficulty_drift: Drift::with_time(DIFFICULTY_SECS, config.fps),
            regions: std::array::from_fn(|_| white(rng)),
            keypoints: names.iter().map(|name| KeypointState::new(name)).collect(),
            fast: names.iter().map(|_| white(rng)).collect(),
            slow: names.iter().map(|_| white(rng)).collect(),
            difficulty: names.iter().map(|_| normal(rng, 1.0)).collect(),
        }
    }
}

impl KeypointState {
    fn new(name: &str) -> Self {
        let is_any = |parts: &[&str]| parts.iter().any(|part| name.contains(part));
        let is_lower_leg = is_any(&LOWER_LEG);
        let region = match (is_any(&FACE), is_lower_leg) {
            (true, _) => 0,
            (_, true) => 1,
            _ => 2,
        };
        Self {
            level: LEVELS.iter().find(|(part, _)| name.contains(part)).map_or(OTHER_LEVEL, |(_, level)| *level),
            region,
            is_lower_leg,
            outlier: Episode::default(),
            offset: Vector2::zeros(),
            hole: Episode::default(),
        }
    }

    fn advance(&mut self, point: &Projected, noise: &NoiseConfig, fps: f64, rng: &mut ChaCha8Rng) {
        if self.outlier.advance(Odds::of_share(point.outlier_rate(noise), OUTLIER_SECS, fps), rng) {
            self.offset = gross_error(noise, 1.0, rng);
        }
        let hidden = if point.hidden { HIDDEN_HOLES_PER_SEC } else { 0.0 };
        let holes_per_sec = noise.missed_joint_rate * HOLES_PER_SEC + hidden;
        self.hole.advance(Odds::of_rate(holes_per_sec, HOLE_SECS, fps), rng);
    }
}

impl KeypointErrors for RealErrors {
    fn advance(&mut self, points: &[Projected], rng: &mut ChaCha8Rng) {
        self.fast_drift.advance(&mut self.fast, rng);
        self.slow_drift.advance(&mut self.slow, rng);
        self.slow_drift.advance(&mut self.regions, rng);
        self.difficulty_drift.advance_numbers(&mut self.difficulty, rng);
        for (keypoint, point) in self.keypoints.iter_mut().zip(points) {
            keypoint.advance(point, &self.noise, self.fps, rng);
        }
    }

    fn disturbed(&mut self, points: &[Projected], size: f64, rng: &mut ChaCha8Rng) -> Vec<Disturbed> {
        let own = (1.0 - SHARED.powi(2)).sqrt();
        let disturb = |(k, point): (usize, &Projected)| {
            let keypoint = &self.keypoints[k];
            let slow = self.slow[k] * own + self.regions[keypoint.region] * SHARED;
            let relative = white(rng) * WHITE + self.fast[k] * FAST + slow * SLOW;
            let difficulty = (DIFFICULTY_SPREAD * self.difficulty[k]).exp();
            let sigma = self.noise.jitter_of_size * LEVEL * size * point.jitter() * keypoint.level * difficulty;
            let is_outlier = keypoint.outlier.is_on();
            let offset = if is_outlier { keypoint.offset * size } else { Vector2::zeros() };
            Disturbed { pixel: point.pixel + relative * sigma + offset, is_outlier, sigma_px: sigma }
        };
        points.iter().enumerate().map(disturb).collect()
    }

    fn reported(
        &mut self,
        points: &[Projected],
        disturbed: &[Disturbed],
        _: f64,
        rng: &mut ChaCha8Rng,
    ) -> Vec<Keypoint> {
        let is_half = rng.random::<f64>() < self.real.half_detection_rate;
        let report = |(k, point): (usize, &Projected)| {
            let (keypoint_state, found) = (&self.keypoints[k], &disturbed[k]);
            let outlier = if found.is_outlier { CONFIDENCE_OF_OUTLIER } else { 0.0 };
            let lost = CONFIDENCE_OF_DIFFICULTY * self.difficulty[k] + point.lost_confidence() + outlier;
            let confidence = CONFIDENCES.draw(CONFIDENCE, lost, rng);
            let is_dropped = is_dropped(point, &self.noise, rng);
            let lacks = is_half && keypoint_state.is_lower_leg;
            let is_lost = is_dropped || lacks || keypoint_state.hole.is_on() || point.turned_away;
            if is_lost { MISSING } else { keypoint(&found.pixel, confidence) }
        };
        points.iter().enumerate().map(report).collect()
    }
}
