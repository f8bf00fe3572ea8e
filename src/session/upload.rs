//! From the bytes of an upload to a [`Session`], once; a refusal names file, camera, frame, value and remedy.
//!
//! What it is is told by content, never by a name's ending: a zip by its first bytes, a document by its first brace.

mod assemble;
mod camera;
pub mod error;
mod guard;
pub(crate) mod json;
mod limits;
pub(crate) mod members;
pub(crate) mod raw;
mod warnings;
mod zip_index;

#[cfg(test)]
mod tests;

pub use error::{Fault, UploadError, UploadErrorKind};
pub use limits::UploadLimits;

use super::Session;
use super::digest::{NamedDigest, sha256_of_reader};
use super::formats::native;
use json::Reading;
use members::Members;
use raw::RawSession;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use warnings::Warnings;

/// An accepted upload.
#[derive(Debug, Clone, PartialEq)]
pub struct LoadedSession {
    /// What was filmed.
    pub session: Session,
    /// The dialect: `native` (folder or zip), `native_json` or `native_ndjson`.
    pub format: &'static str,
    /// What is worth telling although the upload was accepted, one sentence each.
    pub warnings: Vec<String>,
    /// Digest of the uploaded bytes; for a folder of the names and contents of the files that were read, in order of
    /// their names. The same session as folder, zip and document has three digests.
    pub sha256: String,
}

/// Reads a session from a folder or a file on this machine.
///
/// # Errors
/// [`UploadError`], with the place where it was found.
pub fn read_path(path: &Path, limits: &UploadLimits) -> Result<LoadedSession, UploadError> {
    if path.is_dir() { read_folder(path, limits) } else { read_file(path, limits) }
}

/// Reads an uploaded file: a zip, a JSON document or NDJSON.
///
/// # Errors
/// [`UploadError`], with the place where it was found.
pub fn read_file(path: &Path, limits: &UploadLimits) -> Result<LoadedSession, UploadError> {
    let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy();
    let file = File::open(path)
        .map_err(|e| UploadError { file: Some(name.to_string()), ..Fault::FileUnreadable.with(e.to_string()) })?;
    read_upload(file, &name, limits)
}

/// Reads an upload from any seekable bytes; `name` is what messages call it.
///
/// # Errors
/// [`UploadError`], with the place where it was found.
pub fn read_upload<R: Read + Seek>(
    mut reader: R,
    name: &str,
    limits: &UploadLimits,
) -> Result<LoadedSession, UploadError> {
    let of_upload = |error: UploadError| UploadError { file: error.file.or_else(|| Some(name.to_owned())), ..error };
    let unreadable = |e: std::io::Error| of_upload(Fault::FileUnreadable.with(e.to_string()));
    let mut warnings = Warnings::default();
    let container = sniff(&mut reader).map_err(of_upload)?;
    let mut reading = Reading::new(limits, &mut warnings);
    let (raw, format) = match container {
        Container::Zip => {
            let mut members = Members::of_zip(&mut reader, limits).map_err(of_upload)?;
            (read_members(&mut members, &mut reading).map_err(of_upload)?, native::Shape::Folder.name())
        }
        Container::Document => {
            let (raw, shape) = native::read_document(&mut reader, name, &mut reading)?;
            (raw, shape.name())
        }
    };
    let session = assemble::assemble(raw, limits, &mut warnings)?;
    reader.rewind().map_err(unreadable)?;
    let sha256 = sha256_of_reader(&mut reader).map_err(unreadable)?;
    Ok(LoadedSession { session, format, warnings: warnings.into_lines(), sha256 })
}

fn read_folder(dir: &Path, limits: &UploadLimits) -> Result<LoadedSession, UploadError> {
    let of_folder = |e: UploadError| UploadError { file: e.file.or_else(|| Some(dir.display().to_string())), ..e };
    let mut warnings = Warnings::default();
    let mut members = Members::of_folder(dir, limits).map_err(of_folder)?;
    let raw = read_members(&mut members, &mut Reading::new(limits, &mut warnings)).map_err(of_folder)?;
    let session = assemble::assemble(raw, limits, &mut warnings)?;
    let sha256 = digest_of_members(&mut members, &session)?;
    Ok(LoadedSession { session, format: native::Shape::Folder.name(), warnings: warnings.into_lines(), sha256 })
}

enum Container {
    Zip,
    Document,
}

/// Tells the container by its first bytes and goes back to the start.
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
        _ => {
            let start: String = head.iter().take(8).map(|b| format!("{b:02x}")).collect();
            Err(Fault::FormatUnknown.with(format!("the file starts with bytes {start}, neither a zip nor an object")))
        }
    }
}

/// Finds the dialect by the names of the members and reads it.
fn read_members<R: Read + Seek>(
    members: &mut Members<R>,
    reading: &mut Reading<'_>,
) -> Result<RawSession, UploadError> {
    if members.contains("session.json") {
        return native::read_members(members, "", reading);
    }
    let is_header = |name: &&str| name.strip_suffix("session.json").is_some_and(is_enclosing_folder);
    let headers: Vec<&str> = members.names().filter(is_header).take(2).collect();
    match headers.as_slice() {
        [] => Err(Fault::FormatUnknown.with("there is no session.json")),
        [header] => {
            let root = header.trim_end_matches("session.json").to_owned();
            native::read_members(members, &root, reading)
        }
        [first, second, ..] => {
            Err(Fault::SessionAmbiguous.with(format!("there are two sessions, {first:?} and {second:?}")))
        }
    }
}

/// One folder round the whole session; the shadow copies of one system's packer are none.
fn is_enclosing_folder(folder: &str) -> bool {
    folder.matches('/').count() == 1 && folder.ends_with('/') && folder != "__MACOSX/"
}

fn digest_of_members<R: Read + Seek>(members: &mut Members<R>, session: &Session) -> Result<String, UploadError> {
    let mut names: Vec<String> = native::member_names(session);
    names.retain(|name| members.contains(name));
    names.sort_unstable();
    let mut digest = NamedDigest::default();
    for name in names {
        let added = digest.add(&name, &mut members.open(&name)?);
        added.map_err(|e| UploadError { file: Some(name), ..Fault::FileUnreadable.with(e.to_string()) })?;
    }
    Ok(digest.finish())
}
