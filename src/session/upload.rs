//! Stand-in in this worktree only: the native layout as a folder, a stored zip or one JSON document.
#![allow(missing_docs)]

use super::recording::{Detection, FrameIndex, Keypoint, Session, View};
use crate::body::skeleton::KeypointConvention;
use crate::geometry::{Intrinsics, Rigid};
use nalgebra::{Matrix3, Vector2, Vector3};
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

#[derive(Debug, Default)]
pub struct UploadLimits {}

#[derive(Debug)]
pub struct LoadedSession {
    pub session: Session,
    pub format: &'static str,
    pub warnings: Vec<String>,
    pub sha256: String,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UploadErrorKind {
    Malformed,
    TooLarge,
    Unsupported,
    Impossible,
}

#[derive(Debug, thiserror::Error)]
#[error("{detail}; {remedy}")]
pub struct UploadError {
    pub kind: UploadErrorKind,
    pub code: &'static str,
    pub file: Option<String>,
    pub camera: Option<String>,
    pub frame: Option<i64>,
    pub person: Option<usize>,
    pub pointer: Option<String>,
    pub detail: String,
    pub remedy: String,
}

fn bad(detail: impl Into<String>) -> UploadError {
    UploadError {
        kind: UploadErrorKind::Malformed,
        code: "malformed",
        file: Some("session.json".into()),
        camera: None,
        frame: None,
        person: None,
        pointer: None,
        detail: detail.into(),
        remedy: "mend the file".into(),
    }
}

pub fn read_path(path: &Path, limits: &UploadLimits) -> Result<LoadedSession, UploadError> {
    if !path.is_dir() {
        return read_file(path, limits);
    }
    let mut files = BTreeMap::new();
    let text = |p: &Path| std::fs::read_to_string(p).map_err(|e| bad(format!("{}: {e}", p.display())));
    files.insert("session.json".to_owned(), text(&path.join("session.json"))?);
    if let Ok(entries) = std::fs::read_dir(path.join("poses")) {
        for entry in entries.flatten() {
            files.insert(format!("poses/{}", entry.file_name().to_string_lossy()), text(&entry.path())?);
        }
    }
    load(files, String::new())
}

pub fn read_file(path: &Path, limits: &UploadLimits) -> Result<LoadedSession, UploadError> {
    read_upload(std::fs::File::open(path).map_err(|e| bad(e.to_string()))?, "", limits)
}

pub fn read_upload<R: Read>(mut reader: R, _: &str, _: &UploadLimits) -> Result<LoadedSession, UploadError> {
    use sha2::Digest;
    let mut bytes = Vec::new();
    reader.read_to_end(&mut bytes).map_err(|e| bad(e.to_string()))?;
    let sha256 = sha2::Sha256::digest(&bytes).iter().map(|b| format!("{b:02x}")).collect();
    let mut files = BTreeMap::new();
    if bytes.starts_with(b"PK") {
        let mut archive = zip::ZipArchive::new(std::io::Cursor::new(bytes)).map_err(|e| bad(e.to_string()))?;
        for i in 0..archive.len() {
            let mut member = archive.by_index(i).map_err(|e| bad(e.to_string()))?;
            let mut text = String::new();
            member.read_to_string(&mut text).map_err(|e| bad(e.to_string()))?;
            files.insert(format!("{}", member.name().unwrap_or_default()), text);
        }
    } else {
        files.insert("session.json".into(), String::from_utf8(bytes).map_err(|e| bad(e.to_string()))?);
    }
    load(files, sha256)
}

fn load(files: BTreeMap<String, String>, sha256: String) -> Result<LoadedSession, UploadError> {
    let text = files.get("session.json").ok_or_else(|| bad("no session.json"))?;
    let root: Value = serde_json::from_str(text).map_err(|e| bad(e.to_string()))?;
    let n_frames = root["n_frames"].as_u64().ok_or_else(|| bad("n_frames"))? as usize;
    let convention = root["keypoint_convention"].as_str().and_then(KeypointConvention::parse);
    let convention = convention.ok_or_else(|| bad("keypoint_convention"))?;
    let mut views = Vec::new();
    for camera in root["cameras"].as_array().ok_or_else(|| bad("cameras"))? {
        let id = camera["id"].as_str().ok_or_else(|| bad("camera id"))?.to_owned();
        let n = |v: &Value| v.as_f64().unwrap_or(0.0);
        let k = &camera["K"];
        let intrinsics = Intrinsics {
            width: n(&camera["width"]) as u32,
            height: n(&camera["height"]) as u32,
            fx: n(&k[0][0]),
            fy: n(&k[1][1]),
            cx: n(&k[0][2]),
            cy: n(&k[1][2]),
            skew: n(&k[0][1]),
            dist: std::array::from_fn(|i| n(&camera["dist"][i])),
        };
        let camera_from_world = camera["R"].is_array().then(|| Rigid {
            rotation: Matrix3::from_fn(|i, j| n(&camera["R"][i][j])),
            translation: Vector3::from_fn(|i, _| n(&camera["t"][i])),
        });
        let poses: Value = match files.get(&format!("poses/{id}.json")) {
            Some(text) => serde_json::from_str(text).map_err(|e| bad(e.to_string()))?,
            None => root["poses"][&id].clone(),
        };
        let mut frames = vec![Vec::new(); n_frames];
        let mut delivered = Vec::new();
        for frame in poses["frames"].as_array().ok_or_else(|| bad(format!("no poses of {id}")))? {
            let index = frame["frame"].as_u64().unwrap_or(0) as usize;
            delivered.push(FrameIndex(index));
            for person in frame["people"].as_array().into_iter().flatten() {
                let keypoints = person["keypoints"].as_array().into_iter().flatten();
                let keypoints = keypoints
                    .map(|p| Keypoint { pixel: Vector2::new(n(&p[0]), n(&p[1])), confidence: n(&p[2]) })
                    .collect();
                let slot: &mut Vec<Detection> = frames.get_mut(index).ok_or_else(|| bad("frame"))?;
                slot.push(Detection { track_id: person["track_id"].as_i64(), keypoints });
            }
        }
        views.push(View { id, intrinsics, camera_from_world, frames, delivered });
    }
    let session = Session {
        name: root["name"].as_str().unwrap_or("").to_owned(),
        fps: root["fps"].as_f64().ok_or_else(|| bad("fps"))?,
        first_frame: 0,
        n_frames,
        convention,
        up_axis: None,
        views,
    };
    Ok(LoadedSession { session, format: "native", warnings: Vec::new(), sha256 })
}
