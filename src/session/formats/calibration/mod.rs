//! Readers of calibration files, recognised by content: each returns the cameras of its file, which are merged by name.

mod agisoft;
mod assoc4d;
mod colmap;
mod dmmr;
mod format;
mod opencap;
mod opencv_yaml;
mod qualisys;
mod ros;
mod toml_cameras;
mod values;
mod yaml;

pub(crate) use format::CalibrationFormat;
pub(crate) use opencap::recognise as is_opencap;

use crate::session::upload::error::{Fault, UploadError};
use crate::session::upload::raw::RawCamera;
use crate::session::upload::warnings::Warnings;

/// Content of all calibration files of an upload.
#[derive(Debug, Default)]
pub(crate) struct Calibration {
    /// Names of the formats, in order of reading, each once.
    pub(crate) formats: Vec<&'static str>,
    pub(crate) cameras: Vec<RawCamera>,
    /// Frames per second, where a file contains it.
    pub(crate) fps: Option<f64>,
    colmap: colmap::Model,
}

/// Recognises a calibration file by its beginning; `None` for anything else.
pub(crate) fn recognise(head: &str) -> Option<CalibrationFormat> {
    use CalibrationFormat as F;
    let start = head.trim_start();
    let has_line = |prefix: &str| head.lines().any(|line| line.trim_start().starts_with(prefix));
    if start.starts_with('<') {
        if qualisys::recognise(head) {
            return Some(F::Qualisys);
        }
        return (head.contains("<sensor") || head.contains("<chunk")).then_some(F::Agisoft);
    }
    if start.starts_with("%YAML") || head.contains("!!opencv-matrix") {
        return Some(F::OpenCvYaml);
    }
    if has_line("camera_matrix:") || has_line("distortion_model:") {
        return Some(F::RosCameraInfo);
    }
    if start.starts_with('{') {
        return assoc4d::recognise(head).then_some(F::Assoc4d);
    }
    if has_line("[") && ["matrix", "frame_rate", "distortions"].iter().any(|key| has_line(key)) {
        return Some(F::Toml);
    }
    colmap::recognise(head).or_else(|| dmmr::recognise(head).then_some(F::Dmmr))
}

impl Calibration {
    /// Reads one more file.
    ///
    /// # Errors
    /// Invalid content, or an unsupported lens model.
    pub(crate) fn add(
        &mut self,
        format: CalibrationFormat,
        file: &str,
        bytes: &[u8],
        warnings: &mut Warnings,
    ) -> Result<(), UploadError> {
        use CalibrationFormat as F;
        let text = match format {
            F::OpenCap => "",
            _ => std::str::from_utf8(bytes).map_err(|_| Fault::Encoding.with("the calibration file is not UTF-8"))?,
        };
        let cameras = match format {
            F::OpenCvYaml => opencv_yaml::read(text)?,
            F::RosCameraInfo => vec![ros::read(file, text)?],
            F::Toml => toml_cameras::read(text, &mut self.fps, warnings)?,
            F::ColmapCameras => self.colmap.add_cameras(text).map(|()| Vec::new())?,
            F::ColmapImages => self.colmap.add_images(text).map(|()| Vec::new())?,
            F::Agisoft => agisoft::read(text, warnings)?,
            F::Qualisys => qualisys::read(text, warnings)?,
            F::Dmmr => dmmr::read(text)?,
            F::Assoc4d => assoc4d::read(text)?,
            F::OpenCap => vec![opencap::read(file, bytes)?],
        };
        if !self.formats.contains(&format.name()) {
            self.formats.push(format.name());
        }
        cameras.into_iter().for_each(|camera| self.merge(camera));
        Ok(())
    }

    /// Merges values that are spread over several files, after all have been read.
    ///
    /// # Errors
    /// An image of an unknown camera.
    pub(crate) fn finish(&mut self, warnings: &mut Warnings) -> Result<(), UploadError> {
        for camera in std::mem::take(&mut self.colmap).into_cameras(warnings)? {
            self.merge(camera);
        }
        Ok(())
    }

    /// Adds a camera, or completes it with the values of a second file.
    pub(crate) fn merge(&mut self, camera: RawCamera) {
        let Some(own) = self.cameras.iter_mut().find(|own| own.id == camera.id) else {
            self.cameras.push(camera);
            return;
        };
        if own.width == 0 || own.height == 0 {
            (own.width, own.height) = (camera.width, camera.height);
        }
        own.matrix = own.matrix.take().or(camera.matrix);
        own.distortion = own.distortion.take().or(camera.distortion);
        own.distortion_model = own.distortion_model.take().or(camera.distortion_model);
        own.rotation = own.rotation.take().or(camera.rotation);
        own.translation = own.translation.take().or(camera.translation);
        own.time_offset = own.time_offset.or(camera.time_offset);
    }
}
