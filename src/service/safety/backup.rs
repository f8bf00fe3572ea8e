//! Creating and restoring a backup.

use super::error::BackupError;
use super::inventory::{NamedFile, named_files};
use super::source::open;
use super::staging::Staging;
use crate::service::bodies;
use crate::service::failpoint::fault;
use crate::service::store::artifacts::digest_file;
use crate::service::store::{DATABASE, private};
use serde::{Deserialize, Serialize};
use sqlx::SqlitePool;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, Write};
use std::path::Path;

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

/// Owner of the registered bodies in a list of files.
pub(super) const BODIES: &str = "bodies";

/// Copies the data folder `data` to the new folder `to`, also while its service runs. Returns the number of files.
///
/// # Errors
/// [`BackupError`]; `to` is then not created.
pub async fn back_up(data: &Path, to: &Path) -> Result<usize, BackupError> {
    require_empty(to)?;
    let place = Staging::create(to)?;
    let staging = place.path();
    let copy = staging.join(DATABASE);
    copy_database(data, &copy).await?;

    let copied = open(&copy, true).await?;
    require_files_in_folder(&copied).await?;
    let mut files = Vec::new();
    for file in named_files(&copied).await? {
        match copy_file(data, staging, &file)? {
            Copied::Complete => files.push(file),
            Copied::Missing if is_named_now(data, &file).await? => return Err(damaged(&file)),
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
    files.extend(copy_bodies(data, staging)?);
    files.sort();
    write_manifest(staging, &files)?;
    place.publish()?;
    Ok(files.len())
}

/// Copies the database of a data folder, as it is at one moment, to a new file.
///
/// # Errors
/// When the file exists or cannot be written, or the database fails.
pub(in crate::service) async fn copy_database(data: &Path, copy: &Path) -> Result<(), BackupError> {
    let path = data.join(DATABASE);
    std::fs::metadata(&path).map_err(|source| BackupError::File { path: path.clone(), source })?;
    private::create_file(copy).map_err(|source| BackupError::File { path: copy.to_owned(), source })?;
    let database = open(&path, false).await?;
    sqlx::query("VACUUM INTO $1").bind(copy.display().to_string()).execute(&database).await?;
    database.close().await;
    Ok(())
}

/// A backup copies files of the data folder; those of an object store have backups of their own.
async fn require_files_in_folder(database: &SqlitePool) -> Result<(), BackupError> {
    let tables = sqlx::query_scalar::<_, i64>("SELECT count(*) FROM sqlite_master WHERE name = 'storage'");
    if tables.fetch_one(database).await? == 0 {
        return Ok(()); // the database of an earlier release
    }
    let url: Option<String> = sqlx::query_scalar("SELECT blobs_url FROM storage").fetch_optional(database).await?;
    match url.filter(|url| url != "file:") {
        Some(url) => Err(BackupError::Elsewhere { url }),
        None => Ok(()),
    }
}

/// Creates the data folder `data` from the backup `from` and verifies every file. Returns the number of files.
///
/// # Errors
/// [`BackupError`]; `data` is then not created.
pub fn restore(from: &Path, data: &Path) -> Result<usize, BackupError> {
    require_empty(data)?;
    let manifest = read_manifest(from)?;
    let place = Staging::create(data)?;
    for file in &manifest.files {
        if !is_inside(&file.name) || matches!(copy_file(from, place.path(), file)?, Copied::Missing) {
            return Err(damaged(file));
        }
    }
    place.publish()?;
    Ok(manifest.files.len())
}

pub(super) fn read_manifest(backup: &Path) -> Result<Manifest, BackupError> {
    let path = backup.join(MANIFEST);
    let text = std::fs::read(&path).map_err(|source| BackupError::File { path: path.clone(), source })?;
    serde_json::from_slice(&text).map_err(|source| BackupError::Manifest { path, source })
}

fn damaged(file: &NamedFile) -> BackupError {
    BackupError::Damaged { name: file.name.clone(), owner: file.owner.clone() }
}

/// Whether the database of a data folder still names a file. Rows are deleted before their files: a missing file with a row was lost.
async fn is_named_now(data: &Path, file: &NamedFile) -> Result<bool, BackupError> {
    let database = open(&data.join(DATABASE), false).await?;
    let is_named = named_files(&database).await?.contains(file);
    database.close().await;
    Ok(is_named)
}

enum Copied {
    Complete,
    /// The file was lost, or deleted after the database was copied.
    Missing,
}

/// Copies one file and verifies the digest of the copy.
fn copy_file(from: &Path, to: &Path, file: &NamedFile) -> Result<Copied, BackupError> {
    match copy(from, to, &file.name)? {
        None => Ok(Copied::Missing),
        Some(sha256) if sha256 == file.sha256 => Ok(Copied::Complete),
        Some(_) => Err(damaged(file)),
    }
}

/// Copies the file `name`, which only its owner can read then. Returns the digest of the copy; `None` if it does not exist.
fn copy(from: &Path, to: &Path, name: &str) -> Result<Option<String>, BackupError> {
    let (source, target) = (from.join(name), to.join(name));
    let failed = |source| BackupError::File { path: target.clone(), source };
    if let Some(folder) = target.parent() {
        std::fs::create_dir_all(folder).map_err(failed)?;
    }
    match std::fs::copy(&source, &target) {
        Ok(_) => {}
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(BackupError::File { path: source, source: error }),
    }
    private::restrict(&target).map_err(failed)?;
    File::open(&target).and_then(|copy| copy.sync_all()).map_err(failed)?;
    Ok(Some(digest_file(&target).map_err(failed)?.sha256))
}

/// Copies the registered bodies: first their entries, then the converted bodies that the copied entries name, so that a body
/// that is registered again meanwhile is complete in its earlier or its new form.
fn copy_bodies(data: &Path, to: &Path) -> Result<Vec<NamedFile>, BackupError> {
    let mut files = Vec::new();
    let mut copy_body = |name: &str| -> Result<(), BackupError> {
        let name = format!("{BODIES}/{name}");
        if let Some(sha256) = copy(data, to, &name)? {
            files.push(NamedFile { name, sha256, owner: BODIES.to_owned() });
        }
        Ok(())
    };
    for entry in bodies::entry_files(&bodies::folder(data))? {
        copy_body(&entry)?;
    }
    let converted: BTreeSet<String> = bodies::list(&bodies::folder(to))?.into_iter().map(|body| body.file).collect();
    for file in converted {
        copy_body(&file)?;
    }
    Ok(files)
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

fn write_manifest(folder: &Path, files: &[NamedFile]) -> Result<(), BackupError> {
    let manifest = Manifest { wandless: env!("CARGO_PKG_VERSION").to_owned(), files: files.to_vec() };
    let path = folder.join(MANIFEST);
    let text =
        serde_json::to_vec_pretty(&manifest).map_err(|source| BackupError::Manifest { path: path.clone(), source })?;
    let written = private::create_file(&path).and_then(|mut file| {
        file.write_all(&text)?;
        file.sync_all()
    });
    written.map_err(|source| BackupError::File { path, source })
}
