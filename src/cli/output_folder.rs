//! Output folders: checked before the work, written aside, renamed when complete.

use super::bad_input::BadInput;
use anyhow::Context;
use std::path::{Path, PathBuf};

/// Rejects an output path that exists and is not an empty folder: a result is never mixed with other files.
pub(super) fn require_free(out: &Path) -> anyhow::Result<()> {
    let is_taken = match std::fs::read_dir(out) {
        Ok(mut entries) => entries.next().is_some(),
        Err(_) => out.exists(),
    };
    if is_taken {
        let remedy = "choose a folder that does not exist or is empty";
        return Err(BadInput(format!("{}: the folder is not empty; {remedy}", out.display())).into());
    }
    Ok(())
}

/// Creates `<out>.tmp` beside `out`. The caller renames it when it is complete, so that `out` never holds a partial result.
pub(super) fn staging_folder(out: &Path) -> anyhow::Result<PathBuf> {
    let mut name = out.file_name().map(ToOwned::to_owned).unwrap_or_default();
    name.push(".tmp");
    let staging = out.with_file_name(name);
    if staging.exists() {
        std::fs::remove_dir_all(&staging).with_context(|| staging.display().to_string())?;
    }
    std::fs::create_dir_all(&staging).with_context(|| staging.display().to_string())?;
    Ok(staging)
}

/// Publishes a complete staging folder as `out`, or removes it after a failure.
pub(super) fn publish<T>(staging: &Path, out: &Path, work: anyhow::Result<T>) -> anyhow::Result<T> {
    if work.is_err() {
        let _ = std::fs::remove_dir_all(staging); // the error of the work matters more
        return work;
    }
    std::fs::rename(staging, out).with_context(|| out.display().to_string())?;
    work
}
