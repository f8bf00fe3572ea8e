//! Dialects of 2D poses, told by their content. Some write one file a frame, some one file a camera or a take.

mod arrays;
mod frame_files;
mod lists;
mod points;
mod sniff;
mod tables;

pub(crate) use arrays::{is_array, read_array};
pub(crate) use frame_files::{FrameContent, read_frame};
pub(crate) use lists::{ImageTable, read_list, read_mmpose};
pub(crate) use sniff::{PoseDialect, recognise};
pub(crate) use tables::{read_caliscope, read_deeplabcut, read_timestamps};

use crate::session::Detection;
use crate::session::formats::joints::JointOrder;
use crate::session::upload::error::{Fault, UploadError};
use crate::session::upload::json::Reading;
use crate::session::upload::raw::RawPoses;
use std::collections::BTreeMap;

/// Memory of a person and of a frame besides their keypoints, in keypoints (see the native reader).
const PERSON_AS_KEYPOINTS: usize = 4;
const FRAME_AS_KEYPOINTS: usize = 3;

/// What a file holds, by the camera's name where the file tells it (`None`: the file's only camera).
#[derive(Debug, Default)]
pub(crate) struct FoundPoses {
    pub(crate) by_camera: BTreeMap<Option<String>, RawPoses>,
    /// The order of the points, where the file names them.
    pub(crate) order: Option<JointOrder>,
    /// Width and height of the images that the points were found in, by camera, where the file tells them.
    pub(crate) image_size: BTreeMap<Option<String>, [u32; 2]>,
}

impl FoundPoses {
    /// Adds a person to a frame.
    ///
    /// # Errors
    /// A limit that is exceeded.
    fn add(
        &mut self,
        camera: Option<&str>,
        frame: i64,
        person: Detection,
        reading: &mut Reading<'_>,
    ) -> Result<(), UploadError> {
        reading.spend(PERSON_AS_KEYPOINTS + person.keypoints.len())?;
        let people = self.frame(camera, frame, reading)?;
        if people.len() == reading.limits.max_people_per_frame {
            let detail = format!("more than {} people in a frame", people.len());
            return Err(UploadError { frame: Some(frame), ..Fault::TooManyPeople.with(detail) });
        }
        people.push(person);
        Ok(())
    }

    /// The people of a frame, which is delivered by being asked for.
    fn frame(
        &mut self,
        camera: Option<&str>,
        frame: i64,
        reading: &mut Reading<'_>,
    ) -> Result<&mut Vec<Detection>, UploadError> {
        let key = camera.map(str::to_owned);
        if self.by_camera.len() > reading.limits.max_cameras {
            return Err(Fault::TooManyCameras.with(format!("poses of more than {} cameras", self.by_camera.len() - 1)));
        }
        let file = reading.place.file.clone().unwrap_or_default();
        let poses = self.by_camera.entry(key).or_insert_with(|| RawPoses { file, ..RawPoses::default() });
        if !poses.detections.contains_key(&frame) {
            if poses.order.len() == reading.limits.max_frames {
                return Err(Fault::TooManyFrames.with(format!("more than {} frames of a camera", poses.order.len())));
            }
            reading.spend(FRAME_AS_KEYPOINTS)?;
            poses.order.push(frame);
        }
        Ok(poses.detections.entry(frame).or_default())
    }
}

/// The frame number at the end of a file name: `cam_000012_keypoints.json` is frame 12 of `cam`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct FrameName {
    /// What stands before the number, without separators at its end.
    pub(crate) stem: String,
    pub(crate) frame: i64,
}

/// Reads a frame number off a file name (without folder); `None` where it does not end in digits.
pub(crate) fn frame_name(file_name: &str) -> Option<FrameName> {
    let stem = file_name.rsplit_once('.').map_or(file_name, |(stem, _)| stem);
    let stem = ["_keypoints", "_poses", "_pose"].iter().find_map(|end| stem.strip_suffix(end)).unwrap_or(stem);
    let start = stem.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    let frame = stem[start..].parse().ok().filter(|frame: &i64| *frame < 1 << 53)?;
    Some(FrameName { stem: stem[..start].trim_end_matches(['_', '-', '.']).to_owned(), frame })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frame_numbers_stand_at_the_end_of_names() {
        let name = |text: &str| frame_name(text).map(|name| (name.stem, name.frame));
        assert_eq!(name("cam_1_000000000012_keypoints.json"), Some(("cam_1".to_owned(), 12)));
        assert_eq!(name("000123.json"), Some((String::new(), 123)));
        assert_eq!((name("intri.yml"), name("99999999999999999999.json")), (None, None));
    }
}
