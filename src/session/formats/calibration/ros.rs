//! ROS `camera_info`: one camera's intrinsics. K is read and not P, since keypoints refer to the raw image.

use super::values::{camera_of_image, invalid, rows_of, size};
use super::yaml::{Yaml, parse};
use crate::session::upload::error::UploadError;
use crate::session::upload::json::ShortList;
use crate::session::upload::raw::RawCamera;

/// The camera of the file, named `camera_name` or after the file.
pub(super) fn read(file: &str, text: &str) -> Result<RawCamera, UploadError> {
    let yaml = parse(text)?;
    let data = |key: &str| yaml.get(key).and_then(|matrix| matrix.get("data")).and_then(Yaml::numbers);
    let whole = |key: &str| {
        let number = yaml.get(key).and_then(Yaml::number).and_then(size);
        number.ok_or_else(|| invalid(format!("`{key}` is missing or not an integer")))
    };
    let matrix = data("camera_matrix").ok_or_else(|| invalid("`camera_matrix` has no `data` of numbers"))?;
    let name = yaml.get("camera_name").and_then(Yaml::text).filter(|name| !name.is_empty());
    let file_name = file.rsplit('/').next().unwrap_or(file);
    Ok(RawCamera {
        id: name.unwrap_or_else(|| camera_of_image(file_name)).to_owned(),
        width: whole("image_width")?,
        height: whole("image_height")?,
        matrix: Some(rows_of(&matrix).ok_or_else(|| invalid("`camera_matrix` does not have 9 entries"))?),
        distortion: data("distortion_coefficients").map(ShortList),
        distortion_model: yaml.get("distortion_model").and_then(Yaml::text).map(str::to_owned),
        ..RawCamera::default()
    })
}
