//! The people that a pose file holds, by camera and frame.

use crate::session::formats::joints::JointOrder;
use crate::session::recording::Detection;
use crate::session::upload::error::{Fault, UploadError};
use crate::session::upload::json::Reading;
use crate::session::upload::limits::{FRAME_AS_KEYPOINTS, PERSON_AS_KEYPOINTS};
use crate::session::upload::raw::RawPoses;
use std::collections::BTreeMap;

/// Content of a pose file, by camera name where the file contains it (`None`: the file's only camera).
#[derive(Debug, Default)]
pub(crate) struct FoundPoses {
    pub(crate) by_camera: BTreeMap<Option<String>, RawPoses>,
    /// Order of the points, where the file names them.
    pub(crate) order: Option<JointOrder>,
    /// Width and height of the images of the keypoints, px, by camera, where the file contains them.
    pub(crate) image_size: BTreeMap<Option<String>, [u32; 2]>,
    /// Frames per second, where the file contains time stamps.
    pub(crate) fps: Option<f64>,
    /// Time offsets by camera name, s, where the file contains time stamps.
    pub(crate) time_offsets: BTreeMap<String, f64>,
}

impl FoundPoses {
    /// Adds a person to a frame.
    ///
    /// # Errors
    /// An exceeded limit.
    pub(super) fn add(
        &mut self,
        camera: Option<&str>,
        frame: i64,
        person: Detection,
        reading: &mut Reading<'_>,
    ) -> Result<(), UploadError> {
        reading.spend(PERSON_AS_KEYPOINTS + person.keypoints.len())?;
        let people = self.frame(camera, frame, reading)?;
        if people.len() == reading.limits.max_people_per_frame {
            let detail = format!("the frame has more than {} people", people.len());
            return Err(UploadError { frame: Some(frame), ..Fault::TooManyPeople.with(detail) });
        }
        people.push(person);
        Ok(())
    }

    /// The people of a frame, which is thereby marked as delivered.
    pub(super) fn frame(
        &mut self,
        camera: Option<&str>,
        frame: i64,
        reading: &mut Reading<'_>,
    ) -> Result<&mut Vec<Detection>, UploadError> {
        let key = camera.map(str::to_owned);
        Fault::TooManyCameras.when(self.by_camera.len() > reading.limits.max_cameras, || {
            format!("the file has poses of more than {} cameras", self.by_camera.len() - 1)
        })?;
        let file = reading.place.file.clone().unwrap_or_default();
        let poses = self.by_camera.entry(key).or_insert_with(|| RawPoses { file, ..RawPoses::default() });
        if !poses.detections.contains_key(&frame) {
            if poses.order.len() == reading.limits.max_frames {
                return Err(Fault::TooManyFrames.with(format!("a camera has more than {} frames", poses.order.len())));
            }
            reading.spend(FRAME_AS_KEYPOINTS)?;
            poses.order.push(frame);
        }
        Ok(poses.detections.entry(frame).or_default())
    }
}
