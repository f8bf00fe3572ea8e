//! A session as a reader produces it: typed and within limits, but not yet checked for consistency.

use super::json::{Numbers, Rows, ShortList};
use crate::body::dense_landmarks::StatedLandmark;
use crate::session::formats::rows;
use crate::session::recording::Detection;
use nalgebra::Matrix3;
use std::collections::BTreeMap;

/// A session as written, to be checked by [`assemble`](super::assemble).
#[derive(Debug, Clone, Default)]
pub(crate) struct RawSession {
    /// The file with these values, for messages.
    pub file: String,
    pub name: String,
    pub fps: f64,
    pub first_frame: i64,
    pub n_frames: Option<u64>,
    pub keypoint_convention: String,
    /// The keypoints as a table of landmarks, in place of a convention.
    pub landmarks: Option<Vec<StatedLandmark>>,
    pub up_axis: Option<String>,
    pub start_timecode: Option<String>,
    pub cameras: Vec<RawCamera>,
    /// Poses by camera id.
    pub poses: BTreeMap<String, RawPoses>,
}

/// Content of the files of a folder or an archive.
#[derive(Debug)]
pub(crate) struct MembersRead {
    pub raw: RawSession,
    /// Name of the layout, or of the dialects of the poses and the formats of the calibration.
    pub format: String,
    /// Names of the files that were read.
    pub files: Vec<String>,
}

/// One camera as written.
#[derive(Debug, Clone, Default)]
pub(crate) struct RawCamera {
    pub id: String,
    pub width: u32,
    pub height: u32,
    /// K, row by row.
    pub matrix: Option<Rows>,
    /// Distortion coefficients in OpenCV's order.
    pub distortion: Option<Numbers>,
    /// Name of the distortion model, where given.
    pub distortion_model: Option<String>,
    /// `camera_from_world`, row by row.
    pub rotation: Option<Rows>,
    /// `camera_from_world`, metres.
    pub translation: Option<Numbers>,
    /// Time offset of its frames, s.
    pub time_offset: Option<f64>,
}

/// Detections of one camera.
#[derive(Debug, Clone, Default)]
pub(crate) struct RawPoses {
    /// The file that contains them, for messages.
    pub file: String,
    /// The session's own frame numbers, in the order of the file.
    pub order: Vec<i64>,
    /// People by frame number.
    pub detections: BTreeMap<i64, Vec<Detection>>,
}

/// A matrix as a file would hold it.
pub(crate) fn rows_of_matrix(matrix: &Matrix3<f64>) -> Rows {
    ShortList(rows(matrix).iter().map(|row| ShortList(row.to_vec())).collect())
}
