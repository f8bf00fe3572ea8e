//! Suspicions: mistakes in a recording's files that its own data reveal.

use serde::{Deserialize, Serialize};
use std::fmt;

/// A probable mistake in the files of a recording, with what speaks for it and what to do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
pub struct Suspicion {
    /// What is probably wrong.
    pub code: SuspicionCode,
    /// The first of `cameras`; null where it is the whole recording.
    #[serde(default)]
    #[cfg_attr(feature = "service", schema(required))]
    pub camera: Option<String>,
    /// Names of the cameras concerned; empty where it is the whole recording.
    pub cameras: Vec<String>,
    /// What was measured and what was expected, without the end of a sentence.
    pub evidence: String,
    /// What to do, without the end of a sentence.
    pub remedy: String,
    /// The option of a job that repairs it, as JSON such as `{"sync": "estimate"}`; null where the files must be changed.
    #[cfg_attr(feature = "service", schema(required))]
    pub suggested_option: Option<String>,
    /// For `resolution`: size of the images in which people were detected over that of the calibration, where one size is likeliest.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub image_scale: Option<f64>,
    /// For `lens_distortion`: the first radial coefficient less the given one; absent where the images look undistorted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radial_change: Option<f64>,
    /// Whether the mistake was undone before the solve (`options.repair: auto`): the result is that of the repaired recording.
    #[serde(default)]
    pub applied: bool,
}

/// The mistakes that are recognised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum SuspicionCode {
    /// The keypoints of two cameras are the same.
    DuplicateCamera,
    /// A camera shows the same keypoints in successive frames.
    RepeatedFrames,
    /// A camera has keypoints in every second, third, fourth or fifth frame only.
    PeriodicGaps,
    /// People are detected twice in the same image.
    DoubleDetections,
    /// Coordinates are shares of the image's size instead of pixels.
    NormalizedCoordinates,
    /// Keypoints were detected in images of another size than the calibrated ones.
    Resolution,
    /// The images were turned by 90 degrees after the calibration, or before it.
    Rotated,
    /// The principal point is far from the centre of the image, as after an exchange of `cx` and `cy`.
    PrincipalPoint,
    /// Confidences are too low, as after a division by a constant.
    LowConfidence,
    /// The keypoints are in the order of another convention.
    Convention,
    /// The given poses of the cameras contradict the keypoints; another interpretation explains them.
    GivenPoses,
    /// Left and right are exchanged in all cameras, or all images are mirrored: the two give mirrored results.
    Handedness,
    /// Pixels are counted from the lower edge of the image.
    YUpwards,
    /// The images of a camera are mirrored.
    Mirrored,
    /// Left and right are exchanged in a camera.
    LabelsExchanged,
    /// The focal length of a camera, or of all, is wrong.
    FocalLength,
    /// The keypoints, or the calibrations, of two cameras are exchanged.
    CamerasExchanged,
    /// The frames of a camera are early or late.
    TimeOffset,
    /// The frames of a camera slip against the others during the recording: some were dropped or doubled, or its rate differs.
    DroppedFrames,
    /// The frame rate is wrong.
    FrameRate,
    /// A camera was moved during the recording.
    CameraMoved,
    /// A camera zoomed during the recording.
    CameraZoomed,
    /// The images of a camera were stretched after its calibration, or before it.
    PixelAspect,
    /// The images are distorted otherwise than the lens says: it was left out, or images were undistorted after the calibration.
    LensDistortion,
    /// The cameras fall into groups that show different takes.
    SeveralTakes,
    /// More people move through the scene than the options allow.
    PeopleLimit,
}

impl SuspicionCode {
    /// Whether the mistake makes the cameras of a solution wrong by more than their standard deviations.
    pub fn affects_cameras(self) -> bool {
        !matches!(
            self,
            Self::LowConfidence
                | Self::PeriodicGaps
                | Self::DoubleDetections
                | Self::LabelsExchanged
                | Self::FrameRate
                | Self::PeopleLimit
        )
    }

    /// Whether it is undone without being asked for: of two detections of one person either is right.
    pub fn is_always_undone(self) -> bool {
        self == Self::DoubleDetections
    }

    /// Its name in files and answers.
    pub fn name(self) -> String {
        serde_json::to_value(self).ok().and_then(|name| name.as_str().map(str::to_owned)).unwrap_or_default()
    }
}

impl Suspicion {
    /// One for which no option helps; about the whole recording without `cameras`.
    pub fn new(
        code: SuspicionCode,
        cameras: Vec<String>,
        evidence: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        let (evidence, remedy) = (evidence.into(), remedy.into());
        Self {
            code,
            camera: cameras.first().cloned(),
            cameras,
            evidence,
            remedy,
            suggested_option: None,
            image_scale: None,
            radial_change: None,
            applied: false,
        }
    }

    /// Whether the standard deviations of a camera's pose are void, since they rest on the files being right.
    pub fn voids_uncertainty_of(&self, camera: &str) -> bool {
        self.code.affects_cameras()
            && !self.applied
            && (self.cameras.is_empty() || self.cameras.iter().any(|id| id == camera))
    }

    /// The sentence for a user: cameras, evidence, and after the semicolon the remedy.
    pub fn sentence(&self) -> String {
        let cameras = match self.cameras.as_slice() {
            [] => String::new(),
            [camera] => format!("camera {camera}: "),
            cameras => format!("cameras {}: ", cameras.join(", ")),
        };
        format!("{cameras}{}; {}", self.evidence, self.remedy)
    }
}

impl fmt::Display for Suspicion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.sentence())
    }
}
