//! The simulated scene, and what one camera records of it.

use super::config::SimulationConfig;
use super::error::SimulationError;
use super::landmarks::Detectable;
use super::skeleton::SimulatedPerson;
use crate::body::skeleton::{KeypointConvention, N_JOINTS};
use crate::session::Detection;
use nalgebra::Vector3;

/// The people, posed, and the points a detector looks for.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedScene {
    /// `joints[frame][person][joint]`, world, m.
    pub joints: Vec<Vec<[Vector3<f64>; N_JOINTS]>>,
    /// `keypoints[frame][person][keypoint]`: what the detector takes for the convention's named points, world, m.
    pub keypoints: Vec<Vec<Vec<Vector3<f64>>>>,
    /// What the points are.
    pub convention: KeypointConvention,
    /// Whether each frame lies within the time that is simulated.
    pub exists: Vec<bool>,
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

impl SimulatedScene {
    /// Poses everybody in every frame.
    ///
    /// # Errors
    /// [`SimulationError::UnknownKeypoint`] where a body has no point for a keypoint of the convention.
    pub fn new(people: &[SimulatedPerson], config: &SimulationConfig) -> Result<Self, SimulationError> {
        let n_frames = people.iter().map(|p| p.poses.len()).min().unwrap_or(0);
        let detected = people.iter().map(|p| Detectable::new(p, config)).collect::<Result<Vec<_>, _>>()?;
        let (convention, exists) = (config.convention, vec![true; n_frames]);
        let mut scene = Self { joints: Vec::new(), keypoints: Vec::new(), convention, exists };
        for frame in 0..n_frames {
            let posed: Vec<_> = people.iter().map(|p| p.skeleton.pose(&p.poses[frame])).collect();
            scene.keypoints.push(posed.iter().zip(&detected).map(|(posed, body)| body.points(posed)).collect());
            scene.joints.push(posed.iter().map(|p| p.joints).collect());
        }
        Ok(scene)
    }

    /// The scene as a camera sees it whose frame `n` is taken at `n + offset`; between frames on a cubic through four
    /// of them (Catmull and Rom 1974), which at 30 Hz is within 0.1 mm of how people move.
    pub(super) fn at_offset(&self, offset: f64) -> Self {
        let last = self.joints.len() as f64 - 1.0;
        let time = |frame: usize| frame as f64 + offset;
        let joints = |frame: usize, person: usize| {
            std::array::from_fn(|j| between(time(frame), last, |f| self.joints[f][person][j]))
        };
        let points = |frame: usize, person: usize| {
            let one = |k: usize| between(time(frame), last, |f| self.keypoints[f][person][k]);
            (0..self.keypoints[frame][person].len()).map(one).collect()
        };
        let people = |frame: usize| 0..self.joints[frame].len();
        let frames = 0..self.joints.len();
        Self {
            joints: frames.clone().map(|f| people(f).map(|p| joints(f, p)).collect()).collect(),
            keypoints: frames.clone().map(|f| people(f).map(|p| points(f, p)).collect()).collect(),
            convention: self.convention,
            exists: frames.map(|f| (0.0..=last).contains(&time(f))).collect(),
        }
    }
}

/// A path at a time between frames; before the first and after the last frame it stands still.
fn between(time: f64, last: f64, at: impl Fn(usize) -> Vector3<f64>) -> Vector3<f64> {
    let time = time.clamp(0.0, last);
    let (start, s) = (time.floor(), time.fract());
    let [a, b, c, d] = [-1.0, 0.0, 1.0, 2.0].map(|k| at((start + k).clamp(0.0, last) as usize));
    b + ((c - a) + ((a * 2.0 - b * 5.0 + c * 4.0 - d) + (b * 3.0 - c * 3.0 + d - a) * s) * s) * (0.5 * s)
}
