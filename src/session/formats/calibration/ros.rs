//! ROS `camera_info`, and what OpenCV's calibration program writes under the same keys: one camera's intrinsics. K is read and not P, since keypoints refer to the raw image.

use super::values::{camera_of_image, invalid, rows_of, size};
use super::yaml::{Yaml, parse};
use crate::session::upload::error::UploadError;
use crate::session::upload::json::ShortList;
use crate::session::upload::raw::RawCamera;
use std::collections::BTreeSet;

/// The camera of a file.
#[derive(Debug)]
pub(super) struct RosCamera {
    camera: RawCamera,
    file: String,
    /// `camera_name`, where given.
    name: Option<String>,
}

impl RosCamera {
    /// Possible names, the best first. ROS's calibration tool writes the same `camera_name` into the files of all cameras.
    fn names(&self) -> [&str; 3] {
        let of_file = camera_of_image(self.file.rsplit('/').next().unwrap_or(&self.file));
        [self.name.as_deref().unwrap_or(of_file), of_file, camera_of_image(&self.file)]
    }
}

/// The cameras, each with the number that came with it and its file: with the best names that differ between all of them.
pub(super) fn named(cameras: Vec<(usize, RosCamera)>) -> Vec<(usize, RawCamera, String)> {
    let differ = |level: &usize| {
        let names: BTreeSet<&str> = cameras.iter().map(|(_, camera)| camera.names()[*level]).collect();
        names.len() == cameras.len()
    };
    let level = (0..3).find(differ).unwrap_or(0);
    let named = |(number, camera): (usize, RosCamera)| {
        let id = camera.names()[level].to_owned();
        (number, RawCamera { id, ..camera.camera }, camera.file)
    };
    cameras.into_iter().map(named).collect()
}

/// The camera of the file.
pub(super) fn read(file: &str, text: &str) -> Result<RosCamera, UploadError> {
    let yaml = parse(text)?;
    let data = |key: &str| yaml.get(key).and_then(|matrix| matrix.get("data")).and_then(Yaml::numbers);
    let whole = |key: &str| {
        let number = yaml.get(key).and_then(Yaml::number).and_then(size);
        number.ok_or_else(|| invalid(format!("`{key}` is missing or not an integer")))
    };
    let matrix = data("camera_matrix").ok_or_else(|| invalid("`camera_matrix` has no `data` of numbers"))?;
    let name = yaml.get("camera_name").and_then(Yaml::text).filter(|name| !name.is_empty());
    let model = yaml.get("distortion_model").and_then(Yaml::text);
    let is_fisheye = yaml.get("fisheye_model").and_then(Yaml::number) == Some(1.0);
    let camera = RawCamera {
        width: whole("image_width")?,
        height: whole("image_height")?,
        matrix: Some(rows_of(&matrix).ok_or_else(|| invalid("`camera_matrix` does not have 9 entries"))?),
        distortion: data("distortion_coefficients").map(ShortList),
        distortion_model: model.or(is_fisheye.then_some("fisheye")).map(str::to_owned),
        ..RawCamera::default()
    };
    Ok(RosCamera { camera, file: file.to_owned(), name: name.map(str::to_owned) })
}
