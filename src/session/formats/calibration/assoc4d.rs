//! 4DAssoc's `calibration.json`: per camera `K` (9 numbers), `RT` (12 numbers, `[R t]`), `imgSize` (width, height).
//!
//! Its detection files contain joints that are not yet assigned to people, and are not read.

use super::values::{invalid, rows_of, size, split_pose};
use crate::session::upload::error::UploadError;
use crate::session::upload::raw::RawCamera;
use serde::Deserialize;
use std::collections::BTreeMap;

#[derive(Deserialize)]
struct Camera {
    #[serde(rename = "K")]
    matrix: Vec<f64>,
    #[serde(rename = "RT")]
    pose: Vec<f64>,
    #[serde(rename = "imgSize")]
    image_size: Option<Vec<f64>>,
}

/// Whether the first camera has a `K` and an `RT`.
pub(super) fn recognise(head: &str) -> bool {
    head.trim_start().starts_with('{') && head.contains("\"K\"") && head.contains("\"RT\"")
}

/// All cameras, in the order of names.
pub(super) fn read(text: &str) -> Result<Vec<RawCamera>, UploadError> {
    let cameras: BTreeMap<String, Camera> = serde_json::from_str(text).map_err(|e| invalid(e.to_string()))?;
    cameras.into_iter().map(|(id, camera)| camera_of(id, &camera)).collect()
}

fn camera_of(id: String, camera: &Camera) -> Result<RawCamera, UploadError> {
    let wrong = |field: &str, n: usize| UploadError {
        camera: Some(id.clone()),
        ..invalid(format!("`{field}` does not have {n} entries"))
    };
    let matrix = rows_of(&camera.matrix).ok_or_else(|| wrong("K", 9))?;
    if camera.pose.len() != 12 {
        return Err(wrong("RT", 12));
    }
    let (rotation, translation) = split_pose(&camera.pose);
    let whole = |i: usize| camera.image_size.as_ref().and_then(|s| s.get(i).copied()).and_then(size).unwrap_or(0);
    Ok(RawCamera {
        width: whole(0),
        height: whole(1),
        matrix: Some(matrix),
        rotation,
        translation: Some(translation),
        id,
        ..RawCamera::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_matrices_row_by_row() {
        let text = r#"{"0": {"K": [1000, 0, 512, 0, 1001, 384, 0, 0, 1], "imgSize": [1024, 768],
                       "RT": [0, -1, 0, 0.5, 1, 0, 0, 0.25, 0, 0, 1, 3]}}"#;
        assert!(recognise(text) && !recognise(r#"{"people": []}"#));
        let camera = &read(text).unwrap()[0];
        assert_eq!((camera.id.as_str(), camera.width, camera.height), ("0", 1024, 768));
        assert_eq!(camera.rotation.as_ref().unwrap().0[0].0, [0.0, -1.0, 0.0]);
        assert_eq!(camera.translation.as_ref().unwrap().0, [0.5, 0.25, 3.0]);
        assert!(read(&text.replace("[1024, 768]", "null").replace("0.25, ", "")).is_err());
    }
}
