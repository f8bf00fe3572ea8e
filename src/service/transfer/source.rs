//! The service that is moved: its folder, locked, and a copy of its database with the tables of this release.

use super::error::TransferError;
use crate::service::queue::{Queue, recovery};
use crate::service::safety::copy_database;
use crate::service::store::{DATABASE, Folders, Store, StoreError, private};
use sqlx::SqlitePool;
use sqlx::sqlite::{SqliteConnectOptions, SqlitePoolOptions};
use std::path::{Path, PathBuf};

/// A folder that is removed on drop.
pub(super) struct Scratch(pub(super) PathBuf);

impl Scratch {
    pub(super) fn create(path: &Path) -> Result<Self, TransferError> {
        let created = private::create_folder(path);
        created.map_err(|source| TransferError::File { path: path.to_owned(), source })?;
        Ok(Self(path.to_owned()))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_dir_all(&self.0) {
            tracing::warn!(path = %self.0.display(), %error, "cannot be removed");
        }
    }
}

/// The service that is moved.
pub(super) struct Source {
    /// The copied database; no job runs in it.
    pub(super) database: SqlitePool,
    /// Holds the lock of the folder, so that no service starts on it meanwhile.
    _lock: Folders,
}

impl Source {
    /// Locks the folder, copies its database to the new folder `copy`, migrates the copy, and puts back the jobs that ran when the
    /// service ended.
    ///
    /// # Errors
    /// When a service uses the folder, or the database cannot be read, copied or migrated.
    pub(super) async fn open(folder: &Path, copy: &Path) -> Result<Self, TransferError> {
        if !folder.join(DATABASE).is_file() {
            return Err(TransferError::NoDatabase { path: folder.to_owned() });
        }
        let lock = Folders::open(folder)?;
        let created = private::create_folder(copy);
        created.map_err(|source| TransferError::File { path: copy.to_owned(), source })?;
        copy_database(folder, &copy.join(DATABASE)).await?;
        let store = Store::open(copy).await?;
        let queue = Queue::new(store.clone());
        recovery::recover(&queue).await?;
        store.close().await;
        let options = SqliteConnectOptions::new().filename(copy.join(DATABASE)).read_only(true);
        let database = SqlitePoolOptions::new().max_connections(2).connect_with(options).await;
        Ok(Self { database: database.map_err(StoreError::from)?, _lock: lock })
    }

    pub(super) async fn close(self) {
        self.database.close().await;
    }
}
