//! Checks a session as a reader produced it and builds a [`Session`]: all checks that involve more than one value.

use super::camera::{checked_extrinsics, checked_intrinsics};
use super::error::{Fault, UploadError, shown};
use super::limits::UploadLimits;
use super::raw::{RawCamera, RawPoses, RawSession};
use super::warnings::Warnings;
use crate::body::dense_landmarks::{DenseLandmarks, checked_table};
use crate::body::skeleton::KeypointConvention;
use crate::session::formats::time::is_timecode;
use crate::session::recording::{Detection, FPS_RANGE, FrameIndex, Keypoint, Session, UpAxis, View};
use crate::session::recording_tests::suspicions;
use std::sync::Arc;

/// Largest length of a camera's id, bytes: 256 characters of four bytes, and more than any file name, from which ids come.
const MAX_ID_BYTES: usize = 1024;

/// Checks a session and builds it.
///
/// # Errors
/// The first inconsistency, with its location.
pub(crate) fn assemble(
    mut raw: RawSession,
    limits: &UploadLimits,
    warnings: &mut Warnings,
) -> Result<Session, UploadError> {
    let in_header = |error: UploadError| UploadError { file: Some(raw.file.clone()), ..error };
    let fps = checked_fps(raw.fps).map_err(in_header)?;
    let points = checked_points(&raw).map_err(in_header)?;
    let up_axis = raw.up_axis.as_deref().map(checked_up_axis).transpose().map_err(in_header)?;
    let start_timecode =
        raw.start_timecode.take().map(|code| checked_timecode(code, fps)).transpose().map_err(in_header)?;
    check_ids(&raw.cameras, limits).map_err(in_header)?;
    let n_frames = checked_n_frames(&raw, limits, warnings).map_err(in_header)?;
    let time_line = TimeLine { first_frame: raw.first_frame, n_frames };

    let mut views = Vec::with_capacity(raw.cameras.len());
    for camera in &raw.cameras {
        let in_camera = |error| in_camera_of(&raw.file, &camera.id, error);
        let intrinsics = checked_intrinsics(camera, warnings).map_err(in_camera)?;
        let camera_from_world = checked_extrinsics(camera, warnings).map_err(in_camera)?;
        let poses = raw.poses.remove(&camera.id).ok_or_else(|| in_camera(Fault::PosesMissing.with("no poses")))?;
        check_poses(&poses, &camera.id, &time_line, &points)?;
        let (mut frames, delivered) = dense(poses, &time_line);
        points.reorder(&mut frames);
        let time_offset = checked_time_offset(camera.time_offset.unwrap_or(0.0)).map_err(in_camera)?;
        let (id, has_intrinsics) = (camera.id.clone(), camera.matrix.is_some());
        views.push(View { id, intrinsics, has_intrinsics, camera_from_world, time_offset, frames, delivered });
    }
    warn_of_unknown_lenses(&views, warnings);
    Fault::NoFrames
        .when(views.iter().all(|view| view.delivered.is_empty()), || "no camera has a frame")
        .map_err(in_header)?;
    for view in views.iter().filter(|view| view.delivered.is_empty()) {
        warnings.add(format!("camera {} has no frames", shown(&view.id)));
    }
    for id in raw.poses.keys() {
        warnings.add(format!("poses of unknown camera {} are ignored", shown(id)));
    }
    let (name, first_frame) = (raw.name, raw.first_frame);
    let (convention, dense) = (points.convention, points.dense);
    let session = Session { name, fps, first_frame, n_frames, convention, dense, up_axis, start_timecode, views };
    for suspicion in suspicions(&session) {
        warnings.add(suspicion.sentence());
    }
    Ok(session)
}

fn warn_of_unknown_lenses(views: &[View], warnings: &mut Warnings) {
    let unknown: Vec<String> = views.iter().filter(|view| !view.has_intrinsics).map(|view| shown(&view.id)).collect();
    if !unknown.is_empty() {
        warnings.add(format!(
            "no K of {} of {} cameras ({}): focal lengths are estimated from the people, which is less accurate than a \
             calibration",
            unknown.len(),
            views.len(),
            unknown.join(", ")
        ));
    }
}

struct TimeLine {
    first_frame: i64,
    n_frames: usize,
}

impl TimeLine {
    fn index_of(&self, frame: i64) -> Option<FrameIndex> {
        let index = usize::try_from(frame.checked_sub(self.first_frame)?).ok()?;
        (index < self.n_frames).then_some(FrameIndex(index))
    }
}

fn in_camera_of(file: &str, camera: &str, error: UploadError) -> UploadError {
    UploadError { file: Some(file.to_owned()), camera: Some(camera.to_owned()), ..error }
}

fn checked_fps(fps: f64) -> Result<f64, UploadError> {
    if (FPS_RANGE[0]..=FPS_RANGE[1]).contains(&fps) {
        return Ok(fps);
    }
    Err(Fault::FpsInvalid.with(format!("fps is {fps}, expected {} to {}", FPS_RANGE[0], FPS_RANGE[1])))
}

/// Largest time offset of a camera, s; cameras further apart in time did not film the same scene.
const MAX_TIME_OFFSET: f64 = 3600.0;

fn checked_time_offset(seconds: f64) -> Result<f64, UploadError> {
    if (-MAX_TIME_OFFSET..=MAX_TIME_OFFSET).contains(&seconds) {
        return Ok(seconds);
    }
    Err(Fault::TimeInvalid.with(format!("time_offset_s is {seconds}, expected -3600 to 3600 seconds")))
}

fn checked_timecode(code: String, fps: f64) -> Result<String, UploadError> {
    if is_timecode(&code, fps) {
        return Ok(code);
    }
    Err(Fault::TimeInvalid
        .with(format!("start_timecode is {}, expected HH:MM:SS:FF at {fps} frames per second", shown(&code))))
}

fn checked_convention(name: &str) -> Result<KeypointConvention, UploadError> {
    KeypointConvention::parse(name).ok_or_else(|| {
        let known = KeypointConvention::ALL.map(KeypointConvention::name).join(", ");
        Fault::ConventionUnknown.with(format!("keypoint_convention is {}, expected one of {known}", shown(name)))
    })
}

/// The points of a session's detections.
struct SessionPoints {
    /// Of the convention or of the table, for messages.
    name: String,
    n: usize,
    convention: KeypointConvention,
    dense: Option<Arc<DenseLandmarks>>,
    /// Place of every point of the table: those of the convention first; `None` where the files are in this order.
    places: Option<Vec<usize>>,
}

fn checked_points(raw: &RawSession) -> Result<SessionPoints, UploadError> {
    let name = &raw.keypoint_convention;
    let Some(stated) = &raw.landmarks else {
        let convention = checked_convention(name)?;
        let (name, n) = (convention.name().to_owned(), convention.n_keypoints());
        return Ok(SessionPoints { name, n, convention, dense: None, places: None });
    };
    let table = checked_table(name, stated).map_err(|error| Fault::LandmarksInvalid.with(error.to_string()))?;
    let is_in_order = table.places.iter().enumerate().all(|(k, place)| k == *place);
    Ok(SessionPoints {
        name: name.clone(),
        n: stated.len(),
        convention: table.base,
        dense: table.dense.map(Arc::new),
        places: (!is_in_order).then_some(table.places),
    })
}

impl SessionPoints {
    /// Puts the points of all detections into the order of the session.
    fn reorder(&self, frames: &mut [Vec<Detection>]) {
        let Some(places) = &self.places else { return };
        for detection in frames.iter_mut().flatten() {
            let mut ordered = vec![Keypoint::MISSING; self.n];
            places.iter().zip(&detection.keypoints).for_each(|(place, keypoint)| ordered[*place] = *keypoint);
            detection.keypoints = ordered;
        }
    }
}

fn checked_up_axis(name: &str) -> Result<UpAxis, UploadError> {
    match name {
        "x" | "X" => Ok(UpAxis::X),
        "y" | "Y" => Ok(UpAxis::Y),
        "z" | "Z" => Ok(UpAxis::Z),
        _ => Err(Fault::CameraInvalid.with(format!("up_axis is {}, expected x, y or z", shown(name)))),
    }
}

/// Ids are compared byte by byte; neither case nor Unicode normal form is folded.
fn check_ids(cameras: &[RawCamera], limits: &UploadLimits) -> Result<(), UploadError> {
    Fault::NoCameras.when(cameras.is_empty(), || "`cameras` is empty")?;
    Fault::TooManyCameras.when(cameras.len() > limits.max_cameras, || {
        format!("the session has {} cameras, at most {} are read", cameras.len(), limits.max_cameras)
    })?;
    for (i, camera) in cameras.iter().enumerate() {
        let at = |error| UploadError { pointer: Some(format!("/cameras/{i}/id")), ..error };
        Fault::CameraIdInvalid.when(camera.id.is_empty(), || "the camera's id is empty").map_err(at)?;
        Fault::CameraIdInvalid
            .when(
                camera.id.contains('\0'),
                || "the camera's id has the character U+0000, which not every database stores",
            )
            .map_err(at)?;
        if camera.id.len() > MAX_ID_BYTES {
            return Err(at(Fault::CameraIdInvalid
                .with(format!("the camera's id has {} bytes, at most {MAX_ID_BYTES} are read", camera.id.len()))));
        }
        if cameras[..i].iter().any(|other| other.id == camera.id) {
            let error = Fault::CameraDuplicate.with("the camera's id occurs twice");
            return Err(at(UploadError { camera: Some(camera.id.clone()), ..error }));
        }
    }
    Ok(())
}

/// Number of frames of the time line: as given, or up to the last frame of any camera.
fn checked_n_frames(raw: &RawSession, limits: &UploadLimits, warnings: &mut Warnings) -> Result<usize, UploadError> {
    let n_frames = raw.n_frames.unwrap_or_else(|| {
        let last = raw.poses.values().filter_map(|poses| poses.detections.keys().next_back()).max();
        let n = last.map_or(0, |last| last.saturating_sub(raw.first_frame).saturating_add(1).max(0));
        warnings.add(format!("`n_frames` is missing; {n} frames were found"));
        n.unsigned_abs()
    });
    Fault::NoFrames.when(n_frames == 0, || "n_frames is 0, expected at least 1")?;
    let n = usize::try_from(n_frames).unwrap_or(usize::MAX);
    if n > limits.max_frames || n.saturating_mul(raw.cameras.len()) > limits.max_view_frames {
        let detail = format!(
            "{n} frames of {} cameras; at most {} frames, and {} over all cameras, are read",
            raw.cameras.len(),
            limits.max_frames,
            limits.max_view_frames
        );
        return Err(Fault::TooManyFrames.with(detail));
    }
    Ok(n)
}

fn check_poses(
    poses: &RawPoses,
    camera: &str,
    time_line: &TimeLine,
    points: &SessionPoints,
) -> Result<(), UploadError> {
    for (&frame, people) in &poses.detections {
        let at_frame = |error| UploadError { frame: Some(frame), ..in_camera_of(&poses.file, camera, error) };
        if time_line.index_of(frame).is_none() {
            let TimeLine { first_frame, n_frames } = time_line;
            let last = first_frame.saturating_add(*n_frames as i64 - 1);
            let detail =
                format!("frame {frame} lies outside the time line {first_frame} to {last} (n_frames {n_frames})");
            return Err(at_frame(Fault::FrameOutOfRange.with(detail)));
        }
        for (person, detection) in people.iter().enumerate() {
            let (found, expected) = (detection.keypoints.len(), points.n);
            if found != expected {
                let detail = format!("{expected} keypoints of {} expected, found {found}", points.name);
                return Err(UploadError { person: Some(person), ..at_frame(Fault::KeypointCount.with(detail)) });
            }
        }
    }
    Ok(())
}

/// Places the frames on the dense time line. All of them lie on it: [`check_poses`] has passed.
fn dense(poses: RawPoses, time_line: &TimeLine) -> (Vec<Vec<Detection>>, Vec<FrameIndex>) {
    let mut frames = vec![Vec::new(); time_line.n_frames];
    for (frame, people) in poses.detections {
        if let Some(FrameIndex(index)) = time_line.index_of(frame) {
            frames[index] = people;
        }
    }
    let delivered = poses.order.iter().filter_map(|&frame| time_line.index_of(frame)).collect();
    (frames, delivered)
}
