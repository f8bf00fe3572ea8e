//! `report.json`: what each stage did, how accurate the result is, and what a user must know before using it.

use super::estimates::{ErrorSummary, SigmaSummary, TimeOffset};
use crate::body::dense_landmarks::DenseLandmarks;
use crate::body::hand::Side;
use crate::body::measures::BodyMeasures;
use crate::body::skeleton::KeypointConvention;
use crate::session::suspicion::Suspicion;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Report of one stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageReport {
    /// The stage's name.
    pub stage: String,
    /// Iterations of its solver, where it has one.
    pub iterations: usize,
    /// Cost of the objective before the stage, where it has one.
    pub cost_before: Option<f64>,
    /// Cost of the objective after the stage.
    pub cost_after: Option<f64>,
    /// Why the solver stopped.
    pub termination: String,
    /// Further statistics by name; the name contains the unit.
    pub metrics: BTreeMap<String, f64>,
}

impl StageReport {
    /// Report of a stage without an objective.
    pub fn new<'a>(
        stage: &str,
        iterations: usize,
        termination: &str,
        metrics: impl IntoIterator<Item = (&'a str, f64)>,
    ) -> Self {
        let metrics = metrics.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
        let (stage, termination) = (stage.to_owned(), termination.to_owned());
        Self { stage, iterations, cost_before: None, cost_after: None, termination, metrics }
    }
}

/// The metric scale and the measurements behind it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScaleReport {
    /// Factor applied to the solver's length unit, metres per unit.
    pub value: f64,
    /// 95 % interval of the factor; over `value` that of all lengths of the result.
    pub interval95: [f64; 2],
    /// One sentence.
    pub evidence: String,
}

/// Keypoint bias of the session's detector: constant offsets between its keypoints and the body's landmarks.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct KeypointBias {
    /// Whether the body fit applied offsets of hips or shoulders: where a bias is likelier than people's own proportions, and no
    /// larger than detectors are known to have. Offsets of face and feet always apply.
    pub applied: bool,
    /// Why the offsets were applied or not, one sentence.
    pub reason: String,
    /// By kind of keypoint.
    pub offsets: Vec<DetectorOffset>,
}

/// Offset of one kind of keypoint from the body's landmark.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DetectorOffset {
    /// The keypoint's name without its side.
    pub keypoint: String,
    /// The joint whose frame the offset is given in; of a pair the left one.
    pub bone: String,
    /// Offset in that frame in the rest pose (x: to the body's left, y: up, z: forward), mm; mirrored for the right side.
    pub offset_mm: [f64; 3],
    /// Standard deviations, mm; those of the prior where the motion does not determine the offset.
    pub sigma_mm: [f64; 3],
    /// Whether the body fit applied it.
    pub applied: bool,
}

/// Report of the consistency stage.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ConsistencyReport {
    /// Frames with ambiguous identities, which were solved jointly over all views.
    pub ambiguous_frames: usize,
    /// Statistics by camera and person; pairs without detections are left out.
    pub pairs: Vec<ConsistencyPair>,
    /// Standard deviation of the detector's error at each of its confidences, in ascending order of confidence; empty where
    /// there are too few detections.
    #[serde(default)]
    pub detector_noise: Vec<NoiseAtConfidence>,
}

/// Error of a detector at one of its confidences.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct NoiseAtConfidence {
    /// Confidence of the detector, 0 to 1.
    pub confidence: f64,
    /// Standard deviation per axis of the best visible points (face and feet), mm on the body.
    pub sigma_mm: f64,
}

/// Repairs of one person's detections in one camera.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ConsistencyPair {
    /// The camera's name.
    pub camera: String,
    /// The person.
    pub person: usize,
    /// Detections that were first assigned to the person, and then to another person or to none.
    pub rejected_detections: usize,
    /// Keypoints rejected because they contradict all other views.
    pub rejected_joints: usize,
    /// Detections with left and right exchanged.
    pub flips_undone: usize,
    /// First and last frame number of runs in which a track number that mostly belongs to another person was assigned to this
    /// person.
    pub swaps_repaired: Vec<[i64; 2]>,
}

/// Verdict on a result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// No problem was found.
    Pass,
    /// Inspect the result before using it.
    Warn,
    /// The result should not be used.
    Reject,
}

/// Verdict with reasons for the user.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Quality {
    /// The most severe verdict of all reasons.
    pub verdict: Verdict,
    /// One sentence each: what is wrong, by how much, what to do.
    pub reasons: Vec<String>,
}

/// Statistics of one person.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PersonReport {
    /// The person.
    pub id: usize,
    /// The name that a correction gives the person.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// First frame number.
    pub first_frame: i64,
    /// Last frame number.
    pub last_frame: i64,
    /// Number of detections assigned to the person.
    pub n_detections: usize,
    /// Reprojection error of the keypoints, px.
    pub reprojection_px: Option<ErrorSummary>,
    /// The same at the keypoints' depths, mm: `px * depth / focal`.
    pub reprojection_mm: Option<ErrorSummary>,
    /// Share of the track's frames with detections in at least two solved cameras, 0 to 1.
    #[serde(default)]
    pub share_in_two_views: f64,
    /// Standard deviation of the 3D keypoints, mm, from the views of a single frame and the uncertainty of the cameras (smoothness
    /// over time lowers it). `None` without two views of the person.
    pub sigma_mm: Option<SigmaSummary>,
    /// Standard deviation of the body's joints over all frames, mm, three axes together and apart from a similarity of the
    /// whole scene. `None` where the session does not show it.
    #[serde(default)]
    pub joint_sigma_mm: Option<SigmaSummary>,
    /// Stretches of frames in which the joints are uncertain, ascending.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub uncertain_frames: Vec<UncertainFrames>,
    /// Stature and mass of the fitted body; the sigmas include that of the scale. `None` in results of versions without it.
    #[serde(default)]
    pub body: Option<BodyMeasures>,
    /// Median angle between the rays to a keypoint, of the pair nearest to a right angle, 0 to 90 degrees.
    pub ray_angle_deg: Option<f64>,
    /// Median dilution of precision: standard deviation of a 3D keypoint divided by that of one ray; `sqrt(4.5 / n)` for `n`
    /// cameras all around, much larger where all rays are nearly parallel.
    pub dilution: Option<f64>,
    /// Statistics by kind of keypoint, in the order of the session's convention.
    #[serde(default)]
    pub keypoints: Vec<KeypointReport>,
    /// Relative standard deviation of bone lengths over time, mean over bones.
    pub bone_length_spread: Option<f64>,
    /// Mean joint acceleration, m/s^2.
    pub jitter_m_per_s2: Option<f64>,
    /// Statistics of the hands, where they were fitted.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub hands: Vec<HandReport>,
}

/// Successive frames of at least half a second in which half of a person's joints are uncertain by more than
/// [`BOUND_MM`](Self::BOUND_MM): mostly where a single camera shows the person, or none.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct UncertainFrames {
    /// First frame number.
    pub first_frame: i64,
    /// Last frame number.
    pub last_frame: i64,
    /// Median over frames and joints of the joints' standard deviation, mm, three axes together.
    pub joint_sigma_mm: f64,
    /// Cameras that show the person in more than half of the frames.
    pub cameras: Vec<String>,
}

impl UncertainFrames {
    /// Standard deviation of a point of the body from which poses are uncertain, mm: a bent arm looks like a straight one.
    pub const BOUND_MM: f64 = 80.0;
}

/// Statistics of one hand of one person.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HandReport {
    /// The hand.
    pub side: Side,
    /// Share of the person's frames in which at least two solved cameras saw the hand, 0 to 1.
    pub share_in_two_views: f64,
    /// Mean number of solved cameras that saw it.
    pub mean_views: f64,
    /// Median reprojection error of its points, px.
    pub reprojection_px: Option<f64>,
    /// Measured standard deviation of its points, as a share of the image of the hand.
    pub noise_of_size: f64,
    /// From the wrist to the tip of the middle finger, m; the same for both hands.
    pub size_m: f64,
}

/// Statistics of one kind of keypoint of one person.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KeypointReport {
    /// The keypoint's name.
    pub keypoint: String,
    /// Number of detected keypoints of at least 0.3 confidence in all views and frames.
    pub n_observations: usize,
    /// Share of them rejected as outliers of the reprojection, 0 to 1.
    pub rejected: f64,
    /// Reprojection error of the others, px.
    pub reprojection_px: Option<ErrorSummary>,
    /// The same at the keypoint's depth, mm: `px * depth / focal`.
    pub reprojection_mm: Option<ErrorSummary>,
    /// Standard deviation of the 3D point, mm, as of a person; `None` without two views of the keypoint.
    pub sigma_mm: Option<SigmaSummary>,
}

/// How well the views cover the people.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct GeometryReport {
    /// Root mean square distance of the people's positions from their mean, m.
    pub people_spread_m: Option<f64>,
    /// Median over all keypoints, as of a person.
    pub ray_angle_deg: Option<f64>,
    /// Median over all keypoints, as of a person.
    pub dilution: Option<f64>,
}

/// Statistics of one camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraReport {
    /// The camera's name.
    pub id: String,
    /// Whether its pose was solved.
    pub solved: bool,
    /// Whether a correction leaves it out.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub excluded: bool,
    /// Number of detections in its frames.
    pub n_detections: usize,
    /// Number of detections assigned to no person.
    pub n_rejected_detections: usize,
    /// Detections of no person of the result that stay at one place.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub still_detections: Vec<StillDetections>,
    /// Reprojection error, px.
    pub reprojection_px: Option<ErrorSummary>,
    /// The same at the keypoints' depths, mm: `px * depth / focal`.
    pub reprojection_mm: Option<ErrorSummary>,
    /// Share of the keypoints of its assigned detections rejected as outliers of the reprojection, 0 to 1.
    #[serde(default)]
    pub rejected_keypoints: f64,
    /// Time offset, where it differs from 0 or was estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_offset: Option<TimeOffset>,
}

/// Detections of a camera that show no person of the result and stay at one place for five seconds and longer: a picture, a mannequin,
/// a mirror image, or a person who sits still where no other camera looks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StillDetections {
    /// Number of detections.
    pub n_detections: usize,
    /// Frame number of the first one.
    pub first_frame: i64,
    /// Frame number of the last one.
    pub last_frame: i64,
    /// Middle of the first one, px.
    pub pixel: [f64; 2],
}

/// Content of `report.json`. Contains no wall-clock times: the same input gives the same bytes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Stages, in order of execution.
    pub stages: Vec<StageReport>,
    /// Per camera, in the session's order.
    pub cameras: Vec<CameraReport>,
    /// Per person.
    pub people: Vec<PersonReport>,
    /// How well the views cover the people.
    #[serde(default)]
    pub geometry: GeometryReport,
    /// Reprojection error of cameras solved from every other block of frames, evaluated on the remaining frames, px.
    pub heldout_px: Option<f64>,
    /// Metric scale.
    pub scale: Option<ScaleReport>,
    /// The table of landmarks that the session brought; `None` where its keypoints are those of a convention.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub landmarks: Option<LandmarkTableId>,
    /// Keypoint bias of the detector.
    #[serde(default)]
    pub detector: KeypointBias,
    /// Report of the consistency stage; `None` where it is switched off.
    pub consistency: Option<ConsistencyReport>,
    /// How far people's bodies reach into each other.
    #[serde(default)]
    pub penetration: PenetrationReport,
    /// Share of detections assigned to no person, 0 to 1.
    pub rejected_detections: f64,
    /// Source of `keypoints3d.json`: adjusted points or body landmarks.
    pub keypoints_from: String,
    /// Probable mistakes in the files of the recording, found before the solve and on its result.
    #[serde(default)]
    pub suspicions: Vec<Suspicion>,
    /// Verdict and reasons.
    pub quality: Quality,
}

/// A table of landmarks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LandmarkTableId {
    /// Its name.
    pub name: String,
    /// The convention whose points are among its own.
    pub base: String,
    /// Number of points beyond these.
    pub n_dense: usize,
    /// SHA-256 digest of its names and numbers.
    pub sha256: String,
}

impl LandmarkTableId {
    /// Of a session's dense landmarks.
    pub fn of(dense: &DenseLandmarks, base: KeypointConvention) -> Self {
        let (name, sha256) = (dense.name.clone(), dense.sha256.clone());
        Self { name, base: base.name().to_owned(), n_dense: dense.landmarks.len(), sha256 }
    }
}

/// Overlaps between people's bodies, measured with 21 capsules per body.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct PenetrationReport {
    /// The deepest overlap of the result; `None` where no bodies touch.
    pub deepest: Option<Overlap>,
    /// The deepest overlap before collision resolution; `None` where none was deeper than 10 mm, or `collision` is off.
    pub deepest_before: Option<Overlap>,
    /// Number of person-frames with an overlap of more than 10 mm.
    pub person_frames: usize,
}

/// An overlap of two bodies in one frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Overlap {
    /// Depth of the overlap of their capsules, mm.
    pub depth_mm: f64,
    /// Frame number.
    pub frame: i64,
    /// The two people.
    pub people: [usize; 2],
    /// SMPL names of the joints that the two capsules belong to.
    pub joints: [String; 2],
}
