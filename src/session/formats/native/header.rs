//! Reader of `session.json`: the session's properties and its cameras.

use super::frames::PosesFields;
use super::landmarks::{NameOrTable, PointsFields};
use crate::session::formats::time::FrameRate;
use crate::session::upload::detections::check_frame_number;
use crate::session::upload::error::{Fault, UploadError, shown};
use crate::session::upload::json::{Fields, Items, List, Object, Reading};
use crate::session::upload::raw::{RawCamera, RawPoses, RawSession};
use serde::de::{MapAccess, SeqAccess};
use std::collections::BTreeMap;

/// The part of the document that has been read.
#[derive(Default)]
pub(super) struct DocumentFields {
    name: Option<String>,
    fps: Option<f64>,
    n_frames: Option<u64>,
    first_frame: Option<i64>,
    /// Of the convention, or a table.
    pub(super) points: PointsFields,
    up_axis: Option<String>,
    start_timecode: Option<String>,
    cameras: Option<Vec<RawCamera>>,
    /// Poses by camera id, where they are inline.
    pub(super) poses: Option<BTreeMap<String, RawPoses>>,
}

impl DocumentFields {
    /// The session, after the document has been read.
    pub(super) fn finish(
        self,
        reading: &Reading<'_>,
        poses: BTreeMap<String, RawPoses>,
    ) -> Result<RawSession, UploadError> {
        let missing = |key: &str| reading.place.of(Fault::MissingField.with(format!("the session has no `{key}`")));
        Ok(RawSession {
            file: reading.place.file.clone().unwrap_or_default(),
            name: self.name.unwrap_or_default(),
            fps: self.fps.ok_or_else(|| missing("fps"))?,
            first_frame: self.first_frame.unwrap_or(0),
            n_frames: self.n_frames,
            keypoint_convention: self.points.name.ok_or_else(|| missing("keypoint_convention"))?,
            landmarks: self.points.landmarks,
            up_axis: self.up_axis,
            start_timecode: self.start_timecode,
            cameras: self.cameras.ok_or_else(|| missing("cameras"))?,
            poses,
        })
    }
}

impl Fields for DocumentFields {
    const WHAT: &'static str = "the session";

    fn field<'d, M: MapAccess<'d>>(&mut self, key: &str, map: &mut M, reading: &mut Reading) -> Result<bool, M::Error> {
        match key {
            "name" => self.name = map.next_value()?,
            "fps" => self.fps = Some(map.next_value::<FrameRate>()?.0),
            "n_frames" => self.n_frames = map.next_value()?,
            "first_frame" => {
                self.first_frame = map.next_value()?;
                if let Some(frame) = self.first_frame {
                    check_frame_number(frame).map_err(|e| reading.refuse(e))?;
                }
            }
            "keypoint_convention" => map.next_value_seed(NameOrTable(&mut self.points, reading))?,
            "up_axis" => self.up_axis = map.next_value()?,
            "start_timecode" => self.start_timecode = map.next_value()?,
            "cameras" => map.next_value_seed(List(&mut Cameras(self.cameras.insert(Vec::new())), reading))?,
            "poses" => map.next_value_seed(Object(&mut PosesByCamera(self.poses.insert(BTreeMap::new())), reading))?,
            _ => return Ok(false),
        }
        Ok(true)
    }
}

struct Cameras<'c>(&'c mut Vec<RawCamera>);

impl Items for Cameras<'_> {
    fn item<'d, S: SeqAccess<'d>>(&mut self, i: usize, seq: &mut S, reading: &mut Reading) -> Result<bool, S::Error> {
        let mut fields = CameraFields::default();
        if seq.next_element_seed(Object(&mut fields, reading))?.is_none() {
            return Ok(false);
        }
        if i == reading.limits.max_cameras {
            return Err(reading.refuse(
                Fault::TooManyCameras.with(format!("the session has more than {} cameras", reading.limits.max_cameras)),
            ));
        }
        match fields.finish() {
            Ok(camera) => self.0.push(camera),
            Err(error) => return Err(reading.refuse(error)),
        }
        Ok(true)
    }
}

#[derive(Default)]
struct CameraFields {
    id: Option<String>,
    width: Option<u32>,
    height: Option<u32>,
    rest: RawCamera,
}

impl CameraFields {
    fn finish(self) -> Result<RawCamera, UploadError> {
        let id = self.id.ok_or_else(|| Fault::MissingField.with("the camera has no `id`"))?;
        let missing = |key: &str| {
            let error = Fault::MissingField.with(format!("the camera has no `{key}`"));
            UploadError { camera: Some(id.clone()), ..error }
        };
        let width = self.width.ok_or_else(|| missing("width"))?;
        let height = self.height.ok_or_else(|| missing("height"))?;
        Ok(RawCamera { id, width, height, ..self.rest })
    }
}

impl Fields for CameraFields {
    const WHAT: &'static str = "a camera";

    fn field<'d, M: MapAccess<'d>>(
        &mut self,
        key: &str,
        map: &mut M,
        _reading: &mut Reading,
    ) -> Result<bool, M::Error> {
        match key {
            "id" => self.id = Some(map.next_value()?),
            "width" => self.width = Some(map.next_value()?),
            "height" => self.height = Some(map.next_value()?),
            "K" => self.rest.matrix = Some(map.next_value()?),
            "dist" => self.rest.distortion = map.next_value()?,
            "distortion_model" | "dist_model" => self.rest.distortion_model = map.next_value()?,
            // Without this key a fisheye lens would be read as a polynomial one.
            "fisheye" => {
                if map.next_value::<Option<bool>>()? == Some(true) {
                    self.rest.distortion_model = Some("fisheye".to_owned());
                }
            }
            "R" => self.rest.rotation = map.next_value()?,
            "t" => self.rest.translation = map.next_value()?,
            "time_offset_s" => self.rest.time_offset = map.next_value()?,
            _ => return Ok(false),
        }
        Ok(true)
    }
}

struct PosesByCamera<'p>(&'p mut BTreeMap<String, RawPoses>);

impl Fields for PosesByCamera<'_> {
    const WHAT: &'static str = "`poses`";

    fn field<'d, M: MapAccess<'d>>(&mut self, key: &str, map: &mut M, reading: &mut Reading) -> Result<bool, M::Error> {
        if self.0.len() == reading.limits.max_cameras {
            let detail = format!("`poses` has more than {} cameras, including {}", self.0.len(), shown(key));
            return Err(reading.refuse(Fault::TooManyCameras.with(detail)));
        }
        reading.place.camera = Some(key.to_owned());
        let mut poses = PosesFields::new(reading.place.file.as_deref().unwrap_or_default());
        map.next_value_seed(Object(&mut poses, reading))?;
        let poses = poses.finish(reading).map_err(|e| reading.refuse(e))?;
        self.0.insert(key.to_owned(), poses);
        reading.place.camera = None;
        Ok(true)
    }
}
