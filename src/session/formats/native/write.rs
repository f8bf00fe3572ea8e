//! Writer of the native layout: the inverse of reading, rounded to a detector's precision.

use super::landmarks::{Points, points_of};
use crate::geometry::PixelCovariance;
use crate::session::formats::{LensFields, entries, rounded, rows};
use crate::session::recording::{Detection, FrameIndex, Keypoint, Session, View};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::Path;

/// Decimal places of written pixels and confidences.
const PIXEL_DECIMALS: i32 = 2;
const CONFIDENCE_DECIMALS: i32 = 3;

/// Writes `session.json` and `poses/<camera id>.json` into `dir`, which is created where it is missing.
///
/// Keypoints are rounded to 0.01 px and confidences to 0.001 (never to 0 where a point is present); a missing keypoint
/// is `[0, 0, 0]`. Covariances are written to the last digit.
///
/// # Errors
/// The error of the file system; `InvalidInput` where a camera's id is not a valid file name.
pub fn write_folder(session: &Session, dir: &Path) -> io::Result<()> {
    let poses_dir = dir.join("poses");
    fs::create_dir_all(&poses_dir)?;
    for view in &session.views {
        let name = file_name(&view.id)?;
        fs::write(poses_dir.join(name), to_text(&poses_of(session, view))?)?;
    }
    fs::write(dir.join("session.json"), to_text(&document_of(session, None))?)
}

/// The session as one JSON document with inline poses, rounded as by [`write_folder`].
///
/// # Errors
/// None for a valid session; writing JSON is fallible in general.
pub fn to_json(session: &Session) -> io::Result<String> {
    let poses = session.views.iter().map(|view| (view.id.as_str(), poses_of(session, view))).collect();
    to_text(&document_of(session, Some(poses)))
}

fn to_text(value: &impl Serialize) -> io::Result<String> {
    Ok(serde_json::to_string(value)?)
}

/// The file name of a camera's poses; ids come from the user and may not be valid file names.
fn file_name(id: &str) -> io::Result<String> {
    let name = format!("{id}.json");
    let is_plain = !id.is_empty() && !id.starts_with('.') && !id.contains(['/', '\\', '\0', ':']) && name.len() <= 255;
    if is_plain {
        return Ok(name);
    }
    Err(io::Error::new(io::ErrorKind::InvalidInput, format!("camera id {id:?} is not a valid file name")))
}

#[derive(Serialize)]
struct Document<'a> {
    name: &'a str,
    fps: f64,
    n_frames: usize,
    first_frame: i64,
    keypoint_convention: Points<'a>,
    #[serde(skip_serializing_if = "Option::is_none")]
    up_axis: Option<crate::session::recording::UpAxis>,
    #[serde(skip_serializing_if = "Option::is_none")]
    start_timecode: Option<&'a str>,
    cameras: Vec<Camera<'a>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    poses: Option<BTreeMap<&'a str, Poses>>,
}

#[derive(Serialize)]
struct Camera<'a> {
    id: &'a str,
    #[serde(flatten)]
    lens: LensFields,
    #[serde(rename = "R", skip_serializing_if = "Option::is_none")]
    rotation: Option<[[f64; 3]; 3]>,
    #[serde(rename = "t", skip_serializing_if = "Option::is_none")]
    translation: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    time_offset_s: Option<f64>,
}

#[derive(Serialize)]
struct Poses {
    frames: Vec<Frame>,
}

#[derive(Serialize)]
struct Frame {
    frame: i64,
    people: Vec<Person>,
}

#[derive(Serialize)]
struct Person {
    track_id: Option<i64>,
    keypoints: Vec<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    covariances: Option<Vec<Option<PixelCovariance>>>,
}

fn document_of<'a>(session: &'a Session, poses: Option<BTreeMap<&'a str, Poses>>) -> Document<'a> {
    Document {
        name: &session.name,
        fps: session.fps,
        n_frames: session.n_frames,
        first_frame: session.first_frame,
        keypoint_convention: points_of(session),
        up_axis: session.up_axis,
        start_timecode: session.start_timecode.as_deref(),
        cameras: session.views.iter().map(camera_of).collect(),
        poses,
    }
}

fn camera_of(view: &View) -> Camera<'_> {
    Camera {
        id: &view.id,
        lens: if view.has_intrinsics {
            LensFields::of(&view.intrinsics)
        } else {
            LensFields::unknown(&view.intrinsics)
        },
        rotation: view.camera_from_world.map(|pose| rows(&pose.rotation)),
        translation: view.camera_from_world.map(|pose| entries(&pose.translation)),
        time_offset_s: Some(view.time_offset).filter(|offset| *offset != 0.0),
    }
}

fn poses_of(session: &Session, view: &View) -> Poses {
    let frame = |&index: &FrameIndex| Frame {
        frame: session.frame_number(index),
        people: view.frames[index.0].iter().map(person_of).collect(),
    };
    Poses { frames: view.delivered.iter().map(frame).collect() }
}

fn person_of(detection: &Detection) -> Person {
    let keypoints = &detection.keypoints;
    let has_covariances = keypoints.iter().any(|keypoint| keypoint.covariance.is_some());
    let covariances = has_covariances.then(|| keypoints.iter().map(|keypoint| keypoint.covariance).collect());
    Person { track_id: detection.track_id, keypoints: keypoints.iter().map(triple).collect(), covariances }
}

fn triple(keypoint: &Keypoint) -> [f64; 3] {
    if !keypoint.is_present() {
        return [0.0; 3];
    }
    let confidence = rounded(keypoint.confidence, CONFIDENCE_DECIMALS).max(1e-3);
    [rounded(keypoint.pixel.x, PIXEL_DECIMALS), rounded(keypoint.pixel.y, PIXEL_DECIMALS), confidence]
}
