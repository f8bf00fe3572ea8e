//! Reader of frames: `{"frames": [{"frame", "people": [{"track_id", "keypoints": [[x, y, confidence]]}]}]}`; beside
//! `keypoints` may stand `covariances` or `sigmas` ([`super::covariances`]).

use super::covariances::Covariances;
use crate::session::recording::{Detection, Keypoint};
use crate::session::upload::detections::{add_frame, check_frame_number, checked_keypoint};
use crate::session::upload::error::{Fault, UploadError, shown};
use crate::session::upload::json::{Fields, Items, List, Numbers, Object, Reading};
use crate::session::upload::limits::{MAX_KEYPOINTS_PER_PERSON, PERSON_AS_KEYPOINTS};
use crate::session::upload::raw::{RawPoses, RawSession};
use serde::de::{MapAccess, SeqAccess};

/// The part of one camera's poses that has been read.
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

    fn field<'d, M: MapAccess<'d>>(&mut self, key: &str, map: &mut M, reading: &mut Reading) -> Result<bool, M::Error> {
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
    fn item<'d, S: SeqAccess<'d>>(&mut self, _i: usize, seq: &mut S, reading: &mut Reading) -> Result<bool, S::Error> {
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
        let frame = self.frame.ok_or_else(|| Fault::MissingField.with("the frame has no `frame` number"))?;
        let people = self.people.ok_or_else(|| Fault::MissingField.with("the frame has no `people`"))?;
        add_frame(poses, frame, people, reading)
    }
}

impl Fields for FrameFields {
    const WHAT: &'static str = "a frame";

    fn field<'d, M: MapAccess<'d>>(&mut self, key: &str, map: &mut M, reading: &mut Reading) -> Result<bool, M::Error> {
        match key {
            "frame" => {
                let frame = map.next_value()?;
                check_frame_number(frame).map_err(|e| reading.refuse(e))?;
                self.frame = Some(frame);
                reading.place.frame = self.frame;
            }
            "people" => map.next_value_seed(List(&mut People(self.people.insert(Vec::new())), reading))?,
            _ => return Ok(false),
        }
        Ok(true)
    }
}

/// One line of NDJSON: a frame of a camera.
#[derive(Default)]
pub(super) struct LineFields {
    camera: Option<String>,
    frame: FrameFields,
}

impl LineFields {
    /// Adds the line to its camera.
    pub(super) fn finish(self, raw: &mut RawSession, reading: &mut Reading<'_>) -> Result<(), UploadError> {
        let Some(camera) = self.camera else {
            return Err(reading.place.of(Fault::MissingField.with("the line has no `camera`")));
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

    fn field<'d, M: MapAccess<'d>>(&mut self, key: &str, map: &mut M, reading: &mut Reading) -> Result<bool, M::Error> {
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
    fn item<'d, S: SeqAccess<'d>>(&mut self, i: usize, seq: &mut S, reading: &mut Reading) -> Result<bool, S::Error> {
        reading.place.person = Some(i);
        let mut fields = PersonFields::default();
        if seq.next_element_seed(Object(&mut fields, reading))?.is_none() {
            reading.place.person = None;
            return Ok(false);
        }
        if i == reading.limits.max_people_per_frame {
            return Err(reading.refuse(Fault::TooManyPeople.with(format!("the frame has more than {i} people"))));
        }
        reading.spend(PERSON_AS_KEYPOINTS).map_err(|e| reading.refuse(e))?;
        let Some(mut keypoints) = fields.keypoints else {
            return Err(reading.refuse(Fault::MissingField.with("the person has no `keypoints`")));
        };
        fields.covariances.add_to(&mut keypoints).map_err(|e| reading.refuse(e))?;
        self.0.push(Detection { track_id: fields.track_id, keypoints });
        Ok(true)
    }
}

#[derive(Default)]
struct PersonFields {
    track_id: Option<i64>,
    keypoints: Option<Vec<Keypoint>>,
    covariances: Covariances,
}

impl Fields for PersonFields {
    const WHAT: &'static str = "a person";

    fn field<'d, M: MapAccess<'d>>(&mut self, key: &str, map: &mut M, reading: &mut Reading) -> Result<bool, M::Error> {
        match key {
            "track_id" => self.track_id = map.next_value()?,
            "keypoints" => {
                let keypoints = self.keypoints.insert(Vec::new());
                map.next_value_seed(List(&mut Keypoints(keypoints), reading))?;
                keypoints.shrink_to_fit();
            }
            "covariances" => map.next_value_seed(List(&mut self.covariances.of_entries(), reading))?,
            "sigmas" => map.next_value_seed(List(&mut self.covariances.of_sigmas(), reading))?,
            _ => return Ok(false),
        }
        Ok(true)
    }
}

struct Keypoints<'k>(&'k mut Vec<Keypoint>);

impl Items for Keypoints<'_> {
    fn item<'d, S: SeqAccess<'d>>(&mut self, i: usize, seq: &mut S, reading: &mut Reading) -> Result<bool, S::Error> {
        let Some(numbers) = seq.next_element::<Numbers>()? else { return Ok(false) };
        reading.spend(1).map_err(|e| reading.refuse(e))?;
        if i == MAX_KEYPOINTS_PER_PERSON {
            return Err(reading.refuse(Fault::KeypointCount.with(format!("a person has more than {i} keypoints"))));
        }
        let keypoint = match numbers.0[..] {
            [x, y, confidence] => checked_keypoint(x, y, confidence, reading.warnings),
            _ => Err(Fault::KeypointInvalid.with(format!("a keypoint has {} numbers, expected 3", numbers.0.len()))),
        };
        self.0.push(keypoint.map_err(|e| reading.refuse(e))?);
        Ok(true)
    }
}
