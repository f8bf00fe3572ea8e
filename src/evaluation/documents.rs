//! Readers of the files that an evaluation needs: cameras, poses, identities, parts of the session. Lengths are metres after
//! reading.

use super::error::EvaluationError;
use super::person_matching::Frames;
use super::shelf14::{Point, Skeleton};
use crate::geometry::{Distortion, Intrinsics, Rigid};
use crate::session::formats::time::FrameRate;
use crate::session::json_file::read_json_file;
use crate::session::recording::UpAxis;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Deserializer};
use std::collections::BTreeMap;
use std::path::Path;

/// The parts of `session.json` that an evaluation needs.
#[derive(Debug, Clone, Deserialize)]
pub struct SessionDocument {
    /// Frames per second.
    #[serde(deserialize_with = "rate")]
    pub fps: f64,
    /// Up axis of the given world.
    pub up_axis: Option<UpAxis>,
    /// The cameras, in order.
    pub cameras: Vec<SessionCamera>,
}

/// A camera of `session.json`.
#[derive(Debug, Clone, Deserialize)]
pub struct SessionCamera {
    /// Its name.
    #[serde(deserialize_with = "text")]
    pub id: String,
    /// Image width, px.
    pub width: u32,
    /// Image height, px.
    pub height: u32,
    #[serde(rename = "K")]
    matrix: Option<[[f64; 3]; 3]>,
}

impl SessionCamera {
    /// The camera's intrinsics without distortion; `found`: K by camera of a result, which counts where the session gives none.
    ///
    /// # Errors
    /// [`EvaluationError::Lens`] where neither gives K.
    pub fn intrinsics(&self, found: &BTreeMap<String, [[f64; 3]; 3]>) -> Result<Intrinsics, EvaluationError> {
        let matrix = self.matrix.as_ref().or_else(|| found.get(&self.id));
        let matrix = matrix.ok_or_else(|| EvaluationError::Lens { camera: self.id.clone() })?;
        Ok(Intrinsics::from_matrix([self.width, self.height], matrix, Distortion::None))
    }
}

/// A file of poses or keypoints.
#[derive(Debug, Clone)]
pub struct PosesDocument {
    /// Skeleton of the joints.
    pub skeleton: Skeleton,
    /// Up axis, where the file states it.
    pub up_axis: Option<UpAxis>,
    /// All joints of all people; frames without people are left out.
    pub frames: Frames<Vec<Point>>,
}

/// `identities[camera][frame][detection]`: a person's name.
pub type Identities = BTreeMap<String, Vec<Vec<Option<String>>>>;

#[derive(Deserialize)]
#[serde(untagged)]
enum CamerasFile {
    List(Vec<PosedCamera>),
    Wrapped { cameras: Vec<PosedCamera> },
}

#[derive(Deserialize)]
struct PosedCamera {
    #[serde(deserialize_with = "text")]
    id: String,
    #[serde(rename = "R")]
    rotation: Option<[[f64; 3]; 3]>,
    #[serde(rename = "t")]
    translation: Option<[f64; 3]>,
    #[serde(default)]
    units: Unit,
    #[serde(rename = "K")]
    matrix: Option<[[f64; 3]; 3]>,
}

#[derive(Deserialize)]
struct PosesFile {
    #[serde(alias = "keypoint_names")]
    joint_names: Vec<String>,
    #[serde(default)]
    units: Unit,
    #[serde(alias = "up")]
    up_axis: Option<UpAxis>,
    frames: Frames<Vec<Option<[f64; 3]>>>,
}

#[derive(Deserialize, Default, Clone, Copy)]
#[serde(rename_all = "lowercase")]
enum Unit {
    #[default]
    M,
    Cm,
    Mm,
}

impl Unit {
    fn metres(self) -> f64 {
        match self {
            Self::M => 1.0,
            Self::Cm => 1e-2,
            Self::Mm => 1e-3,
        }
    }
}

/// Reads `camera_from_world` of every camera that has a pose, metres.
///
/// # Errors
/// [`EvaluationError`] where the file cannot be read.
pub fn read_cameras(path: &Path) -> Result<BTreeMap<String, Rigid>, EvaluationError> {
    let (CamerasFile::List(cameras) | CamerasFile::Wrapped { cameras }) = read_json_file(path)?;
    let posed = |camera: PosedCamera| {
        let translation = Vector3::from(camera.translation?) * camera.units.metres();
        Some((camera.id, Rigid { rotation: matrix(&camera.rotation?), translation }))
    };
    Ok(cameras.into_iter().filter_map(posed).collect())
}

/// Reads K of every camera that has one.
///
/// # Errors
/// [`EvaluationError`] where the file cannot be read.
pub fn read_matrices(path: &Path) -> Result<BTreeMap<String, [[f64; 3]; 3]>, EvaluationError> {
    let (CamerasFile::List(cameras) | CamerasFile::Wrapped { cameras }) = read_json_file(path)?;
    Ok(cameras.into_iter().filter_map(|camera| Some((camera.id, camera.matrix?))).collect())
}

/// Reads the poses of all people in all frames.
///
/// # Errors
/// [`EvaluationError`] where the file cannot be read, its joints are unknown, or a person has too few of them.
pub fn read_poses(path: &Path) -> Result<PosesDocument, EvaluationError> {
    let file: PosesFile = read_json_file(path)?;
    let skeleton = Skeleton::from_names(&file.joint_names)
        .ok_or_else(|| EvaluationError::UnknownJoints { path: path.to_owned(), names: file.joint_names.clone() })?;
    let metres = file.units.metres();
    let mut frames = Frames::new();
    for (frame, people) in file.frames.into_iter().filter(|(_, people)| !people.is_empty()) {
        let mut poses = BTreeMap::new();
        for (person, joints) in people {
            let (expected, found) = (file.joint_names.len(), joints.len());
            if expected != found {
                return Err(EvaluationError::Joints { path: path.to_owned(), frame, person, expected, found });
            }
            poses.insert(person, joints.into_iter().map(|joint| joint.map(|p| Vector3::from(p) * metres)).collect());
        }
        frames.insert(frame, poses);
    }
    Ok(PosesDocument { skeleton, up_axis: file.up_axis, frames })
}

/// Reads the person's name of every detection.
///
/// # Errors
/// [`EvaluationError`] where the file cannot be read.
pub fn read_identities(path: &Path) -> Result<Identities, EvaluationError> {
    let named: BTreeMap<String, Vec<Vec<Option<Name>>>> = read_json_file(path)?;
    let names = |detections: Vec<Option<Name>>| detections.into_iter().map(|name| name.map(|n| n.0)).collect();
    Ok(named.into_iter().map(|(camera, frames)| (camera, frames.into_iter().map(names).collect())).collect())
}

/// Reads the track numbers of every detection of a camera's `poses/<camera>.json`, frame by frame.
///
/// # Errors
/// [`EvaluationError`] where the file cannot be read.
pub fn read_track_ids(path: &Path) -> Result<Vec<Vec<Option<i64>>>, EvaluationError> {
    #[derive(Deserialize)]
    struct File {
        frames: Vec<Frame>,
    }
    #[derive(Deserialize)]
    struct Frame {
        people: Vec<Person>,
    }
    #[derive(Deserialize)]
    struct Person {
        track_id: Option<i64>,
    }
    let file: File = read_json_file(path)?;
    Ok(file.frames.into_iter().map(|frame| frame.people.into_iter().map(|person| person.track_id).collect()).collect())
}

fn matrix(rows: &[[f64; 3]; 3]) -> Matrix3<f64> {
    Matrix3::from_fn(|row, column| rows[row][column])
}

/// A name, given as text or as a number.
struct Name(String);

impl<'de> Deserialize<'de> for Name {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        text(deserializer).map(Self)
    }
}

/// A frame rate as an upload may give it.
fn rate<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    FrameRate::deserialize(deserializer).map(|rate| rate.0)
}

fn text<'de, D: Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Either {
        Text(String),
        Number(i64),
    }
    Ok(match Either::deserialize(deserializer)? {
        Either::Text(text) => text,
        Either::Number(number) => number.to_string(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sessions that a solve accepts: cameras without K, and a rate as a ratio.
    #[test]
    fn sessions_without_k_could_not_be_evaluated() {
        let text = r#"{"fps": "30000/1001", "cameras": [{"id": "a", "width": 640, "height": 480}]}"#;
        let session: SessionDocument = serde_json::from_str(text).unwrap();
        assert_eq!(session.fps, 30000.0 / 1001.0);
        let error = session.cameras[0].intrinsics(&BTreeMap::new()).unwrap_err().to_string();
        assert!(error.starts_with("camera a: ") && error.contains("add K"), "{error}");
        let found = [("a".to_owned(), [[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])].into();
        assert_eq!(session.cameras[0].intrinsics(&found).unwrap().fx, 500.0);
    }
}
