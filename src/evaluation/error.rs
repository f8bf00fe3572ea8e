//! Why a result cannot be evaluated.

use crate::session::json_file::JsonFileError;
use std::path::PathBuf;

/// Why a result cannot be evaluated.
#[derive(Debug, thiserror::Error)]
pub enum EvaluationError {
    /// A file cannot be read, or is not the expected JSON.
    #[error(transparent)]
    File(#[from] JsonFileError),
    /// The joints of a file are none of ours.
    #[error("{}: unknown joint names, beginning {:?}", path.display(), names.first())]
    UnknownJoints {
        /// The file.
        path: PathBuf,
        /// Its joints.
        names: Vec<String>,
    },
    /// A person has too few or too many joints.
    #[error("{}: frame {frame}, person {person}: {expected} joints expected, found {found}", path.display())]
    Joints {
        /// The file.
        path: PathBuf,
        /// The frame.
        frame: i64,
        /// The person.
        person: String,
        /// Joints that the file names.
        expected: usize,
        /// Joints that the person has.
        found: usize,
    },
    /// Identities do not fit the session's detections.
    #[error("camera {camera}, frame entry {frame}: {expected} identities expected, found {found}")]
    Identities {
        /// The camera.
        camera: String,
        /// Position of the frame in the camera's file.
        frame: usize,
        /// Detections of the session.
        expected: usize,
        /// Identities given.
        found: usize,
    },
    /// The result holds nothing that can be compared.
    #[error("{}: cameras.json, keypoints3d.json, poses3d.json or identities.json expected", result.display())]
    Nothing {
        /// The folder.
        result: PathBuf,
    },
}
