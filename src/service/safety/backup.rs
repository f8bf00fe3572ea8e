//! `backup` and `restore`.

use super::MANIFEST;
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

/// What a backup holds.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Manifest {
    /// Release that wrote it.
    pub(super) wandless: String,
    /// Every file but this one.
    pub(super) files: Vec<NamedFile>,
}

/// Why there is no backup, or no data folder out of it.
#[derive(Debug, thiserror::Error)]
pub enum BackupError {
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The target holds something already.
    #[error("{}: the folder is not empty; choose another", path.display())]
    Occupied {
        /// The target.
        path: PathBuf,
    },
    /// A file is not what was written.
    #[error("{name}: the file is damaged (of {owner}); nothing was published")]
    Damaged {
        /// Below the folder.
        name: String,
        /// Session or job.
        owner: String,
    },
    /// The list of files cannot be read.
    #[error("{}: {source}", path.display())]
    Manifest {
        /// The list.
        path: PathBuf,
        /// What is wrong.
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

/// Copies the data folder `data` to the new folder `to`; its service may be at work. Gives the number of files.
///
/// # Errors
/// [`BackupError`]; what was copied until then stays in `<to>.tmp`.
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
            Copied::Whole => files.push(file),
            Copied::Gone => forget(&copied, &file).await?,
        }
    }
    // A job that lost one file was deleted while we copied: its other files are nobody's.
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

/// Makes the data folder `data` out of the backup `from`, every file checked. Gives the number of files.
///
/// # Errors
/// [`BackupError`]; `data` then does not appear.
pub fn restore(from: &Path, data: &Path) -> Result<usize, BackupError> {
    require_empty(data)?;
    let manifest = read_manifest(from)?;
    let staging = data.with_extension("tmp");
    make_folder(&staging)?;
    require_empty(&staging)?;
    for file in &manifest.files {
        if !is_inside(&file.name) || matches!(copy_file(from, &staging, file)?, Copied::Gone) {
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

/// One connection to a database file, without the lock of a service.
pub(super) async fn open(path: &Path, may_write: bool) -> Result<SqlitePool, StoreError> {
    let options = SqliteConnectOptions::new().filename(path).busy_timeout(Duration::from_secs(30));
    let options = options.read_only(!may_write).foreign_keys(true);
    Ok(SqlitePoolOptions::new().max_connections(1).connect_with(options).await?)
}

enum Copied {
    Whole,
    /// Deleted since the database was copied.
    Gone,
}

/// Copies and checks one file; its digest is that of what now lies in the copy.
fn copy_file(from: &Path, to: &Path, file: &NamedFile) -> Result<Copied, BackupError> {
    let (source, target) = (from.join(&file.name), to.join(&file.name));
    let failed = |source| BackupError::File { path: target.clone(), source };
    if let Some(folder) = target.parent() {
        std::fs::create_dir_all(folder).map_err(failed)?;
    }
    match std::fs::copy(&source, &target) {
        Ok(_) => {}
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Copied::Gone),
        Err(error) => return Err(BackupError::File { path: source, source: error }),
    }
    File::open(&target).and_then(|copy| copy.sync_all()).map_err(failed)?;
    if digest_file(&target).map_err(failed)?.sha256 != file.sha256 {
        return Err(BackupError::Damaged { name: file.name.clone(), owner: file.owner.clone() });
    }
    Ok(Copied::Whole)
}

/// Takes a session or a job whose file is gone out of the copied database.
async fn forget(database: &SqlitePool, file: &NamedFile) -> Result<(), BackupError> {
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

/// The folder appears whole or not at all.
fn publish(staging: &Path, target: &Path) -> Result<(), BackupError> {
    if target.exists() {
        std::fs::remove_dir(target).map_err(|source| BackupError::File { path: target.to_owned(), source })?;
    }
    crate::service::store::folders::publish(staging, target)
        .map_err(|source| BackupError::File { path: target.to_owned(), source })
}
