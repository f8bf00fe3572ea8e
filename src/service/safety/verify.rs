//! `verify`: every byte of a data folder or a backup against what was written.
//!
//! Uploads and results are compared with their digests. The database is walked by SQLite's own integrity check, and
//! compared byte by byte with its digest where there is one: in a backup, and in a data folder whose service has stopped in
//! order. Known limit: in the database of a service at work, or of one that was killed, a flipped byte inside of a text
//! is not noticed.

use super::MANIFEST;
use super::backup::{BackupError, open, read_manifest};
use super::inventory::named_files;
use crate::service::store::artifacts::digest_file;
use crate::service::store::{DATABASE, DATABASE_DIGEST};
use std::collections::BTreeSet;
use std::path::Path;

/// What was found.
#[derive(Debug, Default)]
pub struct Report {
    /// Files compared with their digests.
    pub checked: usize,
    /// One line for each damage, naming file and owner.
    pub damages: Vec<String>,
    /// Files that nothing names; the next start removes them.
    pub strays: Vec<String>,
}

/// Checks a data folder or a backup.
///
/// # Errors
/// When the folder holds no database, or cannot be read at all; damage is no error but is reported.
pub async fn verify(folder: &Path) -> Result<Report, BackupError> {
    let mut report = Report::default();
    check_database_digest(folder, &mut report)?;
    let path = folder.join(DATABASE);
    if let Err(source) = std::fs::metadata(&path) {
        return Err(BackupError::File { path, source });
    }
    match check_rows(folder, &mut report).await {
        Ok(()) => {}
        Err(error) => report.damages.push(format!("{DATABASE}: {error}")),
    }
    Ok(report)
}

/// The database's own bytes, where their digest was kept.
fn check_database_digest(folder: &Path, report: &mut Report) -> Result<(), BackupError> {
    let kept = match read_manifest(folder) {
        Ok(manifest) => manifest.files.into_iter().find(|file| file.name == DATABASE).map(|file| file.sha256),
        Err(BackupError::Manifest { source, .. }) => {
            report.damages.push(format!("{MANIFEST}: {source}"));
            None
        }
        Err(_) => std::fs::read_to_string(folder.join(DATABASE_DIGEST)).ok(),
    };
    if let Some(kept) = kept {
        let path = folder.join(DATABASE);
        let found = digest_file(&path).map_err(|source| BackupError::File { path, source })?;
        report.checked += 1;
        if found.sha256 != kept.trim() {
            report.damages.push(format!("{DATABASE}: its bytes are not those that were written"));
        }
    }
    Ok(())
}

async fn check_rows(folder: &Path, report: &mut Report) -> Result<(), BackupError> {
    let database = open(&folder.join(DATABASE), false).await?;
    let faults: Vec<String> = sqlx::query_scalar("PRAGMA integrity_check").fetch_all(&database).await?;
    report.damages.extend(faults.iter().filter(|fault| *fault != "ok").map(|fault| format!("{DATABASE}: {fault}")));
    let files = named_files(&database).await?;
    for file in &files {
        report.checked += 1;
        match digest_file(&folder.join(&file.name)) {
            Ok(digest) if digest.sha256 == file.sha256 => {}
            Ok(_) => report.damages.push(format!("{}: the bytes of {} have changed", file.name, file.owner)),
            Err(error) => report.damages.push(format!("{}: {error} ({})", file.name, file.owner)),
        }
    }
    database.close().await;
    let known: BTreeSet<&str> = files.iter().map(|file| file.name.as_str()).collect();
    for top in ["sessions", "results"] {
        gather_strays(folder, top, &known, &mut report.strays);
    }
    Ok(())
}

fn gather_strays(root: &Path, name: &str, known: &BTreeSet<&str>, strays: &mut Vec<String>) {
    for entry in std::fs::read_dir(root.join(name)).into_iter().flatten().flatten() {
        let name = format!("{name}/{}", entry.file_name().to_string_lossy());
        if entry.path().is_dir() {
            gather_strays(root, &name, known, strays);
        } else if !known.contains(name.as_str()) {
            strays.push(name);
        }
    }
}
