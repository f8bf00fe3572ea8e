//! Detections of hands and face: errors relative to their own size, misses, and hands that are swapped.

use super::details::N_DETAILS;
use super::noise::{HandNoise, SeenHands};
use crate::body::hand::{HandShape, N_FACE_POINTS, N_HAND_POINTS, Side, face_keypoints};
use crate::body::skeleton::N_JOINTS;
use crate::session::{Detection, Keypoint};
use crate::simulation::config::{NoiseConfig, SimulationConfig};
use crate::simulation::keypoint_errors::{Confidences, MISSING, gross_error, keypoint};
use crate::simulation::occlusion::is_hidden;
use crate::simulation::processes::{Drift, white};
use crate::simulation::projection::{HeadDirections, pixel_of};
use crate::simulation::random::{Purpose, stream};
use crate::simulation::rig::RigCamera;
use crate::simulation::scene::SimulatedScene;
use nalgebra::{Vector2, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::ops::Range;

/// Correlation of the drift after 1/30 s, its share and that of white noise: as of the body's points.
const DRIFT_MEMORY_30HZ: f64 = 0.9;
const DRIFT_SHARE: f64 = 0.6;
const WHITE_SHARE: f64 = 0.8;
/// Height of a face, m.
const FACE_SIZE: f64 = 0.2;
/// Index of the middle finger's knuckle among the points of a hand.
const MIDDLE_KNUCKLE: usize = 9;
/// How much more often something hidden is missing.
const HIDDEN_MISSES: f64 = 20.0;
/// Chosen; points below 0.05 are not reported.
const CONFIDENCES: Confidences = Confidences { sd: 0.08, lowest: 0.05, highest: 1.0 };
/// Error of size at which the confidence falls to 1/e.
const CONFIDENCE_ERROR: f64 = 0.3;

/// The face, the left or the right hand.
struct Part {
    points: Range<usize>,
    /// The point whose sight is tested.
    middle: usize,
    /// m.
    size: f64,
}

fn parts() -> [Part; 3] {
    let hand = |first: usize| Part {
        points: first..first + N_HAND_POINTS,
        middle: first + MIDDLE_KNUCKLE,
        size: HandShape::average(Side::Left).length(),
    };
    let face = Part { points: 0..N_FACE_POINTS, middle: 30, size: FACE_SIZE };
    [face, hand(N_FACE_POINTS), hand(N_FACE_POINTS + N_HAND_POINTS)]
}

/// The detector of a view.
pub(in crate::simulation) struct DetailDetector {
    /// Keypoints of the face, after which those of the hands follow; empty in a convention without face.
    face: Range<usize>,
    noise: HandNoise,
    gross: NoiseConfig,
    process: Drift,
    /// By person: random numbers and drift.
    people: Vec<(ChaCha8Rng, Vec<Vector2<f64>>)>,
    swaps: ChaCha8Rng,
}

impl DetailDetector {
    /// `None` where the convention has no points of hands and face.
    pub(in crate::simulation) fn new(view: usize, config: &SimulationConfig) -> Option<Self> {
        let person = |person: usize| {
            let mut rng = stream(config.seed, Purpose::Details, view, person);
            let drift = (0..N_DETAILS).map(|_| white(&mut rng)).collect();
            (rng, drift)
        };
        Some(Self {
            face: face_keypoints(config.convention)?,
            noise: config.hands.unwrap_or_default(),
            gross: config.noise,
            process: Drift::with_memory(DRIFT_MEMORY_30HZ.powf(30.0 / config.fps)),
            people: (0..config.people).map(person).collect(),
            swaps: stream(config.seed, Purpose::HandSwaps, view, 0),
        })
    }

    /// Adds hands and face to the detection of a person, if there is one.
    pub(in crate::simulation) fn observe(
        &mut self,
        scene: &SimulatedScene,
        frame: usize,
        person: usize,
        camera: &RigCamera,
        detection: Option<&mut Vec<Keypoint>>,
    ) {
        let (rng, drift) = &mut self.people[person];
        self.process.advance(drift, rng);
        let points = &scene.details[frame][person];
        let center = camera.camera_from_world.center();
        let people: Vec<&[Vector3<f64>; N_JOINTS]> = scene.joints[frame].iter().collect();
        let mut seen = vec![MISSING; N_DETAILS];
        for (i, part) in parts().into_iter().enumerate() {
            let is_missed = rng.random::<f64>();
            let hidden = is_hidden(&center, &points[part.middle], person, &people);
            let is_away = i == 0
                && HeadDirections::new([points[30], points[16], points[0]], &center)
                    .is_some_and(HeadDirections::is_averted);
            let rate = self.noise.missed_rate * if hidden { HIDDEN_MISSES } else { 1.0 };
            let depth = camera.camera_from_world.transform(&points[part.middle]).z;
            let size = camera.intrinsics.focal() * part.size / depth.max(0.2);
            for k in part.points {
                let jitter = (drift[k] * DRIFT_SHARE + white(rng) * WHITE_SHARE) * self.noise.jitter_of_size * size;
                let is_outlier = rng.random::<f64>() < self.noise.outlier_rate;
                let error = if is_outlier { jitter + gross_error(&self.gross, size, rng) } else { jitter };
                let is_lost = rng.random::<f64>() < self.noise.missed_point_rate;
                let (pixel, in_view) = pixel_of(camera, &points[k]);
                let best = 0.95 * (-error.norm() / (CONFIDENCE_ERROR * size)).exp();
                let confidence = CONFIDENCES.draw(best, 0.0, rng);
                if in_view && !is_lost && !is_away && is_missed >= rate {
                    seen[k] = keypoint(&(pixel + error), confidence);
                }
            }
        }
        if let Some(keypoints) = detection {
            let seen = &seen[N_FACE_POINTS - self.face.len()..];
            keypoints[self.face.start..][..seen.len()].copy_from_slice(seen);
        }
    }

    /// Exchanges hands of this frame's detections, by chance; returns whose hand each is.
    pub(in crate::simulation) fn swap(
        &mut self,
        people: &[Option<usize>],
        detections: &mut [Detection],
    ) -> Vec<SeenHands> {
        let own = |person: &Option<usize>| Side::BOTH.map(|side| person.map(|person| (person, side)));
        let mut sources: Vec<SeenHands> = people.iter().map(own).collect();
        let (happens, between) = (self.swaps.random::<f64>() < self.noise.swap_rate, self.swaps.random::<bool>());
        let [a, b, side_a, side_b]: [f64; 4] = std::array::from_fn(|_| self.swaps.random::<f64>());
        if !happens || detections.is_empty() {
            return sources;
        }
        let n = detections.len();
        let (first, side) = ((a * n as f64) as usize, usize::from(side_a < 0.5));
        let (second, other) = match between && n > 1 {
            true => ((first + 1 + (b * (n - 1) as f64) as usize) % n, usize::from(side_b < 0.5)),
            false => (first, 1 - side),
        };
        for k in 0..N_HAND_POINTS {
            let at = |side: usize| self.face.end + side * N_HAND_POINTS + k;
            let (one, two) = (detections[first].keypoints[at(side)], detections[second].keypoints[at(other)]);
            detections[first].keypoints[at(side)] = two;
            detections[second].keypoints[at(other)] = one;
        }
        let (one, two) = (sources[first][side], sources[second][other]);
        (sources[first][side], sources[second][other]) = (two, one);
        sources
    }
}
