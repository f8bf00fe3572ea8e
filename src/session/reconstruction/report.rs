//! `report.json`: what happened, how good the result is, and what a user must know before trusting it.

use super::estimates::{ErrorSummary, SigmaSummary, TimeOffset};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

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
pub struct KeypointBias {
    /// Whether the joints were fitted with these offsets. They are not where unusual skeletons explain the session
    /// better, or where an offset is larger than any detector's habit: then it is the body that does not fit. Points of face
    /// and feet always are.
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
    /// Whether the bodies were fitted with it.
    pub applied: bool,
}

/// What the consistency stage did.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ConsistencyReport {
    /// Frames that left a choice of who is who and were solved as a whole.
    pub ambiguous_frames: usize,
    /// By camera and person; pairs of whom nothing was seen are left out.
    pub pairs: Vec<ConsistencyPair>,
    /// How far the detector errs at its own confidences, from low to high; empty where too little was seen to tell.
    #[serde(default)]
    pub detector_noise: Vec<NoiseAtConfidence>,
}

/// A detector's error at one of its confidences.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct NoiseAtConfidence {
    /// What the detector says, 0 to 1.
    pub confidence: f64,
    /// Standard deviation per axis of the points that are seen best (face and feet), mm on the body.
    pub sigma_mm: f64,
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
    /// The same at the keypoints' depths, mm: `px * depth / focal`.
    #[serde(default)]
    pub reprojection_mm: Option<ErrorSummary>,
    /// Share of the track's frames in which at least two placed cameras saw the person.
    #[serde(default)]
    pub share_in_two_views: f64,
    /// Standard deviation of the keypoints in space, mm: what the views of one frame tell, under exact cameras; smoothness
    /// over time makes it less. `None` where no two views saw the person.
    #[serde(default)]
    pub sigma_mm: Option<SigmaSummary>,
    /// Median angle under which the rays to a keypoint cross, of the pair nearest to a right angle, 0 to 90 degrees.
    #[serde(default)]
    pub ray_angle_deg: Option<f64>,
    /// Median conditioning: standard deviation of a keypoint in space over that of one ray; `sqrt(4.5 / n)` for `n` cameras
    /// all around, far more where all rays run nearly along one line.
    #[serde(default)]
    pub dilution: Option<f64>,
    /// By kind of keypoint, in the session's convention.
    #[serde(default)]
    pub keypoints: Vec<KeypointReport>,
    /// Relative standard deviation of bone lengths over time, mean over bones.
    pub bone_length_spread: Option<f64>,
    /// Mean joint acceleration, m/s^2.
    pub jitter_m_per_s2: Option<f64>,
}

/// Figures of one kind of keypoint of one person.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KeypointReport {
    /// The keypoint's name.
    pub keypoint: String,
    /// Sightings in all views and frames, of at least 0.3 confidence.
    pub n_observations: usize,
    /// Share of them that lie too far from the reprojection to be of this point, 0 to 1.
    pub rejected: f64,
    /// Reprojection error of the others, px.
    pub reprojection_px: Option<ErrorSummary>,
    /// The same at the keypoint's depth, mm: `px * depth / focal`.
    pub reprojection_mm: Option<ErrorSummary>,
    /// Standard deviation in space, mm, as that of the person; `None` where no two views saw the keypoint.
    pub sigma_mm: Option<SigmaSummary>,
}

/// How well the views cover the people.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct GeometryReport {
    /// How far people go: root mean square distance of their places from the mean of all, m.
    pub people_spread_m: Option<f64>,
    /// Median over all keypoints, as of a person.
    pub ray_angle_deg: Option<f64>,
    /// Median over all keypoints, as of a person.
    pub dilution: Option<f64>,
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
    /// The same at the keypoints' depths, mm: `px * depth / focal`.
    #[serde(default)]
    pub reprojection_mm: Option<ErrorSummary>,
    /// Share of the keypoints of its given detections that lie too far from the reprojection, 0 to 1.
    #[serde(default)]
    pub rejected_keypoints: f64,
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
    /// How well the views cover the people.
    #[serde(default)]
    pub geometry: GeometryReport,
    /// Error of cameras from every other block of frames, judged on the rest, px.
    pub heldout_px: Option<f64>,
    /// Metric scale.
    pub scale: Option<ScaleReport>,
    /// What the detector means by its keypoints, against the body.
    #[serde(default)]
    pub detector: KeypointBias,
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
