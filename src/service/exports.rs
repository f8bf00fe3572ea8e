//! Formats that are added to a published result: a new folder with all files, which then replaces the published one.

use crate::export::{AdditionError, missing_formats, write_additions};
use crate::service::store::artifacts::{Artifact, scan};
use crate::service::store::folders::publish;
use crate::session::reconstruction::ExportFormat;
use std::io;
use std::path::Path;

/// Why no new folder was made.
#[derive(Debug, thiserror::Error)]
pub(super) enum ExtensionError {
    /// A published file differs from its digest.
    #[error("{0}: the digest differs from the published one")]
    Damaged(String),
    /// The published result cannot be read.
    #[error(transparent)]
    Unreadable(#[from] AdditionError),
    /// A file cannot be linked or written.
    #[error(transparent)]
    Write(#[from] io::Error),
}

/// Folder, below the new one, in which the formats are written before they are moved beside the linked files: a linked file
/// must never be written in place, because the published one has the same bytes on the disk.
const NEW: &str = ".new";

/// Makes `extended`, the published result in `result` with further `formats`; `known`: its published files. Returns the files
/// of the new folder; `None`, without a folder, if the result has all formats already.
///
/// # Errors
/// [`ExtensionError`]; `staging`, in which the folder grows, is removed then.
pub(super) fn extend(
    result: &Path,
    known: &[Artifact],
    formats: &[ExportFormat],
    staging: &Path,
    extended: &Path,
) -> Result<Option<Vec<Artifact>>, ExtensionError> {
    let missing = missing_formats(result, formats)?;
    if missing.is_empty() {
        return Ok(None);
    }
    let made = make(result, known, &missing, staging);
    match made.and_then(|artifacts| Ok(publish(staging, extended).map(|()| artifacts)?)) {
        Ok(artifacts) => Ok(Some(artifacts)),
        Err(error) => {
            let _ = std::fs::remove_dir_all(staging); // the next start removes what stays
            Err(error)
        }
    }
}

fn make(
    result: &Path,
    known: &[Artifact],
    missing: &[ExportFormat],
    staging: &Path,
) -> Result<Vec<Artifact>, ExtensionError> {
    if staging.exists() {
        std::fs::remove_dir_all(staging)?; // left by a request that was interrupted
    }
    for file in known {
        link(&result.join(&file.name), &staging.join(&file.name))?;
    }
    let new = staging.join(NEW);
    write_additions(result, &new, missing)?;
    move_files(&new, staging)?;
    std::fs::remove_dir_all(&new)?;
    let artifacts = scan(staging)?;
    let replaced = |name: &str| name == "manifest.json";
    for file in known.iter().filter(|file| !replaced(&file.name)) {
        let now = artifacts.iter().find(|artifact| artifact.name == file.name);
        if now.is_none_or(|now| now.sha256 != file.sha256) {
            return Err(ExtensionError::Damaged(file.name.clone()));
        }
    }
    Ok(artifacts)
}

/// Gives a file a second name; copies it on file systems without links.
fn link(from: &Path, to: &Path) -> io::Result<()> {
    if let Some(folder) = to.parent() {
        std::fs::create_dir_all(folder)?;
    }
    match std::fs::hard_link(from, to) {
        Ok(()) => Ok(()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Err(error),
        Err(_) => std::fs::copy(from, to).map(drop),
    }
}

/// Moves every file below `from` to the same place below `to`.
fn move_files(from: &Path, to: &Path) -> io::Result<()> {
    std::fs::create_dir_all(to)?;
    for entry in std::fs::read_dir(from)? {
        let entry = entry?;
        let target = to.join(entry.file_name());
        if entry.file_type()?.is_dir() {
            move_files(&entry.path(), &target)?;
        } else {
            std::fs::rename(entry.path(), target)?;
        }
    }
    Ok(())
}
