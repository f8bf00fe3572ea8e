//! The native layout: `session.json` with `poses/<camera id>.json` beside it, as one document with inline poses, or as
//! NDJSON.

mod covariances;
mod frames;
mod header;
mod landmarks;
mod write;

pub use landmarks::{landmarks_from_json, landmarks_json};
pub use write::{to_json, write_folder};

use crate::session::upload::error::{Fault, UploadError, shown};
use crate::session::upload::json::{Fields, JsonStream, Place, Reading, fault_of_io};
use crate::session::upload::members::Members;
use crate::session::upload::raw::{RawCamera, RawPoses, RawSession};
use frames::{LineFields, PosesFields};
use header::DocumentFields;
use std::collections::BTreeMap;
use std::io::{Read, Seek};

/// Reads one document with inline poses (`native_json`), or a header followed by one line per camera and frame
/// (`native_ndjson`); returns the session and the name of its layout.
pub(crate) fn read_document(
    reader: impl Read,
    file: &str,
    reading: &mut Reading<'_>,
) -> Result<(RawSession, &'static str), UploadError> {
    reading.place.file = Some(file.to_owned());
    let mut stream = JsonStream::new(reader, reading.limits);
    let mut document = DocumentFields::default();
    stream.next(&mut document, reading)?;
    if let Some(poses) = document.poses.take() {
        stream.expect_end(reading)?;
        return Ok((document.finish(reading, poses)?, "native_json"));
    }
    if stream.at_end(reading)? {
        return Err(reading.place.of(Fault::PosesMissing.with("the document has no `poses` and no frames follow it")));
    }
    let mut raw = document.finish(reading, BTreeMap::new())?;
    read_lines(&mut stream, &mut raw, reading)?;
    Ok((raw, "native_ndjson"))
}

/// Reads `session.json` under `root` (`""` or `"<folder>/"`) and the poses of every camera in it.
pub(crate) fn read_members<R: Read + Seek>(
    members: &mut Members<R>,
    root: &str,
    reading: &mut Reading<'_>,
) -> Result<RawSession, UploadError> {
    let file = format!("{root}session.json");
    reading.place.file = Some(file.clone());
    let mut document = DocumentFields::default();
    read_whole(members, &file, &mut document, reading)?;
    let table = format!("{root}{LANDMARKS}");
    if members.contains(&table) {
        reading.place.file = Some(table.clone());
        read_whole(members, &table, &mut document.points, reading)?;
        reading.place.file = Some(file.clone());
    }
    if let Some(poses) = document.poses.take() {
        return document.finish(reading, poses);
    }
    let mut raw = document.finish(reading, BTreeMap::new())?;
    let cameras = raw.cameras.iter().take(reading.limits.max_cameras);
    let of_camera =
        |camera: &RawCamera| PosesFile { camera: camera.id.clone(), name: format!("{root}poses/{}.json", camera.id) };
    let poses_files: Vec<PosesFile> = cameras.map(of_camera).collect();
    if let Some(PosesFile { camera, name }) = poses_files.iter().find(|poses| !members.contains(&poses.name)) {
        let error = Fault::PosesMissing.with(format!("file {} does not exist", shown(name)));
        return Err(UploadError { file: Some(file), camera: Some(camera.clone()), ..error });
    }
    raw.poses = read_all_poses(members, &poses_files, reading)?;
    warn_of_unused_files(members, root, &raw, reading);
    Ok(raw)
}

/// One camera's file of poses.
struct PosesFile {
    camera: String,
    name: String,
}

/// Files of at most this many bytes, together at most twice as many, are held in memory and parsed side by side; larger ones are
/// parsed as they are read, one by one.
const HELD_BYTES: u64 = 64 << 20;

fn read_all_poses<R: Read + Seek>(
    members: &mut Members<R>,
    mut files: &[PosesFile],
    reading: &mut Reading<'_>,
) -> Result<BTreeMap<String, RawPoses>, UploadError> {
    let mut all = BTreeMap::new();
    while let Some(next) = files.first() {
        let batch = held_files(members, files, reading)?;
        if batch.is_empty() {
            reading.place = next.place();
            all.insert(next.camera.clone(), read_poses(members, &next.name, reading)?);
        } else {
            let parsed = reading.side_by_side(&batch, |(file, bytes), reading| {
                reading.place = file.place();
                poses_of(bytes.as_slice(), &file.name, reading)
            })?;
            all.extend(batch.iter().map(|(file, _)| file.camera.clone()).zip(parsed));
        }
        files = &files[batch.len().max(1)..];
    }
    Ok(all)
}

/// The contents of the first of some files, as many as may be held; none where the first one is too large.
fn held_files<'f, R: Read + Seek>(
    members: &mut Members<R>,
    files: &'f [PosesFile],
    reading: &mut Reading<'_>,
) -> Result<Vec<(&'f PosesFile, Vec<u8>)>, UploadError> {
    let (mut held, mut n_held) = (Vec::new(), 0);
    for file in files {
        reading.place = file.place();
        let mut bytes = Vec::new();
        let read = members.open(&file.name)?.take(HELD_BYTES + 1).read_to_end(&mut bytes);
        let n = read.map_err(|e| reading.place.of(fault_of_io(e)))? as u64;
        if n > HELD_BYTES {
            break;
        }
        held.push((file, bytes));
        n_held += n;
        if n_held >= HELD_BYTES {
            break;
        }
    }
    Ok(held)
}

impl PosesFile {
    fn place(&self) -> Place {
        Place { file: Some(self.name.clone()), camera: Some(self.camera.clone()), ..Place::default() }
    }
}

/// Reads one camera's poses from its own file.
pub(crate) fn read_poses<R: Read + Seek>(
    members: &mut Members<R>,
    name: &str,
    reading: &mut Reading<'_>,
) -> Result<RawPoses, UploadError> {
    poses_of(members.open(name)?, name, reading)
}

fn poses_of(reader: impl Read, name: &str, reading: &mut Reading<'_>) -> Result<RawPoses, UploadError> {
    let mut poses = PosesFields::new(name);
    read_document_into(reader, &mut poses, reading)?;
    poses.finish(reading)
}

/// File with the table of landmarks, where `keypoint_convention` does not hold it.
const LANDMARKS: &str = "landmarks.json";

/// The files of a session folder that [`read_members`] may have read.
pub(crate) fn member_names(raw: &RawSession, root: &str) -> Vec<String> {
    let poses = raw.cameras.iter().map(|camera| format!("{root}poses/{}.json", camera.id));
    ["session.json", LANDMARKS].map(|name| format!("{root}{name}")).into_iter().chain(poses).collect()
}

fn read_whole<R: Read + Seek>(
    members: &mut Members<R>,
    name: &str,
    fields: &mut impl Fields,
    reading: &mut Reading<'_>,
) -> Result<(), UploadError> {
    read_document_into(members.open(name)?, fields, reading)
}

fn read_document_into(
    reader: impl Read,
    fields: &mut impl Fields,
    reading: &mut Reading<'_>,
) -> Result<(), UploadError> {
    let mut stream = JsonStream::new(reader, reading.limits);
    stream.next(fields, reading)?;
    stream.expect_end(reading)
}

fn read_lines<R: Read>(
    stream: &mut JsonStream<'_, R>,
    raw: &mut RawSession,
    reading: &mut Reading<'_>,
) -> Result<(), UploadError> {
    for camera in &raw.cameras {
        raw.poses.insert(camera.id.clone(), RawPoses { file: raw.file.clone(), ..RawPoses::default() });
    }
    for n in 1.. {
        if stream.at_end(reading)? {
            break;
        }
        let mut line = LineFields::default();
        let read = stream.next(&mut line, reading).and_then(|()| line.finish(raw, reading));
        read.map_err(|e| UploadError { pointer: Some(format!("/{n}{}", e.pointer.unwrap_or_default())), ..e })?;
    }
    Ok(())
}

fn warn_of_unused_files<R: Read + Seek>(members: &Members<R>, root: &str, raw: &RawSession, reading: &mut Reading<'_>) {
    for name in members.names() {
        let Some(name) = name.strip_prefix(root) else { continue };
        if let Some(id) = name.strip_prefix("poses/").and_then(|rest| rest.strip_suffix(".json")) {
            if !raw.cameras.iter().any(|camera| camera.id == id) {
                reading.warnings.add(format!("poses of unknown camera {} are ignored", shown(id)));
            }
        } else if name.starts_with("gt/") {
            reading.warnings.add("gt/ contains ground truth, which is not part of an upload: it is ignored".to_owned());
        }
    }
}
