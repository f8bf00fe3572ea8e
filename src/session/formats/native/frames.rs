//! Frames of people: `{"frames": [{"frame", "people": [{"track_id", "keypoints": [[x, y, confidence]]}]}]}`.

use crate::session::upload::error::{Fault, UploadError, shown};
use crate::session::upload::json::{Fields, Items, List, Numbers, Object, Reading};
use crate::session::upload::raw::{RawPoses, RawSession};
use crate::session::{Detection, Keypoint};
use nalgebra::Vector2;
use serde::de::{MapAccess, SeqAccess};

/// Pixels: no sensor is a thousandth as large, and squares of it stay far from overflow.
const MAX_COORDINATE: f64 = 1e6;
/// No convention has as many points; longer lists are refused before they are held.
const MAX_KEYPOINTS_PER_PERSON: usize = 1000;
/// Memory of a person and of a frame besides their keypoints, in keypoints of 24 bytes: 40 bytes and an allocation, 32
/// bytes and a node's share of the map. Without it millions of empty people would cost nothing.
const PERSON_AS_KEYPOINTS: usize = 4;
const FRAME_AS_KEYPOINTS: usize = 3;
/// Whole numbers up to here survive a JSON writer that knows doubles only.
const MAX_FRAME_NUMBER: i64 = 1 << 53;

/// Whether a frame number can be trusted to be what was meant.
pub(super) fn check_number(frame: i64) -> Result<(), UploadError> {
    if (-MAX_FRAME_NUMBER..=MAX_FRAME_NUMBER).contains(&frame) {
        return Ok(());
    }
    Err(Fault::FrameInvalid.with(format!("frame number {frame}")))
}

/// One camera's poses as far as they have been read.
pub(super) struct PosesFields {
    poses: RawPoses,
    has_frames: bool,
}

impl PosesFields {
    pub(super) fn new(file: &str) -> Self {
        Self { poses: RawPoses { file: file.to_owned(), ..RawPoses::default() }, has_frames: false }
    }

    pub(super) fn finish(self, reading: &Reading<'_>) -> Result<RawPoses, UploadError> {
        if self.has_frames {
            return Ok(self.poses);
        }
        Err(reading.place.of(Fault::MissingField.with("the poses have no `frames`")))
    }
}

impl Fields for PosesFields {
    const WHAT: &'static str = "a camera's poses";

    fn field<'de, A: MapAccess<'de>>(
        &mut self,
        key: &str,
        map: &mut A,
        reading: &mut Reading<'_>,
    ) -> Result<bool, A::Error> {
        if key != "frames" {
            return Ok(false);
        }
        map.next_value_seed(List(&mut Frames(&mut self.poses), reading))?;
        self.has_frames = true;
        Ok(true)
    }
}

struct Frames<'p>(&'p mut RawPoses);

impl Items for Frames<'_> {
    fn item<'de, A: SeqAccess<'de>>(
        &mut self,
        _index: usize,
        seq: &mut A,
        reading: &mut Reading<'_>,
    ) -> Result<bool, A::Error> {
        let mut fields = FrameFields::default();
        if seq.next_element_seed(Object(&mut fields, reading))?.is_none() {
            return Ok(false);
        }
        fields.finish(self.0, reading).map_err(|e| reading.refuse(e))?;
        reading.place.frame = None;
        Ok(true)
    }
}

#[derive(Default)]
struct FrameFields {
    frame: Option<i64>,
    people: Option<Vec<Detection>>,
}

impl FrameFields {
    fn finish(self, poses: &mut RawPoses, reading: &mut Reading<'_>) -> Result<(), UploadError> {
        reading.spend(FRAME_AS_KEYPOINTS)?;
        let frame = self.frame.ok_or_else(|| Fault::MissingField.with("a frame has no `frame` number"))?;
        let people = self.people.ok_or_else(|| Fault::MissingField.with("the frame has no `people`"))?;
        if poses.order.len() == reading.limits.max_frames {
            return Err(Fault::TooManyFrames.with(format!("more than {} frames of a camera", poses.order.len())));
        }
        if poses.detections.insert(frame, people).is_some() {
            return Err(Fault::FrameDuplicate.with(format!("frame {frame} stands twice")));
        }
        poses.order.push(frame);
        Ok(())
    }
}

impl Fields for FrameFields {
    const WHAT: &'static str = "a frame";

    fn field<'de, A: MapAccess<'de>>(
        &mut self,
        key: &str,
        map: &mut A,
        reading: &mut Reading<'_>,
    ) -> Result<bool, A::Error> {
        match key {
            "frame" => {
                let frame = map.next_value()?;
                check_number(frame).map_err(|e| reading.refuse(e))?;
                self.frame = Some(frame);
                reading.place.frame = self.frame;
            }
            "people" => map.next_value_seed(List(&mut People(self.people.insert(Vec::new())), reading))?,
            _ => return Ok(false),
        }
        Ok(true)
    }
}

/// One line of a stream: a camera's frame.
#[derive(Default)]
pub(super) struct LineFields {
    camera: Option<String>,
    frame: FrameFields,
}

impl LineFields {
    /// Adds the line to its camera.
    pub(super) fn finish(self, raw: &mut RawSession, reading: &mut Reading<'_>) -> Result<(), UploadError> {
        let Some(camera) = self.camera else {
            return Err(reading.place.of(Fault::MissingField.with("a line has no `camera`")));
        };
        match raw.poses.get_mut(&camera) {
            Some(poses) => self.frame.finish(poses, reading).map_err(|e| reading.place.of(e))?,
            None => reading.warnings.add(format!("poses of unknown camera {} are ignored", shown(&camera))),
        }
        (reading.place.camera, reading.place.frame) = (None, None);
        Ok(())
    }
}

impl Fields for LineFields {
    const WHAT: &'static str = "a line";

    fn field<'de, A: MapAccess<'de>>(
        &mut self,
        key: &str,
        map: &mut A,
        reading: &mut Reading<'_>,
    ) -> Result<bool, A::Error> {
        if key == "camera" {
            self.camera = Some(map.next_value()?);
            reading.place.camera = self.camera.clone();
            return Ok(true);
        }
        self.frame.field(key, map, reading)
    }
}

struct People<'p>(&'p mut Vec<Detection>);

impl Items for People<'_> {
    fn item<'de, A: SeqAccess<'de>>(
        &mut self,
        index: usize,
        seq: &mut A,
        reading: &mut Reading<'_>,
    ) -> Result<bool, A::Error> {
        reading.place.person = Some(index);
        let mut fields = PersonFields::default();
        if seq.next_element_seed(Object(&mut fields, reading))?.is_none() {
            reading.place.person = None;
            return Ok(false);
        }
        if index == reading.limits.max_people_per_frame {
            return Err(reading.refuse(Fault::TooManyPeople.with(format!("more than {index} people in a frame"))));
        }
        reading.spend(PERSON_AS_KEYPOINTS).map_err(|e| reading.refuse(e))?;
        let Some(keypoints) = fields.keypoints else {
            return Err(reading.refuse(Fault::MissingField.with("the person has no `keypoints`")));
        };
        self.0.push(Detection { track_id: fields.track_id, keypoints });
        Ok(true)
    }
}

#[derive(Default)]
struct PersonFields {
    track_id: Option<i64>,
    keypoints: Option<Vec<Keypoint>>,
}

impl Fields for PersonFields {
    const WHAT: &'static str = "a person";

    fn field<'de, A: MapAccess<'de>>(
        &mut self,
        key: &str,
        map: &mut A,
        reading: &mut Reading<'_>,
    ) -> Result<bool, A::Error> {
        match key {
            "track_id" => self.track_id = map.next_value()?,
            "keypoints" => {
                let keypoints = self.keypoints.insert(Vec::new());
                map.next_value_seed(List(&mut Keypoints(keypoints), reading))?;
                keypoints.shrink_to_fit();
            }
            _ => return Ok(false),
        }
        Ok(true)
    }
}

struct Keypoints<'k>(&'k mut Vec<Keypoint>);

impl Items for Keypoints<'_> {
    fn item<'de, A: SeqAccess<'de>>(
        &mut self,
        index: usize,
        seq: &mut A,
        reading: &mut Reading<'_>,
    ) -> Result<bool, A::Error> {
        let Some(numbers) = seq.next_element::<Numbers>()? else { return Ok(false) };
        reading.spend(1).map_err(|e| reading.refuse(e))?;
        if index == MAX_KEYPOINTS_PER_PERSON {
            return Err(reading.refuse(Fault::KeypointCount.with(format!("more than {index} keypoints of a person"))));
        }
        match checked_keypoint(&numbers.0, reading) {
            Ok(keypoint) => self.0.push(keypoint),
            Err(error) => return Err(reading.refuse(error)),
        }
        Ok(true)
    }
}

/// A keypoint of finite pixels near the image and a confidence from 0 (missing) to 1.
fn checked_keypoint(numbers: &[f64], reading: &mut Reading<'_>) -> Result<Keypoint, UploadError> {
    let &[x, y, confidence] = numbers else {
        return Err(Fault::KeypointInvalid.with(format!("a keypoint of {} numbers", numbers.len())));
    };
    if x.abs() > MAX_COORDINATE || y.abs() > MAX_COORDINATE {
        return Err(Fault::KeypointInvalid.with(format!("a keypoint at ({x:e}, {y:e}) px")));
    }
    if confidence < 0.0 {
        return Err(Fault::KeypointInvalid.with(format!("a confidence of {confidence}")));
    }
    if confidence > 1.0 {
        reading.warnings.clamped_confidence(confidence);
    }
    Ok(Keypoint { pixel: Vector2::new(x, y), confidence: confidence.min(1.0) })
}
