//! Sessions built in memory, with the checks of an upload.

use super::formats::distortion_model;
use super::recording::{Detection, Keypoint, Session, UpAxis};
use super::upload::assemble::assemble;
use super::upload::detections::{add_frame, check_frame_number, checked_keypoint};
use super::upload::error::{Fault, UploadError};
use super::upload::json::{Place, Reading, ShortList};
use super::upload::limits::{PERSON_AS_KEYPOINTS, UploadLimits};
use super::upload::raw::{RawCamera, RawPoses, RawSession, rows_of_matrix};
use super::upload::warnings::Warnings;
use crate::body::skeleton::KeypointConvention;
use crate::geometry::{Intrinsics, Rigid};

/// Builds a [`Session`] from cameras and detections in memory. [`build`](Self::build) makes the checks of an upload.
///
/// ```
/// use nalgebra::Vector2;
/// use wandless::body::skeleton::KeypointConvention;
/// use wandless::geometry::{Distortion, Intrinsics};
/// use wandless::session::{Detection, Keypoint, SessionBuilder};
///
/// let (fx, fy, cx, cy) = (1000.0, 1000.0, 639.5, 359.5); // px
/// let lens = Intrinsics { width: 1280, height: 720, fx, fy, cx, cy, skew: 0.0, dist: Distortion::None };
/// let keypoints = vec![Keypoint::new(Vector2::new(640.0, 360.0), 0.9); 17];
/// let person = Detection { track_id: None, keypoints };
/// let session = SessionBuilder::new(30.0, KeypointConvention::Coco17)
///     .name("two cameras")
///     .camera("left", &lens, None)
///     .camera("right", &lens, None)
///     .detections("left", 0, vec![person.clone()])
///     .detections("right", 0, vec![person])
///     .build()?;
/// assert_eq!((session.views.len(), session.n_frames), (2, 1));
/// # Ok::<(), wandless::session::upload::UploadError>(())
/// ```
#[derive(Debug, Clone)]
pub struct SessionBuilder {
    raw: RawSession,
    frames: Vec<(String, i64, Vec<Detection>)>,
    limits: UploadLimits,
}

impl SessionBuilder {
    /// A session without cameras. `fps`: frames per second, 0.1 to 2000. All detections follow `convention`.
    pub fn new(fps: f64, convention: KeypointConvention) -> Self {
        let (file, keypoint_convention) = ("session in memory".to_owned(), convention.name().to_owned());
        let raw = RawSession { file, fps, keypoint_convention, ..RawSession::default() };
        Self { raw, frames: Vec::new(), limits: UploadLimits::default() }
    }

    /// Sets the name that reports and results show.
    pub fn name(mut self, name: impl Into<String>) -> Self {
        self.raw.name = name.into();
        self
    }

    /// Sets the time line: numbers `first_frame` to `first_frame + n_frames - 1`. Without it the time line runs from 0 to
    /// the last frame with detections.
    pub fn time_line(mut self, first_frame: i64, n_frames: usize) -> Self {
        (self.raw.first_frame, self.raw.n_frames) = (first_frame, Some(n_frames as u64));
        self
    }

    /// Sets the up axis of the world that the given camera poses refer to.
    pub fn up_axis(mut self, up_axis: UpAxis) -> Self {
        self.raw.up_axis = Some(format!("{up_axis:?}"));
        self
    }

    /// Replaces the limits on cameras, frames, people and keypoints.
    pub fn limits(mut self, limits: UploadLimits) -> Self {
        self.limits = limits;
        self
    }

    /// Adds a camera. `id`: unique name; `camera_from_world`: its pose in metres, where known.
    pub fn camera(mut self, id: impl Into<String>, lens: &Intrinsics, camera_from_world: Option<&Rigid>) -> Self {
        self.raw.cameras.push(RawCamera {
            id: id.into(),
            width: lens.width,
            height: lens.height,
            matrix: Some(rows_of_matrix(&lens.matrix())),
            distortion: Some(ShortList(lens.dist.coefficients().to_vec())),
            distortion_model: distortion_model(&lens.dist).map(str::to_owned),
            rotation: camera_from_world.map(|pose| rows_of_matrix(&pose.rotation)),
            translation: camera_from_world.map(|pose| ShortList(pose.translation.as_slice().to_vec())),
            time_offset: None,
        });
        self
    }

    /// Adds the people that a camera detected in a frame; an empty list is a frame without people. A camera needs at least
    /// one call; frames without a call were not delivered.
    pub fn detections(mut self, camera: impl Into<String>, frame: i64, people: Vec<Detection>) -> Self {
        self.frames.push((camera.into(), frame, people));
        self
    }

    /// Checks everything and returns the session.
    ///
    /// # Errors
    /// The first [`UploadError`] that an upload of the same content would cause, with camera, frame and person.
    pub fn build(self) -> Result<Session, UploadError> {
        self.build_with_warnings().map(|(session, _)| session)
    }

    /// Like [`build`](Self::build), and also returns the warnings of an upload: implausible calibrations, for example.
    ///
    /// # Errors
    /// See [`build`](Self::build); detections of an unknown camera are an error here.
    pub fn build_with_warnings(self) -> Result<(Session, Vec<String>), UploadError> {
        let Self { mut raw, frames, limits } = self;
        let mut warnings = Warnings::default();
        let mut reading = Reading::new(&limits, &mut warnings);
        for (camera, frame, people) in frames {
            let (file, is_known) = (raw.file.clone(), raw.cameras.iter().any(|own| own.id == camera));
            let new_poses = RawPoses { file: file.clone(), ..RawPoses::default() };
            let poses = raw.poses.entry(camera.clone()).or_insert(new_poses);
            reading.place = Place { file: Some(file), camera: Some(camera), frame: Some(frame), person: None };
            let added = match is_known {
                true => add_checked(poses, frame, people, &mut reading),
                false => Err(Fault::CameraUnknown.with("the session has no such camera")),
            };
            added.map_err(|e| reading.place.of(e))?;
        }
        let session = assemble(raw, &limits, &mut warnings)?;
        Ok((session, warnings.into_lines()))
    }
}

fn add_checked(
    poses: &mut RawPoses,
    frame: i64,
    mut people: Vec<Detection>,
    reading: &mut Reading,
) -> Result<(), UploadError> {
    check_frame_number(frame)?;
    reading.spend(people.iter().map(|person| PERSON_AS_KEYPOINTS + person.keypoints.len()).sum())?;
    for (i, person) in people.iter_mut().enumerate() {
        reading.place.person = Some(i);
        for keypoint in &mut person.keypoints {
            let Keypoint { pixel, confidence, covariance } = *keypoint;
            *keypoint = Keypoint { covariance, ..checked_keypoint(pixel.x, pixel.y, confidence, reading.warnings)? };
        }
    }
    reading.place.person = None;
    add_frame(poses, frame, people, reading)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Distortion, rotation};
    use crate::session::formats::native::to_json;
    use crate::session::recording::Keypoint;
    use crate::session::upload::read_upload;
    use nalgebra::{Vector2, Vector3};
    use std::io::Cursor;

    const LENS: Intrinsics = Intrinsics { dist: Distortion::Fisheye4([0.01, 0.0, 0.0, 0.0]), ..Intrinsics::PLAIN };

    fn person(confidence: f64) -> Detection {
        let keypoint = |k: usize| Keypoint::new(Vector2::new(10.25 * k as f64, 300.5), confidence);
        Detection { track_id: Some(3), keypoints: (0..17).map(keypoint).collect() }
    }

    fn builder() -> SessionBuilder {
        let (rotation, translation) = (rotation::exp(&Vector3::new(0.1, -2.0, 0.3)), Vector3::new(0.5, 1.25, 4.0));
        SessionBuilder::new(29.97, KeypointConvention::Coco17)
            .name("in memory")
            .time_line(-3, 5)
            .up_axis(UpAxis::Z)
            .camera("a", &LENS, Some(&Rigid { rotation, translation }))
            .camera("b", &Intrinsics::PLAIN, None)
            .detections("a", 1, vec![person(0.5), person(0.25)])
            .detections("a", -3, Vec::new())
            .detections("b", 0, vec![person(1.0)])
    }

    #[test]
    fn equals_the_same_session_uploaded() {
        let session = builder().build().unwrap();
        assert_eq!((session.views[0].intrinsics, session.first_frame), (LENS, -3));
        let text = to_json(&session).unwrap();
        let uploaded = read_upload(Cursor::new(text), "upload", &UploadLimits::default()).unwrap();
        assert_eq!(uploaded.session, session);
    }

    #[test]
    fn infers_the_time_line_and_warns_like_an_upload() {
        let builder = SessionBuilder::new(25.0, KeypointConvention::Coco17).camera("a", &LENS, None);
        let (session, warnings) = builder.detections("a", 4, vec![person(1.5)]).build_with_warnings().unwrap();
        assert_eq!((session.n_frames, session.views[0].frames[4][0].keypoints[0].confidence), (5, 1.0));
        assert!(warnings.iter().any(|line| line.contains("17 confidences above 1")), "{warnings:?}");
    }

    #[test]
    fn reports_the_errors_of_an_upload() {
        let short = Detection { track_id: None, keypoints: person(0.5).keypoints[1..].to_vec() };
        let limits = UploadLimits { max_keypoints: 50, ..UploadLimits::default() };
        let crowd = UploadLimits { max_people_per_frame: 1, ..UploadLimits::default() };
        let nowhere = Rigid { translation: Vector3::repeat(f64::NAN), ..Rigid::identity() };
        let cases = [
            (SessionBuilder::new(30.0, KeypointConvention::Coco17), "no_cameras"),
            (SessionBuilder::new(f64::NAN, KeypointConvention::Coco17), "fps_invalid"),
            (builder().camera("a", &LENS, None), "camera_duplicate"),
            (builder().camera("c", &LENS, None), "poses_missing"),
            (builder().camera("c", &LENS, Some(&nowhere)).detections("c", 0, Vec::new()), "number_not_finite"),
            (builder().camera("c", &LENS.with_focal_factor(-1.0), None).detections("c", 0, vec![]), "camera_invalid"),
            (builder().detections("c", 0, Vec::new()), "camera_unknown"),
            (builder().detections("a", 1, Vec::new()), "frame_duplicate"),
            (builder().detections("a", 2, Vec::new()), "frame_out_of_range"),
            (builder().detections("a", i64::MAX, Vec::new()), "frame_invalid"),
            (builder().detections("a", 0, vec![short]), "keypoint_count"),
            (builder().detections("a", 0, vec![person(-0.5)]), "keypoint_invalid"),
            (builder().detections("a", 0, vec![person(f64::NAN)]), "number_not_finite"),
            (builder().limits(limits), "too_many_keypoints"),
            (builder().limits(crowd), "too_many_people"),
        ];
        for (builder, code) in cases {
            assert_eq!(builder.build().unwrap_err().code, code);
        }
        let error = builder().detections("b", 1, vec![person(0.5), person(-1.0)]).build().unwrap_err();
        assert_eq!((error.camera.as_deref(), error.frame, error.person), (Some("b"), Some(1), Some(1)));
    }
}
