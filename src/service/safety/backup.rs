//! Creating and restoring a backup.

use super::inventory::{NamedFile, named_files};
use crate::service::failpoint::fault;
use crate::service::store::artifacts::digest_file;
use crate::service::store::{DATABASE, StoreError};
use serde::{Deserialize, Serialize};
use sqlx::SqlitePool;
use sqlx::sqlite::{SqliteConnectOptions, SqlitePoolOptions};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Name of a backup's list of files.
pub(super) const MANIFEST: &str = "backup.json";

/// List of the files of a backup.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Manifest {
    /// Version of the program that made the backup.
    pub(super) wandless: String,
    /// All files except this list.
    pub(super) files: Vec<NamedFile>,
}

/// Why a backup or a restore failed.
#[derive(Debug, thiserror::Error)]
pub enum BackupError {
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The target folder is not empty.
    #[error("{}: the folder is not empty; choose another one", path.display())]
    Occupied {
        /// Path of the target folder.
        path: PathBuf,
    },
    /// A file differs from its digest.
    #[error("{name}: the file of {owner} is missing or damaged; the target folder was not created")]
    Damaged {
        /// Path below the folder.
        name: String,
        /// Id of the session or job.
        owner: String,
    },
    /// The list of files cannot be read.
    #[error("{}: {source}", path.display())]
    Manifest {
        /// Path of the list.
        path: PathBuf,
        /// Parse error.
        source: serde_json::Error,
    },
    /// The database failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl From<sqlx::Error> for BackupError {
    fn from(error: sqlx::Error) -> Self {
        Self::Store(error.into())
    }
}

/// Copies the data folder `data` to the new folder `to`, also while its service runs. Returns the number of files.
///
/// # Errors
/// [`BackupError`]; the files copied until then stay in `<to>.tmp`.
pub async fn back_up(data: &Path, to: &Path) -> Result<usize, BackupError> {
    require_empty(to)?;
    let staging = to.with_extension("tmp");
    make_folder(&staging)?;
    require_empty(&staging)?;
    let copy = staging.join(DATABASE);
    let database = open(&data.join(DATABASE), false).await?;
    sqlx::query("VACUUM INTO ?").bind(copy.display().to_string()).execute(&database).await?;
    database.close().await;

    let copied = open(&copy, true).await?;
    let mut files = Vec::new();
    for file in named_files(&copied).await? {
        match copy_file(data, &staging, &file)? {
            Copied::Complete => files.push(file),
            Copied::Missing => delete_owner(&copied, &file).await?,
        }
    }
    // A job with a missing file was deleted during the copy; its other files are dropped from the list.
    let known = named_files(&copied).await?;
    files.retain(|file| known.contains(file));
    sqlx::query("PRAGMA journal_mode = DELETE").execute(&copied).await?;
    copied.close().await;
    let sha256 = digest_file(&copy).map_err(|source| BackupError::File { path: copy.clone(), source })?.sha256;
    if fault("backup.short") {
        files.pop();
    }
    files.push(NamedFile { name: DATABASE.to_owned(), sha256, owner: String::new() });
    files.sort();
    write_manifest(&staging, &files)?;
    publish(&staging, to)?;
    Ok(files.len())
}

/// Creates the data folder `data` from the backup `from` and verifies every file. Returns the number of files.
///
/// # Errors
/// [`BackupError`]; `data` is then not created.
pub fn restore(from: &Path, data: &Path) -> Result<usize, BackupError> {
    require_empty(data)?;
    let manifest = read_manifest(from)?;
    let staging = data.with_extension("tmp");
    make_folder(&staging)?;
    require_empty(&staging)?;
    for file in &manifest.files {
        if !is_inside(&file.name) || matches!(copy_file(from, &staging, file)?, Copied::Missing) {
            return Err(BackupError::Damaged { name: file.name.clone(), owner: file.owner.clone() });
        }
    }
    publish(&staging, data)?;
    Ok(manifest.files.len())
}

pub(super) fn read_manifest(backup: &Path) -> Result<Manifest, BackupError> {
    let path = backup.join(MANIFEST);
    let text = std::fs::read(&path).map_err(|source| BackupError::File { path: path.clone(), source })?;
    serde_json::from_slice(&text).map_err(|source| BackupError::Manifest { path, source })
}

/// Opens a database file with one connection, without taking the lock of the data folder.
pub(super) async fn open(path: &Path, may_write: bool) -> Result<SqlitePool, StoreError> {
    let options = SqliteConnectOptions::new().filename(path).busy_timeout(Duration::from_secs(30));
    let options = options.read_only(!may_write).foreign_keys(true);
    Ok(SqlitePoolOptions::new().max_connections(1).connect_with(options).await?)
}

enum Copied {
    Complete,
    /// The file was deleted after the database was copied.
    Missing,
}

/// Copies one file and verifies the digest of the copy.
fn copy_file(from: &Path, to: &Path, file: &NamedFile) -> Result<Copied, BackupError> {
    let (source, target) = (from.join(&file.name), to.join(&file.name));
    let failed = |source| BackupError::File { path: target.clone(), source };
    if let Some(folder) = target.parent() {
        std::fs::create_dir_all(folder).map_err(failed)?;
    }
    match std::fs::copy(&source, &target) {
        Ok(_) => {}
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Copied::Missing),
        Err(error) => return Err(BackupError::File { path: source, source: error }),
    }
    File::open(&target).and_then(|copy| copy.sync_all()).map_err(failed)?;
    if digest_file(&target).map_err(failed)?.sha256 != file.sha256 {
        return Err(BackupError::Damaged { name: file.name.clone(), owner: file.owner.clone() });
    }
    Ok(Copied::Complete)
}

/// Deletes a session or job with a missing file from the copied database.
async fn delete_owner(database: &SqlitePool, file: &NamedFile) -> Result<(), BackupError> {
    sqlx::query("DELETE FROM jobs WHERE id = ?1 OR (session_id = ?1 AND state IN ('queued', 'running', 'canceling'))")
        .bind(&file.owner)
        .execute(database)
        .await?;
    sqlx::query("DELETE FROM sessions WHERE id = ?").bind(&file.owner).execute(database).await?;
    Ok(())
}

fn is_inside(name: &str) -> bool {
    Path::new(name).components().all(|part| matches!(part, std::path::Component::Normal(_)))
}

fn require_empty(folder: &Path) -> Result<(), BackupError> {
    match std::fs::read_dir(folder).map(|mut entries| entries.next().is_none()) {
        Ok(true) => Ok(()),
        Ok(false) => Err(BackupError::Occupied { path: folder.to_owned() }),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(source) => Err(BackupError::File { path: folder.to_owned(), source }),
    }
}

fn make_folder(folder: &Path) -> Result<(), BackupError> {
    std::fs::create_dir_all(folder).map_err(|source| BackupError::File { path: folder.to_owned(), source })
}

fn write_manifest(folder: &Path, files: &[NamedFile]) -> Result<(), BackupError> {
    let manifest = Manifest { wandless: env!("CARGO_PKG_VERSION").to_owned(), files: files.to_vec() };
    let path = folder.join(MANIFEST);
    let text =
        serde_json::to_vec_pretty(&manifest).map_err(|source| BackupError::Manifest { path: path.clone(), source })?;
    let written = std::fs::write(&path, text).and_then(|()| File::open(&path)?.sync_all());
    written.map_err(|source| BackupError::File { path, source })
}

/// Renames the complete folder to its final name.
fn publish(staging: &Path, target: &Path) -> Result<(), BackupError> {
    if target.exists() {
        std::fs::remove_dir(target).map_err(|source| BackupError::File { path: target.to_owned(), source })?;
    }
    crate::service::store::folders::publish(staging, target)
        .map_err(|source| BackupError::File { path: target.to_owned(), source })
}
