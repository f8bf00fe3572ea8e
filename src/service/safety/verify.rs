//! `verify`: checks every byte of a data folder or a backup.
//!
//! Uploads, results and checkpoints are compared with their digests. The database passes SQLite's integrity check and a
//! comparison of all bytes: in a backup with its digest, in a data folder with the digests of its pages and the checksums
//! of its write-ahead log, whether the service is running, was killed or has stopped. Known limit: a folder that was never
//! served by a release with page digests has none.

use super::backup::{BODIES, MANIFEST, Manifest, read_manifest};
use super::error::BackupError;
use super::inventory::named_files;
use super::source::Source;
use crate::pipeline::checkpoints::is_whole;
use crate::service::failpoint::fault;
use crate::service::store::DATABASE;
use crate::service::store::artifacts::digest_file;
use crate::service::store::pages::{self, Compared};
use std::collections::BTreeSet;
use std::path::Path;

/// Result of a verification.
#[derive(Debug, Default)]
pub struct Report {
    /// Number of files compared with their digests.
    pub checked: usize,
    /// One line per damage, with file and owner.
    pub damages: Vec<String>,
    /// Files without a row; the next start removes them.
    pub strays: Vec<String>,
}

/// Verifies a data folder or a backup.
///
/// # Errors
/// When the folder has no database or cannot be read; damage is not an error but part of the report.
pub async fn verify(folder: &Path) -> Result<Report, BackupError> {
    let mut report = Report::default();
    let path = folder.join(DATABASE);
    if let Err(source) = std::fs::metadata(&path) {
        return Err(BackupError::File { path, source });
    }
    match read_manifest(folder) {
        Ok(manifest) => check_listed(folder, &manifest, &mut report),
        Err(BackupError::Manifest { source, .. }) => report.damages.push(format!("{MANIFEST}: {source}")),
        Err(_) => check_pages(folder, &mut report)?,
    }
    check_checkpoints(folder, &mut report);
    if let Err(error) = check_rows(folder, &mut report).await {
        report.damages.push(format!("{DATABASE}: {error}"));
    }
    Ok(report)
}

/// Checks the database and the bodies of a backup against its list; [`check_rows`] checks the other files.
fn check_listed(folder: &Path, manifest: &Manifest, report: &mut Report) {
    for file in manifest.files.iter().filter(|file| file.name == DATABASE || file.owner == BODIES) {
        report.checked += 1;
        let damage = match digest_file(&folder.join(&file.name)) {
            Ok(digest) if digest.sha256 == file.sha256 || fault("verify.blind") => continue,
            Ok(_) => "the bytes have changed since the backup".to_owned(),
            Err(error) => error.to_string(),
        };
        report.damages.push(format!("{}: {damage}", file.name));
    }
}

/// Checks the database of a data folder page by page.
fn check_pages(folder: &Path, report: &mut Report) -> Result<(), BackupError> {
    let path = folder.join(DATABASE);
    let compared = pages::compare(&path).map_err(|source| BackupError::File { path, source })?;
    report.checked += 1;
    if let Compared::Damaged(damage) = compared
        && !fault("verify.blind")
    {
        report.damages.push(format!("{DATABASE}: {damage}"));
    }
    Ok(())
}

/// Checks the checkpoints of open jobs; a damaged one is not used, but reported.
fn check_checkpoints(folder: &Path, report: &mut Report) {
    for job in std::fs::read_dir(folder.join("checkpoints")).into_iter().flatten().flatten() {
        for file in std::fs::read_dir(job.path()).into_iter().flatten().flatten() {
            let path = file.path();
            if path.extension().is_some_and(|ending| ending == "ckpt") {
                report.checked += 1;
                if !is_whole(&path) {
                    let name = path.strip_prefix(folder).unwrap_or(&path).display();
                    report.damages.push(format!("{name}: the checkpoint is damaged; its stage will be run again"));
                }
            }
        }
    }
}

async fn check_rows(folder: &Path, report: &mut Report) -> Result<(), BackupError> {
    let source = Source::open(folder).await?;
    let database = &source.database;
    let faults: Vec<String> = sqlx::query_scalar("PRAGMA integrity_check").fetch_all(database).await?;
    report.damages.extend(faults.iter().filter(|fault| *fault != "ok").map(|fault| format!("{DATABASE}: {fault}")));
    let files = named_files(database).await?;
    for file in &files {
        report.checked += 1;
        match digest_file(&folder.join(&file.name)) {
            Ok(digest) if digest.sha256 == file.sha256 || fault("verify.blind") => {}
            Ok(_) => report.damages.push(format!("{}: the file of {} has changed", file.name, file.owner)),
            Err(error) => report.damages.push(format!("{}: {error} ({})", file.name, file.owner)),
        }
    }
    database.close().await;
    let known: BTreeSet<&str> = files.iter().map(|file| file.name.as_str()).collect();
    for top in ["sessions", "results"] {
        collect_strays(folder, top, &known, &mut report.strays);
    }
    Ok(())
}

fn collect_strays(root: &Path, name: &str, known: &BTreeSet<&str>, strays: &mut Vec<String>) {
    for entry in std::fs::read_dir(root.join(name)).into_iter().flatten().flatten() {
        let name = format!("{name}/{}", entry.file_name().to_string_lossy());
        if entry.path().is_dir() {
            collect_strays(root, &name, known, strays);
        } else if !known.contains(name.as_str()) {
            strays.push(name);
        }
    }
}
