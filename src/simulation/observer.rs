//! Simulated detections of one person in a view.
//!
//! Errors are proportional to the person's apparent size and partly drift slowly; outliers have heavy tails; hidden joints
//! have larger errors and are mostly missing; detections are missing for runs of frames; left and right are exchanged.

use super::config::{NoiseConfig, SimulationConfig};
use super::occlusion::is_hidden;
use super::random::{Purpose, normal, stream};
use super::rig::RigCamera;
use super::scene::{SimulatedScene, Tally};
use crate::body::skeleton::{KeypointConvention, N_JOINTS};
use crate::session::Keypoint;
use nalgebra::{Vector2, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StudentT;

/// The points that a left/right flip exchanges.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Flip {
    Body,
    Legs,
    Arms,
}

/// The detector's state for one person: random stream, drift and missing frames.
pub(super) struct Observer {
    rng: ChaCha8Rng,
    person: usize,
    noise: NoiseConfig,
    /// Correlation of the drift from one frame to the next.
    drift_memory: f64,
    drift: Vec<Vector2<f64>>,
    missed_frames_left: usize,
    mirror: Vec<usize>,
}

/// Correlation of the detector's drift after 1/30 s.
const DRIFT_MEMORY_30HZ: f64 = 0.9;
/// Shares of drift and of white jitter in a joint's error; their squares sum to one.
const DRIFT_SHARE: f64 = 0.6;
const WHITE_SHARE: f64 = 0.8;
/// Smallest apparent size for the noise, px.
const MIN_SIZE_PX: f64 = 20.0;
/// Points nearer to the camera plane than this are not seen, m.
const MIN_DEPTH: f64 = 0.2;

/// A point in the image before noise is added.
#[derive(Debug, Clone, Copy)]
struct Projected {
    pixel: Vector2<f64>,
    in_view: bool,
    hidden: bool,
}

impl Observer {
    pub(super) fn new(scene: &SimulatedScene, view: usize, person: usize, config: &SimulationConfig) -> Self {
        let mut rng = stream(config.seed, Purpose::Detector, view, person);
        let mirror = scene.convention.mirror();
        Self {
            drift: mirror.iter().map(|_| white(&mut rng)).collect(),
            rng,
            person,
            noise: config.noise,
            drift_memory: DRIFT_MEMORY_30HZ.powf(30.0 / config.fps),
            missed_frames_left: 0,
            mirror,
        }
    }

    /// The detection of this frame, if there is one.
    pub(super) fn observe(
        &mut self,
        scene: &SimulatedScene,
        frame: usize,
        camera: &RigCamera,
        tally: &mut Tally,
    ) -> Option<Vec<Keypoint>> {
        let points = project(scene, frame, self.person, camera);
        let n_in_view = points.iter().filter(|p| p.in_view).count();
        tally.detections_possible += usize::from(n_in_view >= 4);
        self.drift_on();
        if self.is_missed() || n_in_view < 4 {
            return None;
        }
        let n_hidden = points.iter().filter(|p| p.in_view && p.hidden).count();
        if n_hidden as f64 > 0.85 * n_in_view as f64 && self.happens(self.noise.hidden_person_missing_rate) {
            return None;
        }
        let size = apparent_size(&points);
        let (mut pixels, outliers) = self.disturbed(&points, size);
        if self.happens(self.noise.flip_rate) {
            self.flip(&mut pixels, scene.convention);
            tally.flips += 1;
        }
        let mut keypoints = Vec::with_capacity(scene.convention.n_keypoints());
        let (mut errors, mut n_outliers) = (Vec::new(), 0);
        for (k, point) in points.iter().enumerate() {
            let error = (pixels[k] - point.pixel).norm();
            let keypoint = self.report(point, &pixels[k], error / size);
            if keypoint.is_present() {
                errors.push(error);
                n_outliers += usize::from(outliers[k]);
            }
            keypoints.push(keypoint);
        }
        if errors.len() < 3 {
            return None;
        }
        keypoints.resize(scene.convention.n_keypoints(), MISSING);
        tally.joints += errors.len();
        tally.joints_in_view += n_in_view;
        tally.outliers += n_outliers;
        tally.errors_px.append(&mut errors);
        Some(keypoints)
    }

    fn happens(&mut self, probability: f64) -> bool {
        self.rng.random::<f64>() < probability
    }

    /// First-order autoregression of unit variance.
    fn drift_on(&mut self) {
        let (memory, fresh) = (self.drift_memory, (1.0 - self.drift_memory.powi(2)).sqrt());
        for drift in &mut self.drift {
            *drift = *drift * memory + white(&mut self.rng) * fresh;
        }
    }

    fn is_missed(&mut self) -> bool {
        if self.missed_frames_left > 0 {
            self.missed_frames_left -= 1;
            return true;
        }
        // Runs last four frames on average.
        let starts = self.happens(0.25 * self.noise.missed_detection_rate);
        if starts {
            self.missed_frames_left = self.rng.random_range(0..7);
        }
        starts
    }

    /// Pixels with jitter and outliers, and whether each is an outlier.
    fn disturbed(&mut self, points: &[Projected], size: f64) -> (Vec<Vector2<f64>>, Vec<bool>) {
        let noise = self.noise;
        let heavy = StudentT::new(1.8).expect("1.8 degrees of freedom are positive");
        let mut disturb = |(point, drift): (&Projected, &Vector2<f64>)| {
            let (worse, likelier) = if point.hidden { (2.5, 4.0) } else { (1.0, 1.0) };
            let jitter =
                (drift * DRIFT_SHARE + white(&mut self.rng) * WHITE_SHARE) * (noise.jitter_of_size * size * worse);
            let is_outlier = self.rng.random::<f64>() < noise.outlier_rate * likelier;
            let mut gross = || (self.rng.sample(heavy) * noise.outlier_of_size * size * 0.35).clamp(-size, size);
            let error = if is_outlier { jitter + Vector2::new(gross(), gross()) } else { jitter };
            (point.pixel + error, is_outlier)
        };
        points.iter().zip(&self.drift).map(&mut disturb).unzip()
    }

    fn flip(&mut self, pixels: &mut [Vector2<f64>], convention: KeypointConvention) {
        let flip = match self.rng.random::<f64>() {
            share if share < 0.5 => Flip::Body,
            share if share < 0.75 => Flip::Legs,
            _ => Flip::Arms,
        };
        let original = pixels.to_vec();
        for (k, name) in convention.names().iter().enumerate() {
            if flip.exchanges(name) {
                pixels[k] = original[self.mirror[k]];
            }
        }
    }

    /// The keypoint reported of one point: pixels to a hundredth, confidence (falls with the error) to a thousandth.
    fn report(&mut self, point: &Projected, pixel: &Vector2<f64>, error_of_size: f64) -> Keypoint {
        let hidden = if point.hidden { 0.20 } else { 0.0 };
        let confidence = 0.95 * (-error_of_size / 0.10).exp() + normal(&mut self.rng, 0.08) - hidden;
        let confidence = (confidence.clamp(0.02, 1.0) * 1e3).round() / 1e3;
        let dropped = self.happens(self.noise.missed_joint_rate);
        let dropped_hidden = self.happens(self.noise.occluded_joint_missing_rate) && point.hidden;
        if dropped || dropped_hidden || !point.in_view || confidence < 0.05 {
            return MISSING;
        }
        Keypoint { pixel: pixel.map(|v| (v * 1e2).round() / 1e2), confidence }
    }
}

impl Flip {
    fn exchanges(self, keypoint: &str) -> bool {
        let any = |parts: &[&str]| parts.iter().any(|part| keypoint.contains(part));
        match self {
            Self::Body => true,
            Self::Legs => any(&["hip", "knee", "ankle", "toe", "heel", "foot"]),
            Self::Arms => any(&["shoulder", "elbow", "wrist", "hand", "pinky", "index", "thumb"]),
        }
    }
}

const MISSING: Keypoint = Keypoint { pixel: Vector2::new(0.0, 0.0), confidence: 0.0 };

fn white(rng: &mut ChaCha8Rng) -> Vector2<f64> {
    Vector2::new(normal(rng, 1.0), normal(rng, 1.0))
}

fn project(scene: &SimulatedScene, frame: usize, person: usize, camera: &RigCamera) -> Vec<Projected> {
    let center = camera.camera_from_world.center();
    let people: Vec<&[Vector3<f64>; N_JOINTS]> = scene.joints[frame].iter().collect();
    let (width, height) = (f64::from(camera.intrinsics.width), f64::from(camera.intrinsics.height));
    let point = |point: &Vector3<f64>| {
        let in_camera = camera.camera_from_world.transform(point);
        let pixel = camera.intrinsics.pixel_from_camera(&in_camera).unwrap_or_else(Vector2::zeros);
        let on_sensor = pixel.x > 0.0 && pixel.x < width && pixel.y > 0.0 && pixel.y < height;
        let in_view = in_camera.z > MIN_DEPTH && on_sensor;
        Projected { pixel, in_view, hidden: is_hidden(&center, point, person, &people) }
    };
    scene.keypoints[frame][person].iter().map(point).collect()
}

/// The longer side of the bounding box of the points in the image, px.
fn apparent_size(points: &[Projected]) -> f64 {
    let seen = || points.iter().filter(|p| p.in_view);
    let low = seen().fold(Vector2::repeat(f64::INFINITY), |low, p| low.inf(&p.pixel));
    let high = seen().fold(Vector2::repeat(f64::NEG_INFINITY), |high, p| high.sup(&p.pixel));
    (high - low).max().max(MIN_SIZE_PX)
}
