//! Ghosts: detections without a person, such as a coat on a rack or a reflection.

use super::config::SimulationConfig;
use super::keypoint_errors::{MISSING, keypoint, with_unnamed};
use super::processes::{Episode, Odds, white};
use super::projection::{pixel_of, size_of};
use super::random::{Purpose, normal, stream};
use super::real_noise::RealNoise;
use super::rig::RigCamera;
use super::scene::SimulatedScene;
use crate::geometry::rotation;
use crate::session::Keypoint;
use nalgebra::{Vector2, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Mean duration of a ghost, s. Fitted.
const DURATION_SECS: f64 = 0.5;
/// Distance from the centre of the scene, m. Chosen: around the people, not among them.
const DISTANCE: std::ops::Range<f64> = 2.5..6.0;
/// Standard deviation of a ghost's white noise, of its size. Chosen.
const JITTER_OF_SIZE: f64 = 0.03;
/// Share of a ghost's points in the image that are not reported. Chosen.
const MISSED_POINT_RATE: f64 = 0.35;
/// Mean and standard deviation of a ghost's confidences. Chosen: lower than a person's.
const CONFIDENCE: (f64, f64) = (0.45, 0.15);
/// Lowest and highest confidence of a ghost. Chosen.
const CONFIDENCES: [f64; 2] = [0.06, 0.9];
/// A ghost with fewer points in the image, or with fewer points reported, is not detected.
const MIN_IN_VIEW: usize = 6;
const MIN_REPORTED: usize = 4;

/// The ghosts of a view, at most one at a time.
pub(super) struct Ghosts {
    rng: ChaCha8Rng,
    odds: Odds,
    episode: Episode,
    /// Number of ghosts so far.
    n: usize,
    /// The ghost's keypoints in the world, m.
    points: Vec<Vector3<f64>>,
}

/// A ghost in one frame.
pub(super) struct Ghost {
    /// Number of the ghost in its view, from 0.
    pub(super) index: usize,
    pub(super) keypoints: Vec<Keypoint>,
}

impl Ghosts {
    pub(super) fn new(real: RealNoise, view: usize, config: &SimulationConfig) -> Self {
        Self {
            rng: stream(config.seed, Purpose::Ghosts, view, 0),
            odds: Odds::of_share(real.ghosts, DURATION_SECS, config.fps),
            episode: Episode::default(),
            n: 0,
            points: Vec::new(),
        }
    }

    /// The ghost of this frame, if it is detected.
    pub(super) fn observe(&mut self, scene: &SimulatedScene, camera: &RigCamera) -> Option<Ghost> {
        if self.episode.advance(self.odds, &mut self.rng) {
            self.points = ghost_points(scene, &mut self.rng);
            self.n += 1;
        }
        if !self.episode.is_on() {
            return None;
        }
        let pixels: Vec<(Vector2<f64>, bool)> = self.points.iter().map(|point| pixel_of(camera, point)).collect();
        let in_view = || pixels.iter().filter(|(_, in_view)| *in_view).map(|(pixel, _)| *pixel);
        if in_view().count() < MIN_IN_VIEW {
            return None;
        }
        let sigma = JITTER_OF_SIZE * size_of(in_view());
        let mut keypoints: Vec<Keypoint> =
            pixels.iter().map(|(pixel, in_view)| reported(pixel, *in_view, sigma, &mut self.rng)).collect();
        if keypoints.iter().filter(|keypoint| keypoint.is_present()).count() < MIN_REPORTED {
            return None;
        }
        with_unnamed(&mut keypoints, scene.convention);
        Some(Ghost { index: self.n - 1, keypoints })
    }
}

/// The keypoints of a random person and frame, turned about the vertical and moved away from the people.
fn ghost_points(scene: &SimulatedScene, rng: &mut ChaCha8Rng) -> Vec<Vector3<f64>> {
    let people = &scene.keypoints[rng.random_range(0..scene.keypoints.len())];
    let points = &people[rng.random_range(0..people.len())];
    let mut middle = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    middle.y = 0.0;
    let turn = rotation::exp(&(Vector3::y() * rng.random_range(0.0..std::f64::consts::TAU)));
    let (azimuth, distance) = (rng.random_range(0.0..std::f64::consts::TAU), rng.random_range(DISTANCE));
    let place = Vector3::new(azimuth.sin(), 0.0, azimuth.cos()) * distance;
    points.iter().map(|point| turn * (point - middle) + place).collect()
}

fn reported(pixel: &Vector2<f64>, in_view: bool, sigma: f64, rng: &mut ChaCha8Rng) -> Keypoint {
    let disturbed = pixel + white(rng) * sigma;
    let confidence = (CONFIDENCE.0 + normal(rng, CONFIDENCE.1)).clamp(CONFIDENCES[0], CONFIDENCES[1]);
    let is_missed = rng.random::<f64>() < MISSED_POINT_RATE;
    if is_missed || !in_view { MISSING } else { keypoint(&disturbed, (confidence * 1e3).round() / 1e3) }
}
