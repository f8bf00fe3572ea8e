//! Checks of detections that every way into a session shares: keypoints, frame numbers, frames of a camera.

use super::error::{Fault, UploadError};
use super::json::Reading;
use super::limits::FRAME_AS_KEYPOINTS;
use super::raw::RawPoses;
use super::warnings::Warnings;
use crate::session::recording::{Detection, Keypoint};
use nalgebra::Vector2;

/// Largest coordinate, px: a thousand times the widest sensor; its square stays far from overflow.
pub(crate) const MAX_COORDINATE_PX: f64 = 1e6;
/// Largest frame number: a JSON writer that stores numbers as doubles preserves whole numbers up to here.
const MAX_FRAME_NUMBER: i64 = 1 << 53;

/// A keypoint at `x`, `y` px with a confidence from 0 (missing) to 1; a larger confidence is read as 1, with a warning.
///
/// # Errors
/// [`Fault::KeypointInvalid`] for coordinates beyond 10^6 px and for a negative confidence; [`Fault::NumberNotFinite`].
pub(crate) fn checked_keypoint(
    x: f64,
    y: f64,
    confidence: f64,
    warnings: &mut Warnings,
) -> Result<Keypoint, UploadError> {
    if !(x.is_finite() && y.is_finite() && confidence.is_finite()) {
        return Err(Fault::NumberNotFinite.with(format!("a keypoint is [{x}, {y}, {confidence}]")));
    }
    Fault::KeypointInvalid.when(x.abs() > MAX_COORDINATE_PX || y.abs() > MAX_COORDINATE_PX, || {
        format!("a keypoint lies at ({x:e}, {y:e}) px, expected at most {MAX_COORDINATE_PX:e} px")
    })?;
    Fault::KeypointInvalid.when(confidence < 0.0, || format!("a confidence is {confidence}, expected 0 to 1"))?;
    if confidence > 1.0 {
        warnings.clamped_confidence(confidence);
    }
    Ok(Keypoint::new(Vector2::new(x, y), confidence.min(1.0)))
}

/// Refuses frame numbers that a JSON writer of doubles may have rounded.
///
/// # Errors
/// [`Fault::FrameInvalid`].
pub(crate) fn check_frame_number(frame: i64) -> Result<(), UploadError> {
    if (-MAX_FRAME_NUMBER..=MAX_FRAME_NUMBER).contains(&frame) {
        return Ok(());
    }
    Err(Fault::FrameInvalid.with(format!("the frame number is {frame}, expected at most 2^53 in size")))
}

/// Adds a frame with its people to a camera.
///
/// # Errors
/// [`Fault::FrameDuplicate`], and the limits on frames, people and keypoints.
pub(crate) fn add_frame(
    poses: &mut RawPoses,
    frame: i64,
    people: Vec<Detection>,
    reading: &mut Reading,
) -> Result<(), UploadError> {
    reading.spend(FRAME_AS_KEYPOINTS)?;
    let max_people = reading.limits.max_people_per_frame;
    Fault::TooManyPeople.when(people.len() > max_people, || {
        format!("the frame has {} people, at most {max_people} are read", people.len())
    })?;
    if poses.order.len() == reading.limits.max_frames {
        return Err(Fault::TooManyFrames.with(format!("a camera has more than {} frames", poses.order.len())));
    }
    Fault::FrameDuplicate
        .when(poses.detections.insert(frame, people).is_some(), || format!("frame {frame} occurs twice"))?;
    poses.order.push(frame);
    Ok(())
}
