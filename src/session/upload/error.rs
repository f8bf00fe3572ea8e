//! All reasons for which an upload is refused, with their codes and remedies.

use std::fmt;

/// The class of a refusal; the service maps each class to an HTTP status.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UploadErrorKind {
    /// The bytes do not follow the declared format.
    Malformed,
    /// The upload exceeds a limit.
    TooLarge,
    /// A container, an encoding or a dialect that is not supported.
    Unsupported,
    /// Well-formed, but no such capture can exist or be solved.
    Impossible,
}

/// A refused upload: what is wrong, where, and what to do.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub struct UploadError {
    /// Class of the error.
    pub kind: UploadErrorKind,
    /// Machine-readable code; one of [`Fault::ALL`]'s codes.
    pub code: &'static str,
    /// File or archive member.
    pub file: Option<String>,
    /// Camera id.
    pub camera: Option<String>,
    /// The session's own frame number.
    pub frame: Option<i64>,
    /// Index of the person in the frame.
    pub person: Option<usize>,
    /// JSON pointer (RFC 6901) into the file; in NDJSON its first part is the line's number from 0.
    pub pointer: Option<String>,
    /// What is wrong, with the value found and the value expected.
    pub detail: String,
    /// What the sender can do about it.
    pub remedy: String,
}

impl fmt::Display for UploadError {
    /// One line: location, detail, remedy. Names are quoted and escaped, so that the message has no line breaks.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut place = Vec::new();
        place.extend(self.file.as_ref().map(|file| format!("file {}", shown(file))));
        place.extend(self.camera.as_ref().map(|camera| format!("camera {}", shown(camera))));
        place.extend(self.frame.map(|frame| format!("frame {frame}")));
        place.extend(self.person.map(|person| format!("person {person}")));
        place.extend(self.pointer.as_ref().map(|pointer| format!("at {}", shown(pointer))));
        let place = if place.is_empty() { "upload".to_owned() } else { place.join(", ") };
        write!(f, "{place}: {} ({}); {}", self.detail, self.code, self.remedy)
    }
}

/// A user's string for a message: quoted, escaped, at most some 80 characters long.
pub(crate) fn shown(text: &str) -> String {
    const MAX_CHARS: usize = 80;
    match text.char_indices().nth(MAX_CHARS) {
        Some((end, _)) => format!("{:?}…", &text[..end]),
        None => format!("{text:?}"),
    }
}

/// Escapes control characters: messages of other libraries may quote the file.
fn one_line(text: String) -> String {
    if !text.contains(char::is_control) {
        return text;
    }
    text.chars().flat_map(|c| if c.is_control() { c.escape_debug().collect() } else { vec![c] }).collect()
}

/// Defines [`Fault`] from one row per fault: name, code, kind, remedy.
macro_rules! faults {
    ($($fault:ident, $code:literal, $kind:ident, $remedy:literal;)*) => {
        /// Every reason for which an upload is refused.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        #[allow(missing_docs)] // documented by its code and its remedy
        pub enum Fault {
            $($fault,)*
        }

        impl Fault {
            /// Every fault, for the service's description and for tests.
            pub const ALL: &[Self] = &[$(Self::$fault,)*];

            /// Code, kind and remedy.
            fn row(self) -> (&'static str, UploadErrorKind, &'static str) {
                match self {
                    $(Self::$fault => ($code, UploadErrorKind::$kind, $remedy),)*
                }
            }
        }
    };
}

faults! {
    FileUnreadable, "file_unreadable", Malformed, "check the path and its permissions";
    FormatUnknown, "format_unknown", Unsupported, "send a session folder, a zip of it, or a JSON or NDJSON document";
    PosesNotDetected, "poses_not_detected", Unsupported,
        "detect 2D poses in every video first, for example with OpenPose (openpose.bin --video cam1.mp4 --write_json poses/cam1 \
         --display 0 --render_pose 0), then send the folder of its JSON files with the calibration (docs/videos.md)";
    Encoding, "encoding", Malformed, "save the file as UTF-8 without a byte order mark";
    ZipInvalid, "zip_invalid", Malformed, "the archive is truncated or damaged: create it again and resend it";
    ZipNameUnsafe, "zip_name_unsafe", Malformed, "archive the session folder with plain relative names";
    ZipSymlink, "zip_symlink", Malformed, "archive the files themselves instead of links";
    ZipDuplicateMember, "zip_duplicate_member", Malformed, "archive every file only once";
    ZipOverlap, "zip_overlap", Malformed, "create the archive again; its members must not share bytes";
    ZipCorrupt, "zip_corrupt", Malformed, "the member does not decompress to its stated content: resend the archive";
    ZipEncrypted, "zip_encrypted", Unsupported, "create the archive without a password";
    ZipMethod, "zip_method", Unsupported, "compress with deflate, or store without compression";
    ZipRatio, "zip_ratio", TooLarge, "pose files do not compress that well: archive the actual session";
    TooLarge, "too_large", TooLarge, "send fewer frames or fewer cameras";
    TooManyMembers, "too_many_members", TooLarge, "archive only poses and calibration, without images";
    TooManyCameras, "too_many_cameras", TooLarge, "remove some of the cameras";
    TooManyFrames, "too_many_frames", TooLarge, "split the recording into shorter sessions";
    TooManyPeople, "too_many_people", TooLarge, "keep only the most confident people of the frame";
    TooManyKeypoints, "too_many_keypoints", TooLarge, "split the recording into shorter sessions";
    TokenTooLong, "token_too_long", TooLarge, "remove content other than poses";
    JsonTooDeep, "json_too_deep", Malformed, "follow the session layout, which has 8 levels of nesting";
    JsonInvalid, "json_invalid", Malformed, "write the file with a JSON library";
    JsonType, "json_type", Malformed, "follow the session layout";
    TrailingData, "trailing_data", Malformed, "remove everything after the document";
    DuplicateKey, "duplicate_key", Malformed, "write every key only once";
    MissingField, "missing_field", Malformed, "add the missing field";
    NumberNotFinite, "number_not_finite", Malformed, "write a missing keypoint as [0, 0, 0]";
    SessionAmbiguous, "session_ambiguous", Malformed, "send one session per upload, with one file of poses per camera";
    PosesMissing, "poses_missing", Malformed, "add poses/<camera id>.json, or `poses` inline";
    NoCameras, "no_cameras", Impossible, "list at least one camera";
    NoFrames, "no_frames", Impossible, "send at least one frame with a frame number";
    FpsInvalid, "fps_invalid", Impossible, "give frames per second between 0.1 and 2000";
    TimeInvalid, "time_invalid", Impossible, "correct the value or remove it";
    ConventionUnknown, "convention_unknown", Impossible, "use one of the supported conventions";
    CameraIdInvalid, "camera_id_invalid", Impossible, "give every camera a short, non-empty id";
    CameraDuplicate, "camera_duplicate", Impossible, "give every camera a unique id";
    CameraUnknown, "camera_unknown", Impossible, "list the camera in `cameras` of the session";
    CameraInvalid, "camera_invalid", Impossible, "correct the camera's calibration";
    DistortionUnsupported, "distortion_unsupported", Impossible,
        "undistort the keypoints, or calibrate with OpenCV's 5, rational 8 or fisheye 4 coefficients";
    FrameInvalid, "frame_invalid", Impossible, "number frames with integers below 2^53";
    FrameOutOfRange, "frame_out_of_range", Impossible, "correct `first_frame` or `n_frames`";
    FrameDuplicate, "frame_duplicate", Impossible, "write every frame of a camera only once";
    KeypointCount, "keypoint_count", Impossible, "correct `keypoint_convention` or the detector's output";
    KeypointInvalid, "keypoint_invalid", Impossible, "write keypoints as [x px, y px, confidence 0 to 1]";
    LandmarksInvalid, "landmarks_invalid", Impossible,
        "give every landmark a unique name and `terms` [{joint, weight, offset}] whose weights sum to 1, and all points of a \
         convention, such as coco17, by name";
    CovarianceInvalid, "covariance_invalid", Impossible,
        "give `covariances` as [xx, xy, yy] in px^2, positive definite, or `sigmas` in px; one per keypoint, null where unknown";
    CalibrationInvalid, "calibration_invalid", Malformed, "export the file again with the tool that wrote it";
    TableInvalid, "table_invalid", Malformed, "export the table again with the tool that wrote it";
    SkeletonUnknown, "skeleton_unknown", Impossible,
        "name the joints: `keypoint_convention` or `keypoint_names` in session.json";
    ImageSizeUnknown, "image_size_unknown", Impossible, "give `width` and `height` of the camera in session.json";
}

impl Fault {
    /// The machine-readable reason.
    pub fn code(self) -> &'static str {
        self.row().0
    }

    /// Class of the error.
    pub fn kind(self) -> UploadErrorKind {
        self.row().1
    }

    /// The error with its detail; callers that know the location fill it in.
    pub(crate) fn with(self, detail: impl Into<String>) -> UploadError {
        let (code, kind, remedy) = self.row();
        UploadError {
            kind,
            code,
            file: None,
            camera: None,
            frame: None,
            person: None,
            pointer: None,
            detail: one_line(detail.into()),
            remedy: remedy.to_owned(),
        }
    }

    /// This fault as an error where `is_present`, with the detail.
    ///
    /// # Errors
    /// This fault, without a location.
    #[inline]
    pub(crate) fn when<D: Into<String>>(self, is_present: bool, detail: impl FnOnce() -> D) -> Result<(), UploadError> {
        if is_present { Err(self.with(detail())) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_unique_and_have_remedies() {
        let mut codes: Vec<_> = Fault::ALL.iter().map(|fault| fault.code()).collect();
        codes.sort_unstable();
        codes.dedup();
        assert_eq!(codes.len(), Fault::ALL.len());
        assert!(Fault::ALL.iter().all(|fault| !fault.with("x").remedy.is_empty()));
    }

    #[test]
    fn escapes_line_breaks_that_a_library_quotes() {
        let error = Fault::CalibrationInvalid.with("expected '>' not '\n' at 2:769");
        assert_eq!(error.detail, "expected '>' not '\\n' at 2:769");
    }

    #[test]
    fn escapes_names_in_messages() {
        let error = UploadError {
            camera: Some("a\nb\u{202e}c".to_owned()),
            frame: Some(-3),
            person: Some(2),
            ..Fault::KeypointCount.with("17 keypoints expected, found 25")
        };
        assert_eq!(
            error.to_string(),
            "camera \"a\\nb\\u{202e}c\", frame -3, person 2: 17 keypoints expected, found 25 (keypoint_count); \
             correct `keypoint_convention` or the detector's output"
        );
    }
}
