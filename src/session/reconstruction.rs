//! The result: posed cameras, people, motions, quality figures. Serialised by `export`.

mod estimates;
mod report;

use super::people::{BodyMotion, JointTrajectory};
use super::recording::{FrameIndex, PersonId, UpAxis};
use crate::geometry::{Intrinsics, Rigid};
pub use estimates::{ErrorSummary, FocalFactor, SigmaSummary, TimeOffset};
pub use report::{
    CameraReport, ConsistencyPair, ConsistencyReport, DetectorOffset, GeometryReport, KeypointBias, KeypointReport,
    NoiseAtConfidence, Overlap, PenetrationReport, PersonReport, Quality, Report, ScaleReport, StageReport, Verdict,
};
use serde::{Deserialize, Serialize};

/// One camera of the result.
#[derive(Debug, Clone, PartialEq)]
pub struct SolvedCamera {
    /// `None`: the camera could not be placed (`unsolved`).
    pub camera_from_world: Option<Rigid>,
    /// Mean and median distance of explained keypoints to their reprojection, px.
    pub reprojection_px: Option<ErrorSummary>,
    /// Keypoints used.
    pub n_observations: usize,
    /// Standard deviation of the centre, mm, after a similarity alignment, scale apart.
    pub sigma_position_mm: Option<f64>,
    /// Standard deviation of the orientation, degrees.
    pub sigma_angle_deg: Option<f64>,
    /// When its frames were taken, where that is not simply what their numbers say.
    pub time_offset: Option<TimeOffset>,
    /// What its focal lengths were multiplied by, where they were refined.
    pub focal_factor: Option<FocalFactor>,
}

impl SolvedCamera {
    /// The lens that the pose holds for, from the one that the session gives.
    pub fn lens(&self, given: &Intrinsics) -> Intrinsics {
        self.focal_factor.map_or(*given, |factor| given.with_focal_factor(factor.value))
    }
}

/// Everything a run found out.
#[derive(Debug, Clone, PartialEq)]
pub struct Reconstruction {
    /// In the order of the session's views.
    pub cameras: Vec<SolvedCamera>,
    /// Best estimate of the detector's points, per person.
    pub keypoints: Vec<JointTrajectory>,
    /// SMPL-convention motion, per person, same order.
    pub motions: Vec<BodyMotion>,
    /// `identities[view][frame][detection]`: whom each detection was given to.
    pub identities: Vec<Vec<Vec<Option<PersonId>>>>,
    /// Up axis of the result's world.
    pub up_axis: UpAxis,
    /// Name and digest of the body model behind `motions`.
    pub body_model: BodyModelId,
    /// What became of the detections; `None` where the consistency stage was switched off.
    pub repairs: Option<DetectionRepairs>,
    /// Figures and verdict.
    pub report: Report,
}

/// What the consistency stage made of the detections, against what came in.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DetectionRepairs {
    /// `[view][frame][detection]`: whom it would show if nothing were repaired, by the detector's own track id, or without
    /// one by association and tracking.
    pub identities_before: Vec<Vec<Vec<Option<PersonId>>>>,
    /// Detections whose keypoints were exchanged or rejected, in order of view, frame and detection.
    pub repaired: Vec<RepairedDetection>,
}

/// A detection of which not every keypoint stands for itself any more.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RepairedDetection {
    /// Index of its view.
    pub view: usize,
    /// Its frame.
    pub frame: FrameIndex,
    /// Its place among the frame's detections.
    pub detection: usize,
    /// For every named keypoint the one of the detection that shows it; `None`: rejected.
    pub sources: Vec<Option<usize>>,
}

/// Which body model the shape and pose parameters belong to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BodyModelId {
    /// Its name.
    pub name: String,
    /// Digest of its numbers.
    pub sha256: String,
}

/// A format that the result can be written in (`options.exports`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs)] // the names say it
pub enum ExportFormat {
    SmplNpz,
    Easymocap,
    Glb,
    Bvh,
    Usd,
    Trc,
    C3d,
    OpencvYaml,
    CalibToml,
    AniposeToml,
    Colmap,
    Chan,
    Blender,
}

impl ExportFormat {
    /// Every format, in the order of the contract.
    pub const ALL: [Self; 13] = [
        Self::SmplNpz,
        Self::Easymocap,
        Self::Glb,
        Self::Bvh,
        Self::Usd,
        Self::Trc,
        Self::C3d,
        Self::OpencvYaml,
        Self::CalibToml,
        Self::AniposeToml,
        Self::Colmap,
        Self::Chan,
        Self::Blender,
    ];
}
