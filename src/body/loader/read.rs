//! Reading a body file of either layout.

use super::error::BodyFileError;
use super::landmark_table::LandmarkTable;
use super::{assemble, npz, tree};
use crate::body::model::BodyModel;
use std::io::Read;
use std::path::Path;

/// Largest file that is read, bytes: the largest released model has 0.3 GB.
const MAX_FILE_BYTES: u64 = 600 << 20;

/// Reads a body file. `landmarks` gives the detectors' surface points on its mesh, in place of those in the file.
///
/// The model is named after the file. Without a landmark table a user's body has joints and midpoints only; the fit then
/// ignores keypoints of face and feet.
///
/// # Errors
/// [`BodyFileError`], naming the field and what was expected.
pub fn load_body(path: &Path, landmarks: &LandmarkTable) -> Result<BodyModel, BodyFileError> {
    body_from_bytes(stem(path), &file_bytes(path)?, landmarks)
}

/// Reads a body from the bytes of a file: a zip is read as `.npz`, everything else as a pickle.
///
/// # Errors
/// As [`load_body`].
pub fn body_from_bytes(name: String, bytes: &[u8], landmarks: &LandmarkTable) -> Result<BodyModel, BodyFileError> {
    let fields = if bytes.starts_with(b"PK\x03\x04") { npz::read_fields(bytes)? } else { tree::read_fields(bytes)? };
    assemble::body(name, fields, landmarks)
}

pub(super) fn file_bytes(path: &Path) -> Result<Vec<u8>, BodyFileError> {
    let mut bytes = Vec::new();
    std::fs::File::open(path)?.take(MAX_FILE_BYTES + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > MAX_FILE_BYTES {
        return Err(BodyFileError::TooLarge { what: "the file", limit: MAX_FILE_BYTES });
    }
    Ok(bytes)
}

pub(super) fn stem(path: &Path) -> String {
    path.file_stem().map_or_else(|| "body".to_owned(), |stem| stem.to_string_lossy().into_owned())
}
