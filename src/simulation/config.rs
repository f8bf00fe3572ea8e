//! Configuration of a simulated session: people, cameras, noise; every number with its unit.

use super::error::SimulationError;
use super::hands::HandNoise;
use super::real_noise::RealNoise;
use crate::body::dense_landmarks::DenseLandmarks;
use crate::body::skeleton::KeypointConvention;
use crate::geometry::Distortion;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::Arc;

/// Configuration of one simulated session. The same configuration gives the same session, byte for byte.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SimulationConfig {
    /// Number of people.
    pub people: usize,
    /// Number of cameras.
    pub views: usize,
    /// Length, frames; shorter motion files shorten the session.
    pub frames: usize,
    /// Frame rate, Hz.
    pub fps: f64,
    /// Seed of every random choice.
    pub seed: u64,
    /// Noise of detector and tracker.
    pub noise: NoiseConfig,
    /// The cameras.
    pub rig: RigConfig,
    /// Keypoint convention of the detector.
    pub convention: KeypointConvention,
    /// Landmarks that the detector reports behind the keypoints of the convention; needs default bodies.
    #[serde(skip)]
    pub dense: Option<Arc<DenseLandmarks>>,
    /// Track numbers of the tracker.
    pub tracks: Tracks,
    /// Time offset of each camera, frames: its frame `n` shows the scene at `n + time_offset` (views beyond the list: 0).
    /// Frames before the first or after the last simulated time are empty.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub time_offsets: Vec<f64>,
    /// The people's bodies.
    pub bodies: Bodies,
    /// Noise of hands and faces, where the convention has their points; `None`: the usual one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hands: Option<HandNoise>,
    /// Source of the motion.
    #[serde(skip)]
    pub motion: MotionSource,
}

/// Noise of a detector and a tracker. A share "of size" is relative to the longer side of the person's box, px.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct NoiseConfig {
    /// Standard deviation of a joint's error, of size: 0.6 of it drifts slowly, 0.8 of it is white; x 2.5 where hidden.
    pub jitter_of_size: f64,
    /// Share of joints that are outliers; x 4 where hidden.
    pub outlier_rate: f64,
    /// Scale of an outlier, of size; Student's t with 1.8 degrees of freedom, x 0.35, at most one size.
    pub outlier_of_size: f64,
    /// Share of joints missing at random.
    pub missed_joint_rate: f64,
    /// Share of detections missing at random, in runs of 1 to 7 frames (a run starts with a quarter of this probability).
    pub missed_detection_rate: f64,
    /// Share of hidden joints that are not reported.
    pub occluded_joint_missing_rate: f64,
    /// Share of people with more than 85 % of their points hidden that are not detected.
    pub hidden_person_missing_rate: f64,
    /// Identity swaps between two people, per view and minute; each lasts 5 to 60 frames.
    pub swaps_per_minute: f64,
    /// Share of detections with left and right exchanged: whole body (half of them), legs or arms.
    pub flip_rate: f64,
    /// Errors as of a real detector: slow, shared and lasting, with ghosts, half detections and merged limbs. `None`: errors
    /// are independent, except for the drift of `jitter_of_size`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub real: Option<RealNoise>,
    /// Whether errors are anisotropic, of sizes that change by three times, and the detector states their covariances.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub covariances: bool,
}

impl NoiseConfig {
    /// No noise: a perfect detector and tracker that also see hidden joints.
    pub const NONE: Self = Self {
        jitter_of_size: 0.0,
        outlier_rate: 0.0,
        outlier_of_size: 0.0,
        missed_joint_rate: 0.0,
        missed_detection_rate: 0.0,
        occluded_joint_missing_rate: 0.0,
        hidden_person_missing_rate: 0.0,
        swaps_per_minute: 0.0,
        flip_rate: 0.0,
        real: None,
        covariances: false,
    };
}

/// Configuration of the cameras around the scene, all aimed near its centre.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RigConfig {
    /// Distance from the centre, m (sd 5 %).
    pub radius: f64,
    /// Height above the floor, m (sd 0.25 m, at least 0.6 m).
    pub height: f64,
    /// Horizontal field of view, degrees (sd 3 %).
    pub fov_deg: f64,
    /// Standard deviation of the point aimed at, per axis, m.
    pub aim_jitter: f64,
    /// Standard deviation of the roll about the optical axis, degrees.
    pub roll_jitter_deg: f64,
    /// Image width, px.
    pub image_width: u32,
    /// Image height, px.
    pub image_height: u32,
    /// Arrangement of the cameras.
    pub arrangement: Arrangement,
    /// Lens distortion.
    pub lens: Lens,
}

/// Lens of a camera; the field of view is that of the distorted image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Lens {
    /// No distortion.
    #[default]
    Pinhole,
    /// A barrel distortion of a quarter at 45 degrees, with small values of OpenCV's other four terms.
    WideAngle,
    /// OpenCV's fisheye: nearly equidistant.
    Fisheye,
}

impl Lens {
    /// The distortion; invertible over every field of view that a rig may have.
    pub fn distortion(self) -> Distortion {
        match self {
            Self::Pinhole => Distortion::None,
            Self::WideAngle => Distortion::OpenCv5([-0.25, 0.06, 5e-4, -3e-4, -0.002]),
            Self::Fisheye => Distortion::Fisheye4([-0.02, 0.004, -0.001, 1e-4]),
        }
    }
}

/// Arrangement of the cameras.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Arrangement {
    /// Evenly spaced on a full circle.
    Ring,
    /// Evenly spaced on an arc of the circle.
    Arc {
        /// Angle between the first and the last camera, degrees.
        span_deg: f64,
    },
}

/// Meaning of the track numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Tracks {
    /// A number is the same person in every view, except for swaps.
    Consistent,
    /// Every view has its own numbers, as with a real tracker.
    PerView,
    /// No track numbers.
    None,
}

/// The people's bodies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Bodies {
    /// The simulator's own bodies, independent of the body model of the fit ([`super::skeleton`]).
    Own,
    /// The default body at random shapes, betas from N(0, 1), with its landmarks as keypoints: the best case for a fit.
    Default,
    /// The same with realistic deviations: rest joints moved inside the same skin (10 mm per axis), and a keypoint bias of 30
    /// to 50 mm at the hips, 10 to 20 mm at other joints, 5 to 10 mm at points of face and feet.
    Individual,
}

/// Source of the motion.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum MotionSource {
    /// Walking, stopping, turning, crouching, sitting, reaching, gesturing.
    #[default]
    Procedural,
    /// Two people dancing: face to face within arms' reach, turning about each other.
    Dance,
    /// Running straight through the middle, past each other.
    Running {
        /// Speed, m/s.
        speed: f64,
    },
    /// Drawn from the embedded motion prior.
    Prior,
    /// One `.npz` in the AMASS layout a person, in this order.
    Files(Vec<PathBuf>),
}

impl SimulationConfig {
    /// Names of all points that the detector reports: of the convention, then of the dense landmarks.
    pub(super) fn point_names(&self) -> Vec<&str> {
        let dense = self.dense.iter().flat_map(|dense| dense.names());
        self.convention.names().iter().copied().chain(dense).collect()
    }

    /// Rejects values out of range.
    ///
    /// # Errors
    /// [`SimulationError::Config`] names the first field that is out of its range.
    pub fn check(&self) -> Result<(), SimulationError> {
        let (n, r) = (&self.noise, &self.rig);
        let ranges: [(&'static str, f64, f64, f64, &'static str); 20] = [
            ("people", self.people as f64, 1.0, 100.0, "1 to 100"),
            ("views", self.views as f64, 1.0, 1000.0, "1 to 1000"),
            ("frames", self.frames as f64, 1.0, 1e6, "1 to 1000000"),
            ("fps", self.fps, 1.0, 1000.0, "1 to 1000"),
            ("jitter_of_size", n.jitter_of_size, 0.0, 1.0, "0 to 1"),
            ("outlier_rate", n.outlier_rate, 0.0, 1.0, "0 to 1"),
            ("outlier_of_size", n.outlier_of_size, 0.0, 10.0, "0 to 10"),
            ("missed_joint_rate", n.missed_joint_rate, 0.0, 1.0, "0 to 1"),
            ("missed_detection_rate", n.missed_detection_rate, 0.0, 1.0, "0 to 1"),
            ("occluded_joint_missing_rate", n.occluded_joint_missing_rate, 0.0, 1.0, "0 to 1"),
            ("hidden_person_missing_rate", n.hidden_person_missing_rate, 0.0, 1.0, "0 to 1"),
            ("swaps_per_minute", n.swaps_per_minute, 0.0, 1000.0, "0 to 1000"),
            ("flip_rate", n.flip_rate, 0.0, 1.0, "0 to 1"),
            ("radius", r.radius, 0.5, 1000.0, "0.5 to 1000 m"),
            ("height", r.height, 0.0, 1000.0, "0 to 1000 m"),
            ("fov_deg", r.fov_deg, 1.0, 150.0, "1 to 150 degrees"),
            ("aim_jitter", r.aim_jitter, 0.0, 10.0, "0 to 10 m"),
            ("roll_jitter_deg", r.roll_jitter_deg, 0.0, 180.0, "0 to 180 degrees"),
            ("image_width", r.image_width as f64, 16.0, 65536.0, "16 to 65536 px"),
            ("image_height", r.image_height as f64, 16.0, 65536.0, "16 to 65536 px"),
        ];
        let real = n.real.map_or_else(Vec::new, |real| real.ranges().to_vec());
        let hands = self.hands.map_or_else(Vec::new, |hands| hands.ranges().to_vec());
        for (field, value, low, high, expected) in ranges.into_iter().chain(real).chain(hands) {
            // NaN is outside every range.
            if !(low..=high).contains(&value) {
                return Err(SimulationError::Config { field, value, expected });
            }
        }
        if self.dense.is_some() && self.bodies == Bodies::Own {
            return Err(SimulationError::Config { field: "dense", value: 0.0, expected: "default bodies" });
        }
        if self.motion == MotionSource::Dance && self.people != 2 {
            let value = self.people as f64;
            return Err(SimulationError::Config { field: "people", value, expected: "2 for a dance" });
        }
        if let MotionSource::Running { speed } = self.motion
            && !(0.1..=100.0).contains(&speed)
        {
            return Err(SimulationError::Config { field: "running", value: speed, expected: "0.1 to 100 m/s" });
        }
        if let Some(&value) = self.time_offsets.iter().find(|offset| !(-1e6..=1e6).contains(*offset)) {
            let expected = "-1000000 to 1000000 frames";
            return Err(SimulationError::Config { field: "time_offsets", value, expected });
        }
        if let Arrangement::Arc { span_deg } = r.arrangement
            && !(0.0..=360.0).contains(&span_deg)
        {
            return Err(SimulationError::Config { field: "span_deg", value: span_deg, expected: "0 to 360 degrees" });
        }
        Ok(())
    }
}

impl Default for RigConfig {
    /// A 4 m ring of 1280 x 720 cameras of 65 degrees, held by hand: 0.15 m and 1 degree from their aim.
    fn default() -> Self {
        Self {
            radius: 4.0,
            height: 1.9,
            fov_deg: 65.0,
            aim_jitter: 0.15,
            roll_jitter_deg: 1.0,
            image_width: 1280,
            image_height: 720,
            arrangement: Arrangement::Ring,
            lens: Lens::Pinhole,
        }
    }
}
