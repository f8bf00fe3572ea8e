//! Further formats of a finished result, and the manifest that lists them.

use super::files::ResultFiles;
use super::formats::name;
use super::read::{ReadError, read_take};
use super::write_all;
use crate::session::json_file::read_json_file;
use crate::session::reconstruction::ExportFormat;
use serde_json::{Value, json};
use std::io;
use std::path::Path;

/// Why formats cannot be added to a result.
#[derive(Debug, thiserror::Error)]
pub enum AdditionError {
    /// The folder cannot be read as a result.
    #[error(transparent)]
    Result(#[from] ReadError),
    /// The files cannot be written.
    #[error("cannot write the formats: {0}")]
    Write(#[from] io::Error),
}

/// The formats among `wanted` that the manifest of `result` does not list, each once.
///
/// # Errors
/// When the manifest cannot be read.
pub fn missing_formats(result: &Path, wanted: &[ExportFormat]) -> Result<Vec<ExportFormat>, AdditionError> {
    let manifest: Value = read_json_file(&result.join("manifest.json")).map_err(ReadError::from)?;
    let listed = manifest["publish"]["representations"].as_array().cloned().unwrap_or_default();
    let is_listed = |format: ExportFormat| listed.iter().any(|known| known["name"] == name(format));
    let is_first = |i: usize| !wanted[..i].contains(&wanted[i]);
    Ok((0..wanted.len()).filter(|&i| is_first(i) && !is_listed(wanted[i])).map(|i| wanted[i]).collect())
}

/// Writes formats of the result in `result` into `out`, with the manifest of both: existing files and new ones. The options in
/// the manifest stay those of the solve.
///
/// # Errors
/// When `result` is not a result, or the error of the file system.
pub fn write_additions(result: &Path, out: &Path, formats: &[ExportFormat]) -> Result<(), AdditionError> {
    let take = read_take(result)?;
    let mut manifest: Value = read_json_file(&result.join("manifest.json")).map_err(ReadError::from)?;
    let mut files = ResultFiles::create(out)?;
    let representations = write_all(&mut files, &take, formats)?;
    let listed = manifest["publish"]["representations"].as_array_mut();
    listed.into_iter().for_each(|listed| listed.extend(representations.iter().map(|format| json!(format))));
    if let Some(listed) = manifest["files"].as_array_mut() {
        for file in files.written().iter().map(|file| json!(file)) {
            listed.retain(|known| known["name"] != file["name"]); // two formats can share a file, which has the same bytes
            listed.push(file);
        }
    }
    Ok(files.json("manifest.json", &manifest)?)
}
