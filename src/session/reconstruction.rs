//! The result of a solve: camera poses, people, motions and quality figures. `export` serialises it.

mod estimates;
mod report;

use super::people::{BodyMotion, JointTrajectory};
use super::recording::{FrameIndex, PersonId, UpAxis};
use crate::body::hand::Side;
use crate::geometry::{Intrinsics, Rigid};
pub use estimates::{ClockDrift, ErrorSummary, FocalFactor, SigmaSummary, TimeOffset};
pub use report::{
    CameraReport, ConsistencyPair, ConsistencyReport, DetectorOffset, GeometryReport, HandReport, KeypointBias,
    KeypointReport, LandmarkTableId, NoiseAtConfidence, Overlap, PenetrationReport, PersonReport, Quality, Report,
    ScaleReport, StageReport, StillDetections, UncertainFrames, Verdict,
};
use serde::{Deserialize, Serialize};

/// One camera of the result.
#[derive(Debug, Clone, PartialEq)]
pub struct SolvedCamera {
    /// Camera pose, metres; `None` where the camera could not be solved (`unsolved`).
    pub camera_from_world: Option<Rigid>,
    /// Mean and median reprojection error of the inlier keypoints, px.
    pub reprojection_px: Option<ErrorSummary>,
    /// Number of keypoints used.
    pub n_observations: usize,
    /// Standard deviation of the camera centre, mm, after a similarity alignment; excludes the uncertainty of the scale.
    pub sigma_position_mm: Option<f64>,
    /// Standard deviation of the orientation, degrees.
    pub sigma_angle_deg: Option<f64>,
    /// Time offset, where it differs from 0 or was estimated.
    pub time_offset: Option<TimeOffset>,
    /// Factor on the focal lengths, where they were refined.
    pub focal_factor: Option<FocalFactor>,
}

impl SolvedCamera {
    /// The intrinsics that the pose refers to: those of the session, with refined focal lengths.
    pub fn lens(&self, given: &Intrinsics) -> Intrinsics {
        self.focal_factor.map_or(*given, |factor| given.with_focal_factor(factor.value))
    }
}

/// The complete result of a solve.
#[derive(Debug, Clone, PartialEq)]
pub struct Reconstruction {
    /// Cameras, in the order of the session's views.
    pub cameras: Vec<SolvedCamera>,
    /// Best estimate of the detected keypoints in space, per person.
    pub keypoints: Vec<JointTrajectory>,
    /// Body motions, in the same order.
    pub motions: Vec<BodyMotion>,
    /// `identities[view][frame][detection]`: the person that each detection is assigned to; `None` where it is rejected.
    pub identities: Vec<Vec<Vec<Option<PersonId>>>>,
    /// Up axis of the result's world.
    pub up_axis: UpAxis,
    /// The body model that `motions` refer to.
    pub body_model: BodyModelId,
    /// Repairs of the detections; `None` where the consistency stage is switched off.
    pub repairs: Option<DetectionRepairs>,
    /// Where the hands of every detection's person are shown; `None` where the convention has no hands.
    pub hand_sources: Option<HandSources>,
    /// Statistics and verdict.
    pub report: Report,
}

/// A detection of a view and frame, and one of its sides.
pub type HandPlace = (usize, Side);

/// `[view][frame][detection]`: where the same view and frame show its person's left and right hand.
pub type HandSources = Vec<Vec<Vec<[HandPlace; 2]>>>;

/// Changes that the consistency stage made to the detections.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DetectionRepairs {
    /// Identities without any repair, `[view][frame][detection]`: from the detector's track numbers, or without them from
    /// association and tracking.
    pub identities_before: Vec<Vec<Vec<Option<PersonId>>>>,
    /// Detections with exchanged or rejected keypoints, in order of view, frame and detection.
    pub repaired: Vec<RepairedDetection>,
}

/// A detection with exchanged or rejected keypoints.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RepairedDetection {
    /// Index of its view.
    pub view: usize,
    /// Its frame.
    pub frame: FrameIndex,
    /// Its index among the frame's detections.
    pub detection: usize,
    /// For every named keypoint the index of the detected keypoint that shows it; `None` where it is rejected.
    pub sources: Vec<Option<usize>>,
}

/// Identification of the body model that shape and pose parameters refer to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BodyModelId {
    /// Its name.
    pub name: String,
    /// SHA-256 digest of its numbers.
    pub sha256: String,
}

/// An export format of a result (`options.exports`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs)] // self-explanatory names
pub enum ExportFormat {
    SmplNpz,
    Easymocap,
    Glb,
    Bvh,
    Fbx,
    Usd,
    Trc,
    C3d,
    // One format writes both files, which have names of their own in the contract; the table of options repeats them.
    #[serde(alias = "mot", alias = "angles_csv")]
    JointAngles,
    OpencvYaml,
    CalibToml,
    AniposeToml,
    Colmap,
    Chan,
    Blender,
}

impl ExportFormat {
    /// Every format, in the order of the contract.
    pub const ALL: [Self; 15] = [
        Self::SmplNpz,
        Self::Easymocap,
        Self::Glb,
        Self::Bvh,
        Self::Fbx,
        Self::Usd,
        Self::Trc,
        Self::C3d,
        Self::JointAngles,
        Self::OpencvYaml,
        Self::CalibToml,
        Self::AniposeToml,
        Self::Colmap,
        Self::Chan,
        Self::Blender,
    ];
}
