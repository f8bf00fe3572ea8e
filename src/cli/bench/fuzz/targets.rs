//! What can be fuzzed. A new reader is one more line of [`TARGETS`] and one more folder of seeds.

use super::corpus::Input;
use crate::body::loader::{BodyFileError, LandmarkTable, body_from_bytes};
use crate::session::Session;
use crate::session::upload::{LoadedSession, UploadError, UploadLimits, read_upload};
use std::io::Cursor;

/// One reader.
#[derive(Clone, Copy)]
pub(super) struct Target {
    /// What it is called.
    pub(super) name: &'static str,
    /// For people to read.
    pub(super) what: &'static str,
    /// Folder of its seeds in the corpus.
    pub(super) seeds: &'static str,
    /// Makes of a seed what is damaged.
    pub(super) prepare: fn(Input) -> Input,
    /// Reads a case; an error is a defect, a refusal is none.
    pub(super) read: fn(&Input) -> Result<Outcome, String>,
}

/// What came of one case.
#[derive(Debug)]
pub(super) struct Outcome {
    pub(super) is_accepted: bool,
    /// Tells outcomes apart: the code of the refusal and its place, or the format that was read.
    pub(super) label: String,
}

/// Every reader of foreign bytes.
pub(super) const TARGETS: &[Target] = &[
    Target { name: "zip", what: "a zip, byte by byte", seeds: "poses", prepare: packed, read: upload },
    Target {
        name: "session_zip",
        what: "the files of a native zip",
        seeds: "session",
        prepare: same,
        read: upload_of_files,
    },
    Target {
        name: "session_json",
        what: "a session as JSON or NDJSON",
        seeds: "document",
        prepare: same,
        read: upload,
    },
    Target {
        name: "calibration",
        what: "calibration files",
        seeds: "calibration",
        prepare: same,
        read: upload_of_files,
    },
    Target { name: "poses", what: "other tools' pose files", seeds: "poses", prepare: same, read: upload_of_files },
    Target { name: "opencap", what: "OpenCap's pickles", seeds: "opencap", prepare: of_opencap, read: upload_of_files },
    Target { name: "array", what: "MediaPipe's arrays", seeds: "array", prepare: of_mediapipe, read: upload_of_files },
    Target { name: "npz", what: "body models as npz", seeds: "npz", prepare: same, read: body },
    Target { name: "pickle", what: "body models as pickle", seeds: "pickle", prepare: same, read: body },
    Target { name: "landmarks", what: "landmark tables", seeds: "landmarks", prepare: same, read: landmarks },
    #[cfg(feature = "service")]
    Target { name: "multipart", what: "forms of HTTP", seeds: "multipart", prepare: same, read: multipart },
];

fn same(seed: Input) -> Input {
    seed
}

fn packed(seed: Input) -> Input {
    Input::file(seed.zipped())
}

/// A frame of one person of 17 points, as OpenPose writes it.
const FRAME: &str = r#"{"people": [{"pose_keypoints_2d": [1,9,1,2,8,1,3,7,1,4,6,1,5,5,1,6,4,1,7,3,1,8,2,1,9,1,1,1,9,1,2,8,1,3,7,1,4,6,1,5,5,1,6,4,1,7,3,1,8,2,1]}]}"#;

/// One camera's pickle becomes an upload of one camera.
fn of_opencap(seed: Input) -> Input {
    let members = [
        ("session.json", br#"{"fps": 60}"#.to_vec()),
        ("Cam1/cameraIntrinsicsExtrinsics.pickle", seed.bytes().to_vec()),
        ("Cam1/Cam1_000000000000_keypoints.json", FRAME.as_bytes().to_vec()),
    ];
    Input { members: members.map(|(name, bytes)| (name.to_owned(), bytes)).to_vec() }
}

/// An array of two cameras becomes an upload of two cameras.
fn of_mediapipe(seed: Input) -> Input {
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
            let told = error.to_string();
            if error.remedy.is_empty() || told.contains('\n') {
                return Err(format!("a refusal that is not one line with a remedy: {told:?}"));
            }
            let place = error.pointer.unwrap_or_default().replace(|c: char| c.is_ascii_digit(), "");
            Ok(Outcome { is_accepted: false, label: format!("{} {}", error.code, place.get(..40).unwrap_or(&place)) })
        }
    }
}

/// A number that is none must not come any further.
fn require_finite(session: &Session) -> Result<(), String> {
    for view in &session.views {
        let k = &view.intrinsics;
        let camera = [k.fx, k.fy, k.cx, k.cy, k.skew];
        let placed = view.camera_from_world.iter().flat_map(|pose| pose.rotation.iter().chain(pose.translation.iter()));
        let people = view.frames.iter().flatten().flat_map(|person| &person.keypoints);
        let points = people
            .filter(|point| point.is_present())
            .flat_map(|point| [point.pixel.x, point.pixel.y, point.confidence]);
        let coefficients = k.dist.coefficients().iter().copied();
        if !camera.into_iter().chain(placed.copied()).chain(coefficients).chain(points).all(f64::is_finite) {
            return Err(format!("camera {:?} was accepted with a number that is none", view.id));
        }
    }
    if session.fps.is_finite() { Ok(()) } else { Err("a rate that is no number was accepted".to_owned()) }
}

fn body(case: &Input) -> Result<Outcome, String> {
    match body_from_bytes("body".to_owned(), case.bytes(), &LandmarkTable::default()) {
        Ok(_) => Ok(Outcome { is_accepted: true, label: "body".to_owned() }),
        Err(error) => Ok(Outcome { is_accepted: false, label: kind_of(&error) }),
    }
}

/// The variant and its field, without what was found.
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
    let read = |piece| crate::service::http::read_form("multipart/form-data; boundary=AaB", case.bytes(), piece);
    let (whole, pieces) = (read(usize::MAX), read(7));
    if whole != pieces {
        return Err(format!("cut into pieces it is another form: {whole:?}, {pieces:?}"));
    }
    Ok(Outcome {
        is_accepted: whole.is_ok(),
        label: whole.map_or_else(|detail| detail, |parts| parts.len().to_string()),
    })
}
