//! Reading a body file: SMPL's `.npz` and official `.pkl`, and our own.
//!
//! The licence of a user's model is the user's; its numbers stay in memory. Nothing in a file is ever executed: pickles
//! become an inert tree, of which only numeric arrays are read.
//!
//! Fields (V vertices, F faces, 24 joints): `v_template` (V, 3), `shapedirs` (V, 3, n >= 1, of which ten are used),
//! `weights` (V, 24), `J_regressor` (24, V) dense or sparse, `kintree_table` (2, 24), `f` (F, 3), optional `posedirs`
//! (V, 3, 207); ours adds landmarks as sparse rows. All else is ignored.

mod array;
mod assemble;
mod cache;
mod error;
mod landmark_table;
pub(crate) mod npy_head;
mod npz;
mod pickle;
mod tree;
mod write;

pub use cache::{CachedBody, load_body_cached, write_private};
pub use error::BodyFileError;
pub use landmark_table::{LandmarkTable, LandmarkTableError};
pub(crate) use tree::arrays_of_pickle;
pub use write::{body_glb, body_npz, body_obj};

use super::model::BodyModel;
use std::io::Read;
use std::path::Path;

/// Files larger than this are refused: the largest released model has 0.3 GB.
const MAX_FILE_BYTES: u64 = 600 << 20;

/// Reads a body file; `landmarks` says where detectors' surface points lie on it, and overrules those in the file.
///
/// The model is named after the file. Without a landmark table a user's body has joints and midpoints only: face and
/// foot keypoints are then not used by the fit.
///
/// # Errors
/// [`BodyFileError`], naming the field and what was expected.
pub fn load_body(path: &Path, landmarks: &LandmarkTable) -> Result<BodyModel, BodyFileError> {
    body_from_bytes(stem(path), &file_bytes(path)?, landmarks)
}

fn file_bytes(path: &Path) -> Result<Vec<u8>, BodyFileError> {
    let mut bytes = Vec::new();
    std::fs::File::open(path)?.take(MAX_FILE_BYTES + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > MAX_FILE_BYTES {
        return Err(BodyFileError::TooLarge { what: "the file", limit: MAX_FILE_BYTES });
    }
    Ok(bytes)
}

fn stem(path: &Path) -> String {
    path.file_stem().map_or_else(|| "body".to_owned(), |stem| stem.to_string_lossy().into_owned())
}

/// Reads a body from the bytes of a file: a zip is an `.npz`, all else a pickle.
///
/// # Errors
/// As [`load_body`].
pub fn body_from_bytes(name: String, bytes: &[u8], landmarks: &LandmarkTable) -> Result<BodyModel, BodyFileError> {
    let fields = if bytes.starts_with(b"PK\x03\x04") { npz::read_fields(bytes)? } else { tree::read_fields(bytes)? };
    assemble::body(name, fields, landmarks)
}
