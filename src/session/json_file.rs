//! JSON files that are read as a whole.

use super::parser_errors::in_json_words;
use serde::de::DeserializeOwned;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Why a JSON file cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum JsonFileError {
    /// The file cannot be opened or read.
    #[error("{}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The content is not the expected JSON document.
    #[error("{}: {}", path.display(), in_json_words(source))]
    Json {
        /// The file.
        path: PathBuf,
        /// The error of the parser, with line and column.
        source: serde_json::Error,
    },
}

/// Reads a JSON file into `T`.
///
/// # Errors
/// [`JsonFileError`] with the path.
pub fn read_json_file<T: DeserializeOwned>(path: &Path) -> Result<T, JsonFileError> {
    let bytes = fs::read(path).map_err(|source| JsonFileError::Read { path: path.to_owned(), source })?;
    serde_json::from_slice(&bytes).map_err(|source| JsonFileError::Json { path: path.to_owned(), source })
}
