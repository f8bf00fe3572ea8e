//! Readers of calibration files, recognised by content: each returns the cameras of its file, which are merged by name.

mod agisoft;
mod assoc4d;
mod colmap;
mod dmmr;
mod format;
mod merging;
mod opencap;
mod opencv_yaml;
mod qualisys;
mod ros;
mod toml_cameras;
mod values;
mod yaml;

pub(crate) use format::CalibrationFormat;
pub(crate) use opencap::recognise as is_opencap;

use crate::session::formats::poses::without_mark;
use crate::session::upload::error::{Fault, UploadError};
use crate::session::upload::raw::RawCamera;
use crate::session::upload::warnings::Warnings;
use merging::MergedCameras;
use ros::RosCamera;

/// Content of all calibration files of an upload.
#[derive(Debug, Default)]
pub(crate) struct Calibration {
    /// Names of the formats, in order of reading, each once.
    pub(crate) formats: Vec<&'static str>,
    /// Frames per second, where a file contains it.
    pub(crate) fps: Option<f64>,
    /// Each with its file, in order of reading.
    found: Vec<(RawCamera, String)>,
    colmap: colmap::Model,
    /// The cameras of ROS with their places in `found`: which of their possible names differ shows when all have been read.
    ros: Vec<(usize, RosCamera)>,
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
    // OpenCV's own calibration program writes the keys of ROS in its own kind of YAML.
    if has_line("camera_matrix:") {
        return Some(F::RosCameraInfo);
    }
    if start.starts_with("%YAML") || head.contains("!!opencv-matrix") {
        return Some(F::OpenCvYaml);
    }
    if has_line("distortion_model:") {
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
            _ => std::str::from_utf8(without_mark(bytes))
                .map_err(|_| Fault::Encoding.with("the calibration file is not UTF-8"))?,
        };
        let cameras = match format {
            F::OpenCvYaml => opencv_yaml::read(text)?,
            F::RosCameraInfo => {
                self.ros.push((self.found.len(), ros::read(file, text)?));
                Vec::new()
            }
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
        self.found.extend(cameras.into_iter().map(|camera| (camera, file.to_owned())));
        Ok(())
    }

    /// The cameras of all files, those of the session's header (`own`, in file `header`) last.
    ///
    /// # Errors
    /// An image of an unknown camera, or two files that contradict each other about a camera.
    pub(crate) fn cameras(
        &mut self,
        own: impl Iterator<Item = RawCamera>,
        header: &str,
        warnings: &mut Warnings,
    ) -> Result<Vec<RawCamera>, UploadError> {
        let mut merged = MergedCameras::default();
        let mut ros = ros::named(std::mem::take(&mut self.ros)).into_iter().peekable();
        for (place, (camera, file)) in std::mem::take(&mut self.found).into_iter().enumerate() {
            while let Some((_, camera, file)) = ros.next_if(|(before, _, _)| *before <= place) {
                merged.add(camera, &file)?;
            }
            merged.add(camera, &file)?;
        }
        ros.try_for_each(|(_, camera, file)| merged.add(camera, &file))?;
        let colmap = std::mem::take(&mut self.colmap).into_cameras(warnings)?;
        colmap.into_iter().try_for_each(|camera| merged.add(camera, "cameras.txt"))?;
        own.into_iter().try_for_each(|camera| merged.add(camera, header))?;
        Ok(merged.into_cameras())
    }
}
