//! Simulated detections of one person in a view: missing detections, errors of the keypoints, left/right flips.

use super::config::{NoiseConfig, SimulationConfig};
use super::keypoint_errors::{Disturbed, KeypointErrors, with_unnamed};
use super::preset_errors::PresetErrors;
use super::projection::{Projector, apparent_size};
use super::random::{Purpose, stream};
use super::real_errors::RealErrors;
use super::rig::RigCamera;
use super::scene::{SimulatedScene, Tally};
use super::stretched_errors::StretchedErrors;
use crate::body::skeleton::KeypointConvention;
use crate::geometry::PixelCovariance;
use crate::session::Keypoint;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// The points that a left/right flip exchanges.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Flip {
    Body,
    Legs,
    Arms,
}

/// The detector's state for one person: random stream, errors and missing frames.
pub(super) struct Observer {
    rng: ChaCha8Rng,
    person: usize,
    noise: NoiseConfig,
    projector: Projector,
    errors: Box<dyn KeypointErrors>,
    stretched: Option<StretchedErrors>,
    missed_frames_left: usize,
    mirror: Vec<usize>,
}

impl Observer {
    pub(super) fn new(view: usize, person: usize, config: &SimulationConfig) -> Self {
        let mut rng = stream(config.seed, Purpose::Detector, view, person);
        let errors: Box<dyn KeypointErrors> = match config.noise.real {
            None => Box::new(PresetErrors::new(config, &mut rng)),
            Some(real) => Box::new(RealErrors::new(real, config, &mut rng)),
        };
        Self {
            rng,
            person,
            noise: config.noise,
            projector: Projector::new(config.convention),
            errors,
            stretched: config.noise.covariances.then(|| StretchedErrors::new(view, person, config)),
            missed_frames_left: 0,
            mirror: config.convention.mirror(),
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
        let points = self.projector.project(scene, frame, self.person, camera);
        let n_in_view = points.iter().filter(|p| p.in_view).count();
        tally.detections_possible += usize::from(n_in_view >= 4);
        self.errors.advance(&points, &mut self.rng);
        self.stretched.iter_mut().for_each(StretchedErrors::advance);
        if self.is_missed() || n_in_view < 4 {
            return None;
        }
        let n_hidden = points.iter().filter(|p| p.in_view && p.hidden).count();
        if n_hidden as f64 > 0.85 * n_in_view as f64 && self.happens(self.noise.hidden_person_missing_rate) {
            return None;
        }
        let size = apparent_size(&points);
        let mut disturbed = self.errors.disturbed(&points, size, &mut self.rng);
        let mut covariances = self.stretched.as_ref().map(|stretched| stretched.apply(&points, &mut disturbed));
        if self.happens(self.noise.flip_rate) {
            self.flip(&mut disturbed, covariances.as_deref_mut(), scene.convention);
            tally.flips += 1;
        }
        let mut keypoints = self.errors.reported(&points, &disturbed, size, &mut self.rng);
        for (keypoint, covariance) in keypoints.iter_mut().zip(covariances.into_iter().flatten()) {
            keypoint.covariance = covariance.filter(|_| keypoint.is_present());
        }
        let reported: Vec<usize> = (0..points.len()).filter(|&k| keypoints[k].is_present()).collect();
        if reported.len() < 3 {
            return None;
        }
        with_unnamed(&mut keypoints, scene.convention);
        tally.joints += reported.len();
        tally.joints_in_view += n_in_view;
        tally.outliers += reported.iter().filter(|&&k| disturbed[k].is_outlier).count();
        tally.errors_px.extend(reported.iter().map(|&k| (disturbed[k].pixel - points[k].pixel).norm()));
        Some(keypoints)
    }

    fn happens(&mut self, probability: f64) -> bool {
        self.rng.random::<f64>() < probability
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

    fn flip(
        &mut self,
        disturbed: &mut [Disturbed],
        covariances: Option<&mut [Option<PixelCovariance>]>,
        convention: KeypointConvention,
    ) {
        let flip = match self.rng.random::<f64>() {
            share if share < 0.5 => Flip::Body,
            share if share < 0.75 => Flip::Legs,
            _ => Flip::Arms,
        };
        let original = disturbed.to_vec();
        for (k, name) in convention.names().iter().enumerate() {
            if flip.exchanges(name) {
                disturbed[k].pixel = original[self.mirror[k]].pixel;
            }
        }
        if let Some(covariances) = covariances {
            let original = covariances.to_vec();
            for (k, _) in convention.names().iter().enumerate().filter(|(_, name)| flip.exchanges(name)) {
                covariances[k] = original[self.mirror[k]];
            }
        }
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
