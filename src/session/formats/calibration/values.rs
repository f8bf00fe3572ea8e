//! Parsing of values that calibration files have in common: numbers, matrices, image sizes, names of cameras.

use crate::geometry::rotation;
use crate::session::upload::error::{Fault, UploadError};
use crate::session::upload::json::{Numbers, Rows, ShortList};
use crate::session::upload::raw::rows_of_matrix;
use nalgebra::Vector3;

/// The error for a file that was recognised as a calibration but cannot be read.
pub(super) fn invalid(detail: impl Into<String>) -> UploadError {
    Fault::CalibrationInvalid.with(detail)
}

/// A 3x3 matrix from nine numbers, row by row.
pub(super) fn rows_of(numbers: &[f64]) -> Option<Rows> {
    (numbers.len() == 9).then(|| ShortList(numbers.chunks(3).map(|row| ShortList(row.to_vec())).collect()))
}

/// The matrix K from focal lengths, principal point and skew, px.
pub(super) fn pinhole(fx: f64, fy: f64, cx: f64, cy: f64, skew: f64) -> Option<Rows> {
    rows_of(&[fx, skew, cx, 0.0, fy, cy, 0.0, 0.0, 1.0])
}

/// A rotation matrix from an axis-angle vector, rad.
fn rows_of_axis_angle(axis_angle: &[f64]) -> Option<Rows> {
    let [x, y, z] = *axis_angle else { return None };
    Some(rows_of_matrix(&rotation::exp(&Vector3::new(x, y, z))))
}

/// A rotation matrix from an axis-angle vector or nine numbers; `name`: of the field.
///
/// # Errors
/// Another number, such as the four of a quaternion.
pub(super) fn rows_of_rotation(name: &str, numbers: &[f64]) -> Result<Rows, UploadError> {
    let rows = rows_of_axis_angle(numbers).or_else(|| rows_of(numbers));
    rows.ok_or_else(|| invalid(format!("{name} has {} numbers, expected 3 (axis and angle) or 9", numbers.len())))
}

/// An image size that is a whole number of pixels.
pub(super) fn size(value: f64) -> Option<u32> {
    (value.fract() == 0.0 && (0.0..=1e6).contains(&value)).then_some(value as u32)
}

/// The name of a camera from the path of an image or a file: its folder, or its own name without the ending.
pub(super) fn camera_of_image(name: &str) -> &str {
    match name.rsplit_once('/') {
        Some((folder, _)) => folder.rsplit('/').next().unwrap_or(folder),
        None => name.rsplit_once('.').map_or(name, |(stem, _)| stem),
    }
}

/// Parses a number; `None` also for infinity and NaN, which are invalid in a calibration.
pub(super) fn finite(word: &str) -> Option<f64> {
    word.parse().ok().filter(|number: &f64| number.is_finite())
}

/// Rotation and translation of the 12 numbers of `[R t]`, row by row.
pub(super) fn split_pose(pose: &[f64]) -> (Option<Rows>, Numbers) {
    let rotation: Vec<f64> = pose.chunks(4).flat_map(|row| row[..3].to_vec()).collect();
    (rows_of(&rotation), ShortList(pose.chunks(4).map(|row| row[3]).collect()))
}
