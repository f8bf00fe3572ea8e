//! Reads an upload into a [`Session`]; an error names file, camera, frame, value and remedy.
//!
//! The format is recognised by content and never by a file name's ending: a zip by its first bytes, a document by its first
//! brace.

pub(crate) mod assemble;
mod camera;
pub(crate) mod detections;
pub mod error;
mod guard;
pub(crate) mod json;
pub(crate) mod limits;
pub(crate) mod members;
pub(crate) mod pictures;
pub(crate) mod raw;
pub(crate) mod warnings;
mod zip_index;

#[cfg(test)]
mod tests;

use error::shown;
pub use error::{Fault, UploadError, UploadErrorKind};
pub use limits::UploadLimits;

use super::digest::{NamedDigest, sha256_of_reader};
use super::formats::{foreign, native};
use super::recording::Session;
use json::Reading;
use members::Members;
use raw::MembersRead;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use warnings::Warnings;

/// An accepted upload.
#[derive(Debug, Clone, PartialEq)]
pub struct LoadedSession {
    /// The session.
    pub session: Session,
    /// The dialect: `native` (folder or zip), `native_json` or `native_ndjson`; for other tools' files the dialects of the
    /// poses and the formats of the calibration, `openpose+easymocap with opencv_yaml`.
    pub format: String,
    /// Warnings about the accepted upload, one sentence each.
    pub warnings: Vec<String>,
    /// SHA-256 digest of the uploaded bytes; for a folder of the names and contents of the files that were read, in order of
    /// their names. The same session as folder, zip and document has three different digests.
    pub sha256: String,
}

/// Reads a session from a folder or a file on this machine.
///
/// # Errors
/// [`UploadError`], with the location of the problem.
pub fn read_path(path: &Path, limits: &UploadLimits) -> Result<LoadedSession, UploadError> {
    if path.is_dir() { read_folder(path, limits) } else { read_file(path, limits) }
}

/// Reads an uploaded file: a zip, a JSON document or NDJSON.
///
/// # Errors
/// [`UploadError`], with the location of the problem.
pub fn read_file(path: &Path, limits: &UploadLimits) -> Result<LoadedSession, UploadError> {
    let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy();
    let file = File::open(path)
        .map_err(|e| UploadError { file: Some(name.to_string()), ..Fault::FileUnreadable.with(e.to_string()) })?;
    read_upload(file, &name, limits)
}

/// Reads an upload from any seekable bytes; `name` is the file name for messages.
///
/// # Errors
/// [`UploadError`], with the location of the problem.
pub fn read_upload<R: Read + Seek>(
    mut reader: R,
    name: &str,
    limits: &UploadLimits,
) -> Result<LoadedSession, UploadError> {
    let in_upload = |error: UploadError| UploadError { file: error.file.or_else(|| Some(name.to_owned())), ..error };
    let unreadable = |e: std::io::Error| in_upload(Fault::FileUnreadable.with(e.to_string()));
    let mut warnings = Warnings::default();
    let container = sniff(&mut reader).map_err(in_upload)?;
    let mut reading = Reading::new(limits, &mut warnings);
    let MembersRead { raw, format, .. } = match container {
        Container::Zip => {
            let mut members = Members::of_zip(&mut reader, limits).map_err(in_upload)?;
            read_members(&mut members, &mut reading).map_err(in_upload)?
        }
        Container::Document => {
            let (raw, layout) = native::read_document(&mut reader, name, &mut reading)?;
            MembersRead { raw, format: layout.to_owned(), files: Vec::new() }
        }
    };
    let session = assemble::assemble(raw, limits, &mut warnings)?;
    reader.rewind().map_err(unreadable)?;
    let sha256 = sha256_of_reader(&mut reader).map_err(unreadable)?;
    Ok(LoadedSession { session, format, warnings: warnings.into_lines(), sha256 })
}

fn read_folder(dir: &Path, limits: &UploadLimits) -> Result<LoadedSession, UploadError> {
    let in_folder = |e: UploadError| UploadError { file: e.file.or_else(|| Some(dir.display().to_string())), ..e };
    let mut warnings = Warnings::default();
    let mut members = Members::of_folder(dir, limits).map_err(in_folder)?;
    let read = read_members(&mut members, &mut Reading::new(limits, &mut warnings)).map_err(in_folder)?;
    let session = assemble::assemble(read.raw, limits, &mut warnings)?;
    let sha256 = digest_of_members(&mut members, read.files)?;
    Ok(LoadedSession { session, format: read.format, warnings: warnings.into_lines(), sha256 })
}

enum Container {
    Zip,
    Document,
}

/// Recognises the container by its first bytes and rewinds.
fn sniff<R: Read + Seek>(reader: &mut R) -> Result<Container, UploadError> {
    let mut head = Vec::new();
    let read = reader.by_ref().take(64).read_to_end(&mut head).and_then(|_| reader.seek(SeekFrom::Start(0)));
    read.map_err(|e| Fault::FileUnreadable.with(e.to_string()))?;
    match head.as_slice() {
        [b'P', b'K', 3, 4, ..] | [b'P', b'K', 5, 6, ..] => Ok(Container::Zip),
        [0xef, 0xbb, 0xbf, ..] => Err(Fault::Encoding.with("the file starts with a byte order mark")),
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] | [b'{', 0, ..] | [0, b'{', ..] => {
            Err(Fault::Encoding.with("the file is UTF-16"))
        }
        _ if head.trim_ascii_start().first() == Some(&b'{') => Ok(Container::Document),
        [] => Err(Fault::FormatUnknown.with("the file is empty")),
        head if pictures::is_picture(head) => {
            Err(Fault::PosesNotDetected.with("the file is a video or an image, which holds no 2D poses"))
        }
        _ => {
            let start = hex::encode(&head[..head.len().min(8)]);
            Err(Fault::FormatUnknown
                .with(format!("the file starts with bytes {start}, expected a zip or a JSON object")))
        }
    }
}

/// Recognises whether the files are a native session or other tools' files, and reads them.
fn read_members<R: Read + Seek>(
    members: &mut Members<R>,
    reading: &mut Reading<'_>,
) -> Result<MembersRead, UploadError> {
    let sessions = session_folders(members);
    let header = match sessions.as_slice() {
        [first, others @ ..] if first.is_empty() => {
            if !others.is_empty() {
                reading.warnings.add(format!("sessions below this one are ignored: {}", listed(others)));
            }
            Some("session.json".to_owned())
        }
        [only] if is_enclosing_folder(only) => Some(format!("{only}session.json")),
        [] => None,
        several => {
            let detail = format!("the upload contains sessions in folders below it: {}", listed(several));
            return Err(UploadError {
                remedy: "send one of these folders".to_owned(),
                ..Fault::SessionAmbiguous.with(detail)
            });
        }
    };
    let survey = foreign::survey(members);
    let is_foreign = match &header {
        None if !survey.has_poses() => {
            if let [first, ..] = survey.pictures.as_slice() {
                let n = survey.pictures.len();
                let detail = format!("the upload contains no 2D poses, but {n} videos or images ({}…)", shown(first));
                return Err(Fault::PosesNotDetected.with(detail));
            }
            let missing = "the upload contains no session.json and no pose file of a known dialect".to_owned();
            let detail = std::iter::once(missing).chain(survey.hints).collect::<Vec<_>>().join("; ");
            return Err(Fault::FormatUnknown.with(detail));
        }
        None => true,
        Some(header) => survey.has_foreign_poses() || foreign::names_joints(members, header),
    };
    if is_foreign {
        return foreign::read_members(foreign::Survey { header, ..survey }, members, reading);
    }
    let root = header.unwrap_or_default().trim_end_matches("session.json").to_owned();
    let raw = native::read_members(members, &root, reading)?;
    let files = native::member_names(&raw, &root);
    Ok(MembersRead { raw, format: "native".to_owned(), files })
}

/// Folders with a `session.json`, with their final slash, in order; the upload itself is the empty name. Copies that macOS adds
/// to archives, hidden folders and ground truth do not count.
fn session_folders<R>(members: &Members<R>) -> Vec<String>
where
    R: Read + Seek,
{
    let is_folder = |folder: &&str| {
        folder.is_empty()
            || folder.ends_with('/') && !folder.split('/').any(|p| p.starts_with('.') || p == "gt" || p == "__MACOSX")
    };
    let folders = members.names().filter_map(|name| name.strip_suffix("session.json")).filter(is_folder);
    let mut folders: Vec<String> = folders.map(str::to_owned).collect();
    folders.sort();
    folders
}

/// Names of folders for a message, the first ten of them.
fn listed(folders: &[String]) -> String {
    const MAX: usize = 10;
    let names: Vec<String> = folders.iter().take(MAX).map(|folder| shown(folder.trim_end_matches('/'))).collect();
    let more = if folders.len() > MAX { format!(" and {} more", folders.len() - MAX) } else { String::new() };
    format!("{}{more}", names.join(", "))
}

/// Whether the folder encloses the whole session. `__MACOSX/` does not: it holds copies that macOS adds to archives.
fn is_enclosing_folder(folder: &str) -> bool {
    folder.matches('/').count() == 1 && folder.ends_with('/') && folder != "__MACOSX/"
}

fn digest_of_members<R: Read + Seek>(members: &mut Members<R>, mut names: Vec<String>) -> Result<String, UploadError> {
    names.retain(|name| members.contains(name));
    names.sort_unstable();
    let mut digest = NamedDigest::default();
    for name in names {
        let added = digest.add(&name, &mut members.open(&name)?);
        added.map_err(|e| UploadError { file: Some(name), ..Fault::FileUnreadable.with(e.to_string()) })?;
    }
    Ok(digest.finish())
}
