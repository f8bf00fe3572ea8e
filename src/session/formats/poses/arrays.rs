//! Poses as one array, as tools based on MediaPipe save them: `[cameras, frames, points, x y (…)]`, px.
//!
//! 33 points of the body; from 75 points on, 21 of each hand follow, and the face after them is not read. Which hand is first
//! is found by the joint orders of 75 points ([`JointOrder::candidates`](crate::session::formats::joints::JointOrder)).

use super::found::FoundPoses;
use super::hands::{level_hands, with_hands};
use super::points::{checked_point, missing};
use crate::body::hand::N_HAND_POINTS;
use crate::formats::npy::Header;
use crate::session::formats::joints::N_HANDS_POINTS;
use crate::session::recording::{Detection, Keypoint};
use crate::session::upload::error::{Fault, UploadError};
use crate::session::upload::json::{Reading, fault_of_io};
use std::io::Read;

/// Points of BlazePose's body.
const N_BODY: usize = 33;
/// Largest number of points: body, hands and face with irises have fewer.
const MAX_POINTS: usize = 1000;
/// Numbers per point: x, y, and optionally depth and visibility.
const WIDTHS: std::ops::RangeInclusive<usize> = 2..=4;

/// Whether a file begins like a numpy array of four dimensions; other arrays beside a session do not contain poses.
pub(crate) fn is_array(head: &[u8]) -> bool {
    let text = String::from_utf8_lossy(head);
    let shape = text.split_once("'shape': (").and_then(|(_, rest)| rest.split_once(')'));
    let n_dimensions = shape.map_or(0, |(shape, _)| shape.split(',').filter(|n| !n.trim().is_empty()).count());
    head.starts_with(b"\x93NUMPY") && n_dimensions == 4
}

/// Reads one person per camera; a camera's name is its index in the array. NaN is a missing point; all others have confidence
/// 1.
///
/// # Errors
/// Another shape or type, or a truncated array.
pub(crate) fn read_array(mut reader: impl Read, reading: &mut Reading<'_>) -> Result<FoundPoses, UploadError> {
    let invalid = |detail: String| Fault::TableInvalid.with(detail);
    let header = Header::read(&mut reader).map_err(|error| invalid(error.to_string()))?;
    let [n_cameras, n_frames, n_points, width] = header.shape[..] else {
        return Err(invalid(format!("shape {:?}, expected cameras, frames, points, x y", header.shape)));
    };
    let is_known = (N_BODY..=MAX_POINTS).contains(&n_points) && WIDTHS.contains(&width);
    if !is_known || header.is_fortran {
        return Err(invalid(format!("{n_points} points of {width} numbers, expected 33 or more of 2 to 4 in C order")));
    }
    if n_cameras > reading.limits.max_cameras || n_frames > reading.limits.max_frames {
        return Err(Fault::TooManyFrames.with(format!("{n_cameras} cameras of {n_frames} frames")));
    }
    if header.number.kind != b'f' {
        return Err(invalid("integers, expected floating point numbers".to_owned()));
    }
    let has_hands = n_points >= N_BODY + N_HANDS_POINTS;
    let size = header.number.size;
    let mut found = FoundPoses::default();
    let mut row = vec![0; n_points * width * size];
    for camera in 0..n_cameras {
        let name = camera.to_string();
        for frame in 0..n_frames as i64 {
            reader.read_exact(&mut row).map_err(fault_of_io)?;
            let number = |i: usize| header.number.number(&row[size * i..size * (i + 1)]);
            let point = |k: usize| {
                let [x, y] = [0, 1].map(|c| number(k * width + c));
                if x.is_nan() || y.is_nan() { Ok(missing()) } else { checked_point(x, y, 1.0) }
            };
            let points = |first: usize, n: usize| {
                let read: Result<Vec<Keypoint>, String> = (first..first + n).map(point).collect();
                read.map_err(|why| UploadError { frame: Some(frame), ..Fault::KeypointInvalid.with(why) })
            };
            let hand = |first: usize| if has_hands { points(first, N_HAND_POINTS) } else { Ok(Vec::new()) };
            let hands = [hand(N_BODY)?, hand(N_BODY + N_HAND_POINTS)?];
            let keypoints = with_hands(points(0, N_BODY)?, hands)?;
            if keypoints.iter().any(|keypoint| keypoint.is_present()) {
                found.add(Some(&name), frame, Detection { track_id: None, keypoints }, reading)?;
            } else {
                found.frame(Some(&name), frame, reading)?;
            }
        }
    }
    level_hands(found.by_camera.values_mut().flat_map(|poses| poses.detections.values_mut().flatten()), reading)?;
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recognises_arrays_of_poses_by_shape() {
        let head =
            |shape: &str| format!("NUMPY\x01\x00v\x00{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}");
        let is_taken = |shape: &str| is_array(&[&[0x93], head(shape).as_bytes()].concat());
        assert!(is_taken("(2, 3, 33, 2)"));
        assert!(!is_taken("(4, 300)") && !is_taken("(7,)") && !is_taken("()"));
        assert!(!is_array(head("(2, 3, 33, 2)").as_bytes()));
    }
}
