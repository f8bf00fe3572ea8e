//! The result: posed cameras, people, motions, quality figures. Serialised by `export`.

use super::people::{BodyMotion, JointTrajectory};
use super::recording::{FrameIndex, PersonId, UpAxis};
use crate::geometry::{Intrinsics, Rigid};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

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

/// A factor on both focal lengths of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FocalFactor {
    /// Refined over given.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// When a camera's frames were taken: frame number `n` at `n / fps + secs`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TimeOffset {
    /// s; that of the reference camera is as the session gives it, mostly 0.
    pub secs: f64,
    /// Its standard deviation against the reference camera, s; `None` where it was given or could not be found.
    pub sigma_secs: Option<f64>,
}

/// Mean and median of a set of errors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ErrorSummary {
    /// Arithmetic mean.
    pub mean: f64,
    /// Median.
    pub median: f64,
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
    pub cleaning: Option<Cleaning>,
    /// Figures and verdict.
    pub report: Report,
}

/// What the consistency stage made of the detections, against what came in.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Cleaning {
    /// `[view][frame][detection]`: whom it would show if nothing were repaired, by the detector's own track id, or without
    /// one by association and tracking.
    pub identities_before: Vec<Vec<Vec<Option<PersonId>>>>,
    /// Detections whose keypoints were exchanged or rejected, in order of view, frame and detection.
    pub mended: Vec<MendedDetection>,
}

/// A detection of which not every keypoint stands for itself any more.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MendedDetection {
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

/// What happened in one stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageReport {
    /// The stage's name.
    pub stage: String,
    /// Iterations of its solver, where it has one.
    pub iterations: usize,
    /// Cost before.
    pub cost_before: Option<f64>,
    /// Cost after.
    pub cost_after: Option<f64>,
    /// Why it stopped.
    pub termination: String,
    /// Further figures by name; the unit is in the name.
    pub metrics: BTreeMap<String, f64>,
}

/// The metric scale and what it rests on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScaleReport {
    /// Factor applied to the cameras' own unit.
    pub value: f64,
    /// Where the true factor lies with 95 % certainty.
    pub interval95: [f64; 2],
    /// One sentence.
    pub evidence: String,
}

/// What the session's detector means by its keypoints, against the body.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct DetectorHabits {
    /// Whether the bodies were fitted with these offsets. They are not where unusual skeletons explain the session
    /// better, or where an offset is larger than any detector's habit: then it is the body that does not fit.
    pub applied: bool,
    /// One sentence: why, or why not.
    pub reason: String,
    /// By kind of keypoint.
    pub offsets: Vec<DetectorOffset>,
}

/// How far the session's detector places one kind of keypoint from the body's own point.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DetectorOffset {
    /// The keypoint's name without its side.
    pub keypoint: String,
    /// The joint whose frame carries the offset; of a pair the left one.
    pub bone: String,
    /// In that frame at rest (x: to the body's left, y: up, z: forward), mm; mirrored for the right side.
    pub offset_mm: [f64; 3],
    /// Standard deviations, mm; that of the prior where the motion tells nothing.
    pub sigma_mm: [f64; 3],
}

/// What the consistency stage did.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ConsistencyReport {
    /// Frames that left a choice of who is who and were solved as a whole.
    pub ambiguous_frames: usize,
    /// By camera and person; pairs of whom nothing was seen are left out.
    pub pairs: Vec<ConsistencyPair>,
}

/// What was done to one person's detections in one camera.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ConsistencyPair {
    /// The camera's name.
    pub camera: String,
    /// Who.
    pub person: usize,
    /// Detections taken from the person again, for another person or for nobody.
    pub rejected_detections: usize,
    /// Keypoints that contradicted all other views.
    pub rejected_joints: usize,
    /// Detections whose left and right were exchanged.
    pub flips_undone: usize,
    /// First and last frame (the session's numbers) of runs in which a track id of the camera that mostly names somebody
    /// else named this person.
    pub swaps_repaired: Vec<[i64; 2]>,
}

/// The verdict over a result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Trust it.
    Pass,
    /// Look before use.
    Warn,
    /// Do not use.
    Reject,
}

/// Verdict with reasons that a user can act on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Quality {
    /// The worst of all reasons.
    pub verdict: Verdict,
    /// One sentence each: what, how much, what to do.
    pub reasons: Vec<String>,
}

/// Figures of one person.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PersonReport {
    /// Who.
    pub id: usize,
    /// First frame, in the session's numbers.
    pub first_frame: i64,
    /// Last frame, in the session's numbers.
    pub last_frame: i64,
    /// Detections given to the person.
    pub n_detections: usize,
    /// Reprojection error of the keypoints, px.
    pub reprojection_px: Option<ErrorSummary>,
    /// Relative standard deviation of bone lengths over time, mean over bones.
    pub bone_length_spread: Option<f64>,
    /// Mean joint acceleration, m/s^2.
    pub jitter_m_per_s2: Option<f64>,
}

/// Figures of one camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraReport {
    /// The camera's name.
    pub id: String,
    /// Whether it was placed.
    pub solved: bool,
    /// Detections in its frames.
    pub n_detections: usize,
    /// Detections given to nobody.
    pub n_rejected_detections: usize,
    /// Reprojection error, px.
    pub reprojection_px: Option<ErrorSummary>,
    /// When its frames were taken, where that is not simply what their numbers say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_offset: Option<TimeOffset>,
}

/// `report.json`. Holds no wall time: the same input gives the same bytes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// In order of running.
    pub stages: Vec<StageReport>,
    /// Per camera, in the session's order.
    pub cameras: Vec<CameraReport>,
    /// Per person.
    pub people: Vec<PersonReport>,
    /// Error of cameras from every other block of frames, judged on the rest, px.
    pub heldout_px: Option<f64>,
    /// Metric scale.
    pub scale: Option<ScaleReport>,
    /// What the detector means by its keypoints, against the body.
    #[serde(default)]
    pub detector: DetectorHabits,
    /// What the consistency stage did; `None` where it was switched off.
    #[serde(default)]
    pub consistency: Option<ConsistencyReport>,
    /// How far people's bodies reach into each other.
    #[serde(default)]
    pub penetration: PenetrationReport,
    /// Share of detections given to nobody.
    pub rejected_detections: f64,
    /// What `keypoints3d.json` holds: adjusted points or body landmarks.
    pub keypoints_from: String,
    /// Verdict and reasons.
    pub quality: Quality,
}

/// How far people's bodies reach into each other, as 21 capsules a body tell.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct PenetrationReport {
    /// The deepest overlap of the result; `None` where nobody touches anybody.
    pub deepest: Option<Overlap>,
    /// The same before people gave way; `None` where nothing was deeper than 10 mm, or `collision` was off.
    pub deepest_before: Option<Overlap>,
    /// Frames of a person with an overlap of more than 10 mm, summed over people.
    pub person_frames: usize,
}

/// Two bodies at one time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Overlap {
    /// How far their capsules reach into each other, mm.
    pub depth_mm: f64,
    /// The session's frame number.
    pub frame: i64,
    /// Who.
    pub people: [usize; 2],
    /// The joints that carry the two capsules, SMPL's names.
    pub joints: [String; 2],
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
