//! The readers that can be fuzzed. A new reader needs a line in [`TARGETS`] and a folder of seeds.

use super::corpus::Input;
use std::io::Cursor;
use wandless::body::loader::{BodyFileError, LandmarkTable, body_from_bytes};
use wandless::session::Session;
use wandless::session::upload::{LoadedSession, UploadError, UploadLimits, read_upload};

/// One reader.
#[derive(Clone, Copy)]
pub(crate) struct Target {
    /// Name on the command line.
    pub(crate) name: &'static str,
    /// Description in the list of targets.
    pub(crate) description: &'static str,
    /// Folder of its seeds in the corpus.
    pub(crate) seeds: &'static str,
    /// Converts a seed to the input that is damaged.
    pub(crate) prepare: fn(Input) -> Input,
    /// Reads a case. An error is a defect; a rejected input is not.
    pub(crate) read: fn(&Input) -> Result<Outcome, String>,
}

/// Outcome of one case.
#[derive(Debug)]
pub(crate) struct Outcome {
    pub(crate) is_accepted: bool,
    /// Distinguishes outcomes: error code and location of a rejected input, or the format of an accepted one.
    pub(crate) label: String,
}

/// All readers of untrusted input.
pub(crate) const TARGETS: &[Target] = &[
    Target { name: "zip", description: "zip files, damaged bytewise", seeds: "poses", prepare: zipped, read: upload },
    Target {
        name: "session_zip",
        description: "files of a zip in the native format",
        seeds: "session",
        prepare: unchanged,
        read: upload_of_files,
    },
    Target {
        name: "session_json",
        description: "a session as JSON or NDJSON",
        seeds: "document",
        prepare: unchanged,
        read: upload,
    },
    Target {
        name: "calibration",
        description: "calibration files",
        seeds: "calibration",
        prepare: unchanged,
        read: upload_of_files,
    },
    Target {
        name: "poses",
        description: "pose files of other tools",
        seeds: "poses",
        prepare: unchanged,
        read: upload_of_files,
    },
    Target {
        name: "opencap",
        description: "camera pickles of OpenCap",
        seeds: "opencap",
        prepare: opencap_upload,
        read: upload_of_files,
    },
    Target {
        name: "array",
        description: "pose arrays of MediaPipe",
        seeds: "array",
        prepare: mediapipe_upload,
        read: upload_of_files,
    },
    Target { name: "npz", description: "body models as npz", seeds: "npz", prepare: unchanged, read: body },
    Target { name: "pickle", description: "body models as pickle", seeds: "pickle", prepare: unchanged, read: body },
    Target {
        name: "landmarks",
        description: "landmark tables",
        seeds: "landmarks",
        prepare: unchanged,
        read: landmarks,
    },
    #[cfg(feature = "service")]
    Target {
        name: "multipart",
        description: "multipart/form-data bodies",
        seeds: "multipart",
        prepare: unchanged,
        read: multipart,
    },
];

fn unchanged(seed: Input) -> Input {
    seed
}

fn zipped(seed: Input) -> Input {
    Input::file(seed.zipped())
}

/// An OpenPose frame with one person of 17 keypoints.
const FRAME: &str = r#"{"people": [{"pose_keypoints_2d": [1,9,1,2,8,1,3,7,1,4,6,1,5,5,1,6,4,1,7,3,1,8,2,1,9,1,1,1,9,1,2,8,1,3,7,1,4,6,1,5,5,1,6,4,1,7,3,1,8,2,1]}]}"#;

/// Turns a camera pickle into an upload of one camera.
fn opencap_upload(seed: Input) -> Input {
    let members = [
        ("session.json", br#"{"fps": 60}"#.to_vec()),
        ("Cam1/cameraIntrinsicsExtrinsics.pickle", seed.bytes().to_vec()),
        ("Cam1/Cam1_000000000000_keypoints.json", FRAME.as_bytes().to_vec()),
    ];
    Input { members: members.map(|(name, bytes)| (name.to_owned(), bytes)).to_vec() }
}

/// Turns an array of two cameras into an upload of two cameras.
fn mediapipe_upload(seed: Input) -> Input {
    let camera = |name| {
        format!(
            "[{name}]\nname = \"{name}\"\nsize = [1280.0, 720.0]\nmatrix = [[800.0, 0.0, 640.0], [0.0, 800.0, 360.0], \
             [0.0, 0.0, 1.0]]\ndistortions = [0.0, 0.0, 0.0, 0.0]\nrotation = [0.0, 0.{name}, 0.0]\n\
             translation = [0.0, 0.0, 4.0]\nfisheye = false\n"
        )
    };
    let members = [
        ("session.json", br#"{"fps": 30}"#.to_vec()),
        ("Calib.toml", (camera(0) + &camera(1)).into_bytes()),
        ("mediapipe2dData.npy", seed.bytes().to_vec()),
    ];
    Input { members: members.map(|(name, bytes)| (name.to_owned(), bytes)).to_vec() }
}

fn upload(case: &Input) -> Result<Outcome, String> {
    outcome_of(read_upload(Cursor::new(case.bytes()), "upload", &UploadLimits::default()))
}

fn upload_of_files(case: &Input) -> Result<Outcome, String> {
    outcome_of(read_upload(Cursor::new(case.zipped()), "upload", &UploadLimits::default()))
}

fn outcome_of(read: Result<LoadedSession, UploadError>) -> Result<Outcome, String> {
    match read {
        Ok(loaded) => {
            require_finite(&loaded.session)?;
            Ok(Outcome { is_accepted: true, label: loaded.format })
        }
        Err(error) => {
            let message = error.to_string();
            if error.remedy.is_empty() || message.contains('\n') {
                return Err(format!("the error message is not one line with a remedy: {message:?}"));
            }
            let place = error.pointer.unwrap_or_default().replace(|c: char| c.is_ascii_digit(), "");
            Ok(Outcome { is_accepted: false, label: format!("{} {}", error.code, place.get(..40).unwrap_or(&place)) })
        }
    }
}

/// Checks that every number of an accepted session is finite.
fn require_finite(session: &Session) -> Result<(), String> {
    for view in &session.views {
        let k = &view.intrinsics;
        let camera = [k.fx, k.fy, k.cx, k.cy, k.skew];
        let pose = view.camera_from_world.iter().flat_map(|pose| pose.rotation.iter().chain(pose.translation.iter()));
        let people = view.frames.iter().flatten().flat_map(|person| &person.keypoints);
        let points = people
            .filter(|point| point.is_present())
            .flat_map(|point| [point.pixel.x, point.pixel.y, point.confidence]);
        let coefficients = k.dist.coefficients().iter().copied();
        if !camera.into_iter().chain(pose.copied()).chain(coefficients).chain(points).all(f64::is_finite) {
            return Err(format!("camera {:?} was accepted with a number that is not finite", view.id));
        }
    }
    if session.fps.is_finite() { Ok(()) } else { Err("a frame rate that is not finite was accepted".to_owned()) }
}

fn body(case: &Input) -> Result<Outcome, String> {
    match body_from_bytes("body".to_owned(), case.bytes(), &LandmarkTable::default()) {
        Ok(_) => Ok(Outcome { is_accepted: true, label: "body".to_owned() }),
        Err(error) => Ok(Outcome { is_accepted: false, label: kind_of(&error) }),
    }
}

/// Variant and field of an error, without its values.
fn kind_of(error: &BodyFileError) -> String {
    format!("{error:?}").chars().filter(|c| !c.is_ascii_digit()).take(24).collect()
}

fn landmarks(case: &Input) -> Result<Outcome, String> {
    let read = LandmarkTable::from_json(case.bytes());
    let label =
        read.as_ref().map_or_else(|error| format!("{error:?}").chars().take(24).collect(), |_| "table".to_owned());
    Ok(Outcome { is_accepted: read.is_ok(), label })
}

#[cfg(feature = "service")]
fn multipart(case: &Input) -> Result<Outcome, String> {
    let read = |piece| wandless::service::http::read_form("multipart/form-data; boundary=AaB", case.bytes(), piece);
    let (whole, pieces) = (read(usize::MAX), read(7));
    if whole != pieces {
        return Err(format!("the form depends on how its bytes arrive: {whole:?}, {pieces:?}"));
    }
    Ok(Outcome {
        is_accepted: whole.is_ok(),
        label: whole.map_or_else(|detail| detail, |parts| parts.len().to_string()),
    })
}
