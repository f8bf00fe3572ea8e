//! What one camera's detector and tracker report of the scene, from the first frame to the last.

use super::SimulationError;
use super::config::SimulationConfig;
use super::landmarks::Detectable;
use super::observer::Observer;
use super::rig::RigCamera;
use super::skeleton::Person;
use super::tracker::Tracker;
use crate::body::skeleton::{KeypointConvention, N_JOINTS};
use crate::session::Detection;
use nalgebra::Vector3;
use rand::seq::SliceRandom;

/// The people, posed, and the points a detector looks for.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// `joints[frame][person][joint]`, world, m.
    pub joints: Vec<Vec<[Vector3<f64>; N_JOINTS]>>,
    /// `keypoints[frame][person][keypoint]`: the convention's named points, world, m.
    pub keypoints: Vec<Vec<Vec<Vector3<f64>>>>,
    /// What the points are.
    pub convention: KeypointConvention,
}

/// What one camera delivers, and the truth about it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ViewRecording {
    /// Detections, frame by frame.
    pub frames: Vec<Vec<Detection>>,
    /// The true person of each of them.
    pub identities: Vec<Vec<usize>>,
    /// What was counted on the way.
    pub tally: Tally,
}

/// Counts of what the detector did.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Tally {
    /// People with at least four points in the image.
    pub detections_possible: usize,
    /// Points in the image, of those detected.
    pub joints_in_view: usize,
    /// Points reported.
    pub joints: usize,
    /// Identity swaps begun.
    pub swaps: usize,
    /// Detections with left and right exchanged.
    pub flips: usize,
    /// Outliers reported.
    pub outliers: usize,
    /// Error of every point reported, px.
    pub errors_px: Vec<f64>,
}

impl Scene {
    /// Poses everybody in every frame.
    ///
    /// # Errors
    /// [`SimulationError::UnknownKeypoint`] where a body has no point for a keypoint of the convention.
    pub fn new(people: &[Person], convention: KeypointConvention) -> Result<Self, SimulationError> {
        let n_frames = people.iter().map(|p| p.poses.len()).min().unwrap_or(0);
        let detected = people.iter().map(|p| Detectable::new(p, convention)).collect::<Result<Vec<_>, _>>()?;
        let mut scene = Self { joints: Vec::new(), keypoints: Vec::new(), convention };
        for frame in 0..n_frames {
            let posed: Vec<_> = people.iter().map(|p| p.skeleton.pose(&p.poses[frame])).collect();
            scene.keypoints.push(posed.iter().zip(&detected).map(|(posed, body)| body.points(posed)).collect());
            scene.joints.push(posed.iter().map(|p| p.joints).collect());
        }
        Ok(scene)
    }
}

/// A camera's whole recording. Every person has an own random stream in every view.
pub fn record(scene: &Scene, view: usize, camera: &RigCamera, config: &SimulationConfig) -> ViewRecording {
    let mut recording = ViewRecording::default();
    let mut tracker = Tracker::new(view, config);
    let mut observers: Vec<Observer> =
        (0..config.people).map(|person| Observer::new(scene, view, person, config)).collect();
    for frame in 0..scene.joints.len() {
        recording.tally.swaps += usize::from(tracker.step());
        let mut seen: Vec<(usize, Detection)> = Vec::with_capacity(config.people);
        for (person, observer) in observers.iter_mut().enumerate() {
            if let Some(keypoints) = observer.observe(scene, frame, camera, &mut recording.tally) {
                seen.push((person, Detection { track_id: tracker.track_id(person), keypoints }));
            }
        }
        seen.shuffle(tracker.rng());
        let (identities, detections) = seen.into_iter().unzip();
        recording.identities.push(identities);
        recording.frames.push(detections);
    }
    recording
}
