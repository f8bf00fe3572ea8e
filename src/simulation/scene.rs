//! The simulated scene, and the recording of one camera.

use super::config::SimulationConfig;
use super::error::SimulationError;
use super::hands::{Details, HandSource};
use super::landmarks::Detectable;
use super::skeleton::SimulatedPerson;
use crate::body::skeleton::{KeypointConvention, N_JOINTS};
use crate::session::Detection;
use nalgebra::Vector3;

/// Joints and true keypoints of all people over time.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedScene {
    /// `joints[frame][person][joint]`, world, m.
    pub joints: Vec<Vec<[Vector3<f64>; N_JOINTS]>>,
    /// `keypoints[frame][person][keypoint]`: the true keypoints, including the keypoint bias, world, m.
    pub keypoints: Vec<Vec<Vec<Vector3<f64>>>>,
    /// `details[frame][person]`: true points of face and hands, where the convention has them, else none; world, m.
    pub details: Vec<Vec<Vec<Vector3<f64>>>>,
    /// Convention of the keypoints.
    pub convention: KeypointConvention,
    /// Whether each frame lies within the simulated time.
    pub exists: Vec<bool>,
}

/// The recording of one camera, and its truth.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ViewRecording {
    /// Detections by frame.
    pub frames: Vec<Vec<Detection>>,
    /// The true person of each detection; `None` for a ghost.
    pub identities: Vec<Vec<Option<usize>>>,
    /// Whose hands each detection has; empty where the convention has no hands.
    pub hands: Vec<Vec<[Option<HandSource>; 2]>>,
    /// Counts of detections and noise.
    pub tally: Tally,
}

/// Counts of detections and noise.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Tally {
    /// Number of people with at least four points in the image, over all frames.
    pub detections_possible: usize,
    /// Number of points in the image, of the people detected.
    pub joints_in_view: usize,
    /// Number of points reported.
    pub joints: usize,
    /// Number of identity swaps.
    pub swaps: usize,
    /// Number of detections with left and right exchanged.
    pub flips: usize,
    /// Number of outliers reported.
    pub outliers: usize,
    /// Number of detections of ghosts.
    pub ghosts: usize,
    /// Number of limbs reported in the detection of another person.
    pub merged_limbs: usize,
    /// Error of every point reported, before limbs are merged, px.
    pub errors_px: Vec<f64>,
}

impl SimulatedScene {
    /// Poses all people in all frames.
    ///
    /// # Errors
    /// [`SimulationError::UnknownKeypoint`] if a body has no point for a keypoint of the convention.
    pub fn new(people: &[SimulatedPerson], config: &SimulationConfig) -> Result<Self, SimulationError> {
        let n_frames = people.iter().map(|p| p.poses.len()).min().unwrap_or(0);
        let detected = people.iter().map(|p| Detectable::new(p, config)).collect::<Result<Vec<_>, _>>()?;
        let (convention, exists) = (config.convention, vec![true; n_frames]);
        let details: Vec<Option<Details>> =
            people.iter().enumerate().map(|(i, p)| Details::new(config, i, p)).collect();
        let mut scene = Self { joints: Vec::new(), keypoints: Vec::new(), details: Vec::new(), convention, exists };
        for frame in 0..n_frames {
            let posed: Vec<_> = people.iter().map(|p| p.skeleton.pose(&p.poses[frame])).collect();
            scene.keypoints.push(posed.iter().zip(&detected).map(|(posed, body)| body.points(posed)).collect());
            let of_person = |(posed, details): (_, &Option<Details>)| {
                details.as_ref().map_or_else(Vec::new, |d| d.points(frame, posed))
            };
            scene.details.push(posed.iter().zip(&details).map(of_person).collect());
            scene.joints.push(posed.iter().map(|p| p.joints).collect());
        }
        Ok(scene)
    }

    /// The scene of a camera whose frame `n` is taken at time `n + offset`, frames; between frames a cubic through four of
    /// them (Catmull and Rom 1974), which at 30 Hz is within 0.1 mm of real motion.
    pub(super) fn at_offset(&self, offset: f64) -> Self {
        let last = self.joints.len() as f64 - 1.0;
        let time = |frame: usize| frame as f64 + offset;
        let joints = |frame: usize, person: usize| {
            std::array::from_fn(|j| between(time(frame), last, |f| self.joints[f][person][j]))
        };
        let moved = |points: &[Vec<Vec<Vector3<f64>>>], frame: usize, person: usize| -> Vec<Vector3<f64>> {
            let one = |k: usize| between(time(frame), last, |f| points[f][person][k]);
            (0..points[frame][person].len()).map(one).collect()
        };
        let people = |frame: usize| 0..self.joints[frame].len();
        let frames = 0..self.joints.len();
        Self {
            joints: frames.clone().map(|f| people(f).map(|p| joints(f, p)).collect()).collect(),
            keypoints: frames.clone().map(|f| people(f).map(|p| moved(&self.keypoints, f, p)).collect()).collect(),
            details: frames.clone().map(|f| people(f).map(|p| moved(&self.details, f, p)).collect()).collect(),
            convention: self.convention,
            exists: frames.map(|f| (0.0..=last).contains(&time(f))).collect(),
        }
    }
}

/// A path at a time between frames; constant before the first and after the last frame.
fn between(time: f64, last: f64, at: impl Fn(usize) -> Vector3<f64>) -> Vector3<f64> {
    let time = time.clamp(0.0, last);
    let (start, s) = (time.floor(), time.fract());
    let [a, b, c, d] = [-1.0, 0.0, 1.0, 2.0].map(|k| at((start + k).clamp(0.0, last) as usize));
    b + ((c - a) + ((a * 2.0 - b * 5.0 + c * 4.0 - d) + (b * 3.0 - c * 3.0 + d - a) * s) * s) * (0.5 * s)
}
