//! Evaluation of one result against one ground truth, as a table and as JSON. An independent reference scorer gives the same
//! numbers.

use super::alignment::Alignment;
use super::camera_error::{
    CameraErrors, CameraPair, RelativeCameraError, camera_errors, relative_camera_error, truth_from_pairs,
};
use super::documents::{self, PosesDocument, SessionDocument};
use super::error::EvaluationError;
use super::identity_error::{IdentityError, IdentityRow, identity_error};
use super::jitter::{Jitter, acceleration_error, jitter};
use super::joint_error::{Mpjpe, Pcp, mpjpe, pcp};
use super::person_matching::{Frames, Matching};
use super::shelf14::{Point, Shelf14, Skeleton, to_shelf14};
use super::world_error::{WorldError, world_error};
use crate::body::skeleton::KeypointConvention;
use crate::geometry::Similarity;
use crate::session::json_file::{JsonFileError, read_json_file};
use crate::session::recording::UpAxis;
use nalgebra::Vector3;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Options of an evaluation.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct EvaluationOptions {
    /// Alignment of the result's world to the truth's before poses are compared. `None`: rigid by the camera centres; by
    /// orientations too where fewer than three cameras are solved; no alignment without cameras.
    pub align: Option<Alignment>,
    /// Up axis of the truth's world. `None`: as stated in its files, else z.
    pub up: Option<UpAxis>,
    /// People that averages include. `None`: all; on Shelf truth the three actors of the literature.
    pub actors: Option<Vec<String>>,
}

/// All errors of a result.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Evaluation {
    /// The session's folder.
    pub data: PathBuf,
    /// Camera errors under three alignments.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cameras: Option<AlignedCameras>,
    /// Camera errors that need no alignment.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cameras_relative: Option<RelativeCameraError>,
    /// Of the world, where both state which axis is up.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub world: Option<WorldError>,
    /// Errors of the file of poses whose joints are most similar to the truth's.
    #[serde(flatten)]
    pub poses: Option<PoseErrors>,
    /// Errors of the result's other file of poses.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub other_poses: Option<PoseErrors>,
    /// Errors of identities.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub identity: Option<IdentityError>,
}

/// Camera errors under three alignments.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AlignedCameras {
    /// [`Alignment::Rigid`].
    pub rigid: CameraErrors,
    /// [`Alignment::Sim3`].
    pub sim3: CameraErrors,
    /// [`Alignment::RigidPose`].
    pub rigid_pose: CameraErrors,
}

/// Errors of one file of poses.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PoseErrors {
    /// The file.
    pub joints_from: &'static str,
    /// Mean accelerations.
    pub jitter: Jitters,
    /// PCP, nearest person.
    pub pcp: Pcp,
    /// PCP, one to one.
    pub pcp_one2one: Pcp,
    /// MPJPE.
    pub mpjpe: Mpjpe,
}

/// Mean accelerations of result and truth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Jitters {
    /// Of the result.
    pub pred: Jitter,
    /// Of the truth.
    pub gt: Jitter,
    /// Mean distance of the two accelerations, 14 joints, mm per frame squared.
    pub error_mm_per_frame2: Option<f64>,
}

const POSES: &str = "poses3d.json";
const KEYPOINTS: &str = "keypoints3d.json";
/// The actors that publications average over.
const SHELF_ACTORS: [&str; 3] = ["0", "1", "2"];

/// Compares a result folder with a truth folder (`…/gt`) inside the session's folder.
///
/// Reads `cameras.json`, `keypoints3d.json`, `poses3d.json` and `identities.json`, as far as both folders contain the
/// necessary files.
///
/// # Errors
/// [`EvaluationError`] where a file cannot be read or contradicts the session.
pub fn evaluate(result: &Path, truth: &Path, options: &EvaluationOptions) -> Result<Evaluation, EvaluationError> {
    let data = truth.join("..");
    let data = data.canonicalize().map_err(|source| JsonFileError::Read { path: data.clone(), source })?;
    let session: SessionDocument = read_json_file(&data.join("session.json"))?;
    let true_poses = documents::read_poses(&truth.join(POSES))?;
    let pairs = match existing(result, "cameras.json") {
        Some(path) => camera_pairs(&session, &path, &truth.join("cameras.json"))?,
        None => Vec::new(),
    };
    let truth_from_result = world_alignment(&pairs, options.align);
    let comparison = PoseComparison::new(&session, &true_poses, options)?;
    let (mut poses, mut up_axis) = (Vec::new(), None);
    for name in comparison.files_in_order() {
        if let Some(path) = existing(result, name) {
            let found = documents::read_poses(&path)?;
            up_axis = up_axis.or(found.up_axis);
            poses.push(comparison.errors(name, &found, &truth_from_result));
        }
    }
    let identity = match (existing(result, "identities.json"), existing(truth, "identities.json")) {
        (Some(given), Some(truth)) => Some(identity_error(&identity_rows(&data, &session, &given, &truth)?)),
        _ => None,
    };
    if pairs.is_empty() && poses.is_empty() && identity.is_none() {
        return Err(EvaluationError::Nothing { result: result.to_owned() });
    }
    let mut poses = poses.into_iter();
    let ups = up_axis.zip(true_poses.up_axis);
    let world = ups.and_then(|(found, truth)| world_error(&pairs, found, truth));
    Ok(Evaluation {
        data,
        cameras: (!pairs.is_empty()).then(|| aligned_cameras(&pairs, &true_poses)),
        cameras_relative: relative_camera_error(&pairs),
        world,
        poses: poses.next(),
        other_poses: poses.next(),
        identity,
    })
}

fn existing(folder: &Path, name: &str) -> Option<PathBuf> {
    let path = folder.join(name);
    path.is_file().then_some(path)
}

/// The solved cameras, in the session's order.
fn camera_pairs(session: &SessionDocument, result: &Path, truth: &Path) -> Result<Vec<CameraPair>, EvaluationError> {
    let lenses = documents::read_matrices(result)?;
    let (solved, truth) = (documents::read_cameras(result)?, documents::read_cameras(truth)?);
    let pair = |camera: &documents::SessionCamera| {
        let (solved, truth) = (*solved.get(&camera.id)?, *truth.get(&camera.id)?);
        let with_lens = |intrinsics| CameraPair { id: camera.id.clone(), intrinsics, truth, solved };
        Some(camera.intrinsics(&lenses).map(with_lens))
    };
    session.cameras.iter().filter_map(pair).collect()
}

fn aligned_cameras(pairs: &[CameraPair], truth: &PosesDocument) -> AlignedCameras {
    let points: Vec<Vector3<f64>> =
        truth.frames.values().flat_map(BTreeMap::values).flatten().copied().flatten().collect();
    let errors = |alignment| camera_errors(pairs, &points, alignment);
    AlignedCameras {
        rigid: errors(Alignment::Rigid),
        sim3: errors(Alignment::Sim3),
        rigid_pose: errors(Alignment::RigidPose),
    }
}

fn world_alignment(pairs: &[CameraPair], requested: Option<Alignment>) -> Similarity {
    let default = match pairs.len() {
        0 => Alignment::None,
        1 | 2 => Alignment::RigidPose,
        _ => Alignment::Rigid,
    };
    truth_from_pairs(pairs, requested.unwrap_or(default))
}

/// True poses, converted for the comparison.
struct PoseComparison<'a> {
    truth: &'a PosesDocument,
    true_shelf: Frames<Shelf14>,
    actors: Vec<String>,
    up: Vector3<f64>,
    fps: f64,
}

impl<'a> PoseComparison<'a> {
    fn new(
        session: &SessionDocument,
        truth: &'a PosesDocument,
        options: &EvaluationOptions,
    ) -> Result<Self, EvaluationError> {
        let up = options.up.or(truth.up_axis).or(session.up_axis).unwrap_or(UpAxis::Z).direction();
        let all: BTreeSet<&String> = truth.frames.values().flat_map(BTreeMap::keys).collect();
        let all: Vec<String> = all.into_iter().cloned().collect();
        if let Some(person) = options.actors.iter().flatten().find(|person| !all.contains(person)) {
            return Err(EvaluationError::Actor { person: person.clone(), known: all });
        }
        let default = || match truth.skeleton {
            Skeleton::Shelf => SHELF_ACTORS.map(str::to_owned).to_vec(),
            Skeleton::Keypoints(_) => all,
        };
        Ok(Self {
            true_shelf: shelf_frames(&truth.frames, truth.skeleton, &up),
            actors: options.actors.clone().unwrap_or_else(default),
            truth,
            up,
            fps: session.fps,
        })
    }

    /// Files of poses, the one most similar to the truth first: SMPL joints for SMPL truth, keypoints for annotated truth.
    fn files_in_order(&self) -> [&'static str; 2] {
        match self.truth.skeleton {
            Skeleton::Keypoints(KeypointConvention::Smpl24) => [POSES, KEYPOINTS],
            _ => [KEYPOINTS, POSES],
        }
    }

    fn errors(&self, joints_from: &'static str, solved: &PosesDocument, truth_from_result: &Similarity) -> PoseErrors {
        let mut frames = solved.frames.clone();
        for point in frames.values_mut().flat_map(BTreeMap::values_mut).flatten().flatten() {
            *point = truth_from_result.transform(point);
        }
        let shelf = shelf_frames(&frames, solved.skeleton, &self.up);
        PoseErrors {
            joints_from,
            jitter: Jitters {
                pred: jitter(&frames, self.fps),
                gt: jitter(&self.truth.frames, self.fps),
                error_mm_per_frame2: acceleration_error(&self.true_shelf, &shelf, &self.actors),
            },
            pcp: pcp(&self.true_shelf, &shelf, &self.actors, Matching::Nearest),
            pcp_one2one: pcp(&self.true_shelf, &shelf, &self.actors, Matching::One2one),
            mpjpe: mpjpe(&self.true_shelf, &shelf, &self.actors),
        }
    }
}

fn shelf_frames(frames: &Frames<Vec<Point>>, skeleton: Skeleton, up: &Vector3<f64>) -> Frames<Shelf14> {
    let people = |people: &BTreeMap<String, Vec<Point>>| {
        people.iter().map(|(name, points)| (name.clone(), to_shelf14(points, skeleton, up))).collect()
    };
    frames.iter().map(|(frame, of_frame)| (*frame, people(of_frame))).collect()
}

fn identity_rows(
    data: &Path,
    session: &SessionDocument,
    given: &Path,
    truth: &Path,
) -> Result<Vec<IdentityRow>, EvaluationError> {
    let given = documents::read_identities(given)?;
    let truth: BTreeMap<String, Vec<Vec<Option<i64>>>> = read_json_file(truth)?;
    let (no_given, no_truth) = (Vec::new(), Vec::new());
    let mut rows = Vec::new();
    for camera in session.cameras.iter().map(|camera| &camera.id) {
        let track_ids = documents::read_track_ids(&data.join("poses").join(format!("{camera}.json")))?;
        let (given, truth) = (given.get(camera).unwrap_or(&no_given), truth.get(camera).unwrap_or(&no_truth));
        for (frame, track_ids) in track_ids.iter().enumerate() {
            let expected = track_ids.len();
            let fits = |found: Option<usize>| match found.unwrap_or(0) {
                found if found == expected => Ok(()),
                found => Err(EvaluationError::Identities { camera: camera.clone(), frame, expected, found }),
            };
            fits(given.get(frame).map(Vec::len))?;
            fits(truth.get(frame).map(Vec::len))?;
            for (detection, track_id) in track_ids.iter().enumerate() {
                let (truth, given) = (truth[frame][detection], given[frame][detection].clone());
                rows.push(IdentityRow { truth, given, track_id: *track_id });
            }
        }
    }
    Ok(rows)
}
