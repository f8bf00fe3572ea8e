//! The calibration formats.

/// A kind of calibration file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum CalibrationFormat {
    OpenCvYaml,
    RosCameraInfo,
    Toml,
    ColmapCameras,
    ColmapImages,
    Agisoft,
    Qualisys,
    Dmmr,
    Assoc4d,
    OpenCap,
}

impl CalibrationFormat {
    /// The name in the response to an upload.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::OpenCvYaml => "opencv_yaml",
            Self::RosCameraInfo => "ros_camera_info",
            Self::Toml => "toml",
            Self::ColmapCameras | Self::ColmapImages => "colmap",
            Self::Agisoft => "agisoft_xml",
            Self::Qualisys => "qualisys_qca",
            Self::Dmmr => "dmmr_camparams",
            Self::Assoc4d => "4dassoc_json",
            Self::OpenCap => "opencap_pickle",
        }
    }
}
