//! Why a result cannot be evaluated.

use crate::session::json_file::JsonFileError;
use std::path::PathBuf;

/// Why a result cannot be evaluated.
#[derive(Debug, thiserror::Error)]
pub enum EvaluationError {
    /// A file cannot be read, or is not the expected JSON.
    #[error(transparent)]
    File(#[from] JsonFileError),
    /// The joint names of a file belong to no known skeleton.
    #[error("{}: unknown joint names, starting with {:?}; expected the names of a keypoint convention or of Shelf", path.display(), names.first())]
    UnknownJoints {
        /// The file.
        path: PathBuf,
        /// The joint names in the file.
        names: Vec<String>,
    },
    /// A person has a wrong number of joints.
    #[error("{}: frame {frame}, person {person}: {expected} joints expected, found {found}", path.display())]
    Joints {
        /// The file.
        path: PathBuf,
        /// The frame.
        frame: i64,
        /// The person.
        person: String,
        /// Number of joints that the file names.
        expected: usize,
        /// Number of joints of the person.
        found: usize,
    },
    /// The number of identities differs from the number of detections.
    #[error("camera {camera}, frame entry {frame}: {expected} identities expected, found {found}")]
    Identities {
        /// The camera.
        camera: String,
        /// Index of the frame in the camera's file.
        frame: usize,
        /// Number of detections in the session.
        expected: usize,
        /// Number of identities found.
        found: usize,
    },
    /// A camera without K, which its errors in pixels need.
    #[error(
        "camera {camera}: neither session.json nor cameras.json of the result gives its K, which its error in pixels needs; add K to one of them"
    )]
    Lens {
        /// The camera.
        camera: String,
    },
    /// A person to average over that the truth does not have.
    #[error("the truth has no person {person:?}; its people are {}", known.join(", "))]
    Actor {
        /// The name of the person.
        person: String,
        /// The people of the truth.
        known: Vec<String>,
    },
    /// The result contains nothing that can be compared.
    #[error("{}: the folder contains none of cameras.json, keypoints3d.json, poses3d.json and identities.json", result.display())]
    Nothing {
        /// The folder.
        result: PathBuf,
    },
}
