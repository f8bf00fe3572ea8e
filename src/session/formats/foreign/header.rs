//! `session.json` beside other tools' files: values that those files do not contain; every field is optional.

use crate::session::formats::time::FrameRate;
use crate::session::upload::error::UploadError;
use crate::session::upload::json::{Numbers, Rows, document_from_bytes};
use crate::session::upload::raw::RawCamera;
use serde::Deserialize;

/// The fields of the native header, and `keypoint_names`: the joints of a custom skeleton in the detector's order.
#[derive(Debug, Default, Deserialize)]
pub(super) struct Header {
    pub(super) name: Option<String>,
    pub(super) fps: Option<FrameRate>,
    pub(super) first_frame: Option<i64>,
    pub(super) n_frames: Option<u64>,
    pub(super) keypoint_convention: Option<String>,
    pub(super) keypoint_names: Option<Vec<String>>,
    pub(super) up_axis: Option<String>,
    pub(super) start_timecode: Option<String>,
    #[serde(default)]
    cameras: Vec<HeaderCamera>,
}

#[derive(Debug, Deserialize)]
struct HeaderCamera {
    id: String,
    #[serde(default)]
    width: u32,
    #[serde(default)]
    height: u32,
    #[serde(rename = "K")]
    matrix: Option<Rows>,
    dist: Option<Numbers>,
    #[serde(alias = "dist_model")]
    distortion_model: Option<String>,
    fisheye: Option<bool>,
    #[serde(rename = "R")]
    rotation: Option<Rows>,
    #[serde(rename = "t")]
    translation: Option<Numbers>,
    time_offset_s: Option<f64>,
}

impl Header {
    /// Reads the file's bytes.
    ///
    /// # Errors
    /// An invalid document.
    pub(super) fn read(bytes: &[u8]) -> Result<Self, UploadError> {
        document_from_bytes(bytes)
    }

    /// Cameras with the fields that the header gives.
    pub(super) fn take_cameras(&mut self) -> Vec<RawCamera> {
        let camera = |camera: HeaderCamera| RawCamera {
            id: camera.id,
            width: camera.width,
            height: camera.height,
            matrix: camera.matrix,
            distortion: camera.dist,
            distortion_model: camera.distortion_model.or((camera.fisheye == Some(true)).then(|| "fisheye".to_owned())),
            rotation: camera.rotation,
            translation: camera.translation,
            time_offset: camera.time_offset_s,
        };
        std::mem::take(&mut self.cameras).into_iter().map(camera).collect()
    }
}
