//! Opens the database of a data folder or a backup, also on read-only media.

use crate::service::store::{DATABASE, StoreError, new_id, private};
use rustix::fs::Access;
use sqlx::SqlitePool;
use sqlx::sqlite::{SqliteConnectOptions, SqlitePoolOptions};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Opens a database file with one connection, without taking the lock of the data folder.
pub(super) async fn open(path: &Path, may_write: bool) -> Result<SqlitePool, StoreError> {
    connect(SqliteConnectOptions::new().filename(path).read_only(!may_write)).await
}

async fn connect(options: SqliteConnectOptions) -> Result<SqlitePool, StoreError> {
    let options = options.busy_timeout(Duration::from_secs(30)).foreign_keys(true);
    Ok(SqlitePoolOptions::new().max_connections(1).connect_with(options).await?)
}

/// A database that is only read.
pub(super) struct Source {
    /// One connection.
    pub(super) database: SqlitePool,
    /// Copy of the database and its write-ahead log; removed on drop.
    _copy: Option<CopiedDatabase>,
}

struct CopiedDatabase(PathBuf);

impl Source {
    /// Opens the database of a folder. SQLite writes an index beside a database with a write-ahead log; where it cannot, a
    /// database without a log is read as it is, and one with a log is copied to the folder of temporary files.
    ///
    /// # Errors
    /// When the database cannot be opened or copied.
    pub(super) async fn open(folder: &Path) -> Result<Self, StoreError> {
        let path = folder.join(DATABASE);
        if rustix::fs::access(folder, Access::WRITE_OK).is_ok() {
            return Ok(Self { database: open(&path, false).await?, _copy: None });
        }
        let log = path.with_extension("db-wal");
        if std::fs::metadata(&log).map_or(0, |log| log.len()) == 0 {
            let options = SqliteConnectOptions::new().filename(&path).read_only(true).immutable(true);
            return Ok(Self { database: connect(options).await?, _copy: None });
        }
        let place = std::env::temp_dir().join(new_id("wandless-verify"));
        let copied = CopiedDatabase::create(&place, &[&path, &log]);
        let copy = copied.map_err(|source| StoreError::Folder { path: place.clone(), source })?;
        Ok(Self { database: open(&place.join(DATABASE), true).await?, _copy: Some(copy) })
    }
}

impl CopiedDatabase {
    fn create(place: &Path, files: &[&Path]) -> io::Result<Self> {
        private::create_folder(place)?;
        let copy = Self(place.to_owned());
        for file in files {
            let name = file.file_name().unwrap_or_default();
            io::copy(&mut std::fs::File::open(file)?, &mut private::create_file(&place.join(name))?)?;
        }
        Ok(copy)
    }
}

impl Drop for CopiedDatabase {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_dir_all(&self.0) {
            tracing::warn!(path = %self.0.display(), %error, "cannot be removed");
        }
    }
}
