//! What a dialect hands over: typed, bounded, but not yet checked against itself.

use super::json::{Numbers, Rows, ShortList};
use crate::session::formats::rows;
use crate::session::recording::Detection;
use nalgebra::Matrix3;
use std::collections::BTreeMap;

/// A session as written. Checked by [`assemble`](super::assemble).
#[derive(Debug, Clone, Default)]
pub(crate) struct RawSession {
    /// The file that says all this, for messages.
    pub file: String,
    pub name: String,
    pub fps: f64,
    pub first_frame: i64,
    pub n_frames: Option<u64>,
    pub keypoint_convention: String,
    pub up_axis: Option<String>,
    pub start_timecode: Option<String>,
    pub cameras: Vec<RawCamera>,
    /// Poses by camera id.
    pub poses: BTreeMap<String, RawPoses>,
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
    /// What the coefficients mean, where it is said.
    pub distortion_model: Option<String>,
    /// `camera_from_world`, row by row.
    pub rotation: Option<Rows>,
    /// `camera_from_world`, metres.
    pub translation: Option<Numbers>,
    /// By how much its frames are later than their numbers say, s.
    pub time_offset: Option<f64>,
}

/// What one camera saw.
#[derive(Debug, Clone, Default)]
pub(crate) struct RawPoses {
    /// The file that holds it, for messages.
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
