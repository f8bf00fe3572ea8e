//! `verify`: every byte of a data folder or a backup against what was written.
//!
//! Uploads, results and finished stages are compared with their digests. The database is walked by SQLite's own integrity
//! check, and compared byte by byte: in a backup with its digest, in a data folder with the digests of its pages and the
//! checksums of its log, whether its service is at work, was killed, or has stopped. Known limit: a folder that no service
//! of this release has served yet has no digests.

use super::MANIFEST;
use super::backup::{BackupError, open, read_manifest};
use super::inventory::named_files;
use crate::pipeline::checkpoints::is_whole;
use crate::service::failpoint::fault;
use crate::service::store::DATABASE;
use crate::service::store::artifacts::digest_file;
use crate::service::store::pages::{self, Compared};
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
    let path = folder.join(DATABASE);
    if let Err(source) = std::fs::metadata(&path) {
        return Err(BackupError::File { path, source });
    }
    check_database_bytes(folder, &mut report)?;
    check_checkpoints(folder, &mut report);
    match check_rows(folder, &mut report).await {
        Ok(()) => {}
        Err(error) => report.damages.push(format!("{DATABASE}: {error}")),
    }
    Ok(report)
}

/// The database's own bytes: against the list of a backup, or page by page.
fn check_database_bytes(folder: &Path, report: &mut Report) -> Result<(), BackupError> {
    let path = folder.join(DATABASE);
    let failed = |source| BackupError::File { path: path.clone(), source };
    let listed = match read_manifest(folder) {
        Ok(manifest) => manifest.files.into_iter().find(|file| file.name == DATABASE),
        Err(BackupError::Manifest { source, .. }) => {
            report.damages.push(format!("{MANIFEST}: {source}"));
            return Ok(());
        }
        Err(_) => None,
    };
    let damage = match listed {
        Some(listed) if digest_file(&path).map_err(failed)?.sha256 == listed.sha256 => None,
        Some(_) => Some("its bytes are not those that were written".to_owned()),
        None => match pages::compare(&path).map_err(failed)? {
            Compared::Damaged(damage) => Some(damage),
            Compared::Unknown | Compared::Whole(_) => None,
        },
    };
    report.checked += 1;
    report.damages.extend(damage.filter(|_| !fault("verify.blind")).map(|damage| format!("{DATABASE}: {damage}")));
    Ok(())
}

/// Finished stages of jobs that have not ended: a damaged one is not used, and told.
fn check_checkpoints(folder: &Path, report: &mut Report) {
    for job in std::fs::read_dir(folder.join("checkpoints")).into_iter().flatten().flatten() {
        for file in std::fs::read_dir(job.path()).into_iter().flatten().flatten() {
            let path = file.path();
            if path.extension().is_some_and(|ending| ending == "ckpt") {
                report.checked += 1;
                if !is_whole(&path) {
                    let name = path.strip_prefix(folder).unwrap_or(&path).display();
                    report.damages.push(format!("{name}: the stage is not whole; it is run again"));
                }
            }
        }
    }
}

async fn check_rows(folder: &Path, report: &mut Report) -> Result<(), BackupError> {
    let database = open(&folder.join(DATABASE), false).await?;
    let faults: Vec<String> = sqlx::query_scalar("PRAGMA integrity_check").fetch_all(&database).await?;
    report.damages.extend(faults.iter().filter(|fault| *fault != "ok").map(|fault| format!("{DATABASE}: {fault}")));
    let files = named_files(&database).await?;
    for file in &files {
        report.checked += 1;
        match digest_file(&folder.join(&file.name)) {
            Ok(digest) if digest.sha256 == file.sha256 || fault("verify.blind") => {}
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
