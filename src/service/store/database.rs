//! The database connections of a service process.

use super::blobs::Blobs;
use super::error::StoreError;
use super::folders::Folders;
use super::shrink;
use super::space::Space;
use super::sql::SqlPool;
pub(crate) use super::sql::WriteTransaction;
use crate::service::failpoint::lose_answer;
use sqlx::sqlite::SqlitePool;
use std::path::PathBuf;

/// The database and the folders of one service process.
#[derive(Debug, Clone)]
pub struct Store {
    /// Changes job states: acknowledged changes survive a power cut. One connection of SQLite.
    pub(super) writer: SqlPool,
    /// Writes progress; a power cut can lose the last second, but not damage the database. One connection of SQLite.
    pub(super) progress_writer: SqlPool,
    /// Reads.
    pub(super) readers: SqlPool,
    /// The database behind the connections.
    pub(super) engine: Engine,
    /// Free space of the disk and uploads that are arriving.
    pub(super) space: Space,
    /// Folders of the files.
    pub folders: Folders,
    /// Where uploads and results are kept.
    pub(crate) blobs: Blobs,
    /// Id of this process: with SQLite a running job of another boot is an orphan.
    pub boot: String,
}

/// The database behind the connections.
#[derive(Debug, Clone)]
pub(super) enum Engine {
    /// A file of the data folder.
    Sqlite {
        /// Copies the write-ahead log into the database; the only connection that does, see [`super::pages`].
        checkpointer: SqlitePool,
    },
    /// A server that several processes share.
    #[cfg(feature = "scale")]
    Postgres(Box<super::postgres::server::Server>),
}

/// Disk usage of a data folder; values that the system does not report are 0.
#[derive(Debug, Default)]
pub struct DiskUsage {
    /// Free bytes of the disk that this process may use.
    pub free_bytes: u64,
    /// Size of the database file, bytes.
    pub database_bytes: u64,
    /// Size of the write-ahead log, bytes.
    pub wal_bytes: u64,
}

impl Store {
    /// The connection that makes checkpoints, of a database in the data folder.
    pub(super) fn checkpointer(&self) -> Option<&SqlitePool> {
        match &self.engine {
            Engine::Sqlite { checkpointer } => Some(checkpointer),
            #[cfg(feature = "scale")]
            Engine::Postgres(_) => None,
        }
    }

    /// Whether several processes share the database.
    pub(crate) fn is_shared(&self) -> bool {
        !matches!(self.engine, Engine::Sqlite { .. })
    }

    /// Starts a transaction that may change job states; durable once committed.
    ///
    /// # Errors
    /// When the database is locked or fails.
    pub(crate) async fn write(&self) -> Result<WriteTransaction, sqlx::Error> {
        match self.engine {
            Engine::Sqlite { .. } => self.writer.begin_with("BEGIN IMMEDIATE").await,
            #[cfg(feature = "scale")]
            Engine::Postgres(_) => self.writer.begin().await,
        }
    }

    /// Commits a transaction of [`Store::write`]. After an error the transaction may be committed or not; a caller that
    /// removes or repeats something must look first.
    ///
    /// # Errors
    /// When the database fails.
    pub(crate) async fn commit(&self, transaction: WriteTransaction) -> Result<(), sqlx::Error> {
        transaction.commit().await?;
        Ok(lose_answer()?)
    }

    /// Starts a transaction for progress and similar data, which a power cut may lose.
    ///
    /// # Errors
    /// When the database is locked or fails.
    pub(crate) async fn write_relaxed(&self) -> Result<WriteTransaction, sqlx::Error> {
        match self.engine {
            Engine::Sqlite { .. } => self.progress_writer.begin_with("BEGIN IMMEDIATE").await,
            #[cfg(feature = "scale")]
            Engine::Postgres(_) => super::postgres::server::begin_relaxed(&self.progress_writer).await,
        }
    }

    /// Connections for reading.
    pub(crate) fn read(&self) -> &SqlPool {
        &self.readers
    }

    /// Reads the free disk space and the size of the database.
    pub fn disk_usage(&self) -> DiskUsage {
        let bytes = |path: PathBuf| std::fs::metadata(path).map_or(0, |file| file.len());
        let database = self.folders.database();
        DiskUsage {
            free_bytes: self.folders.free_bytes().unwrap_or(0),
            wal_bytes: bytes(database.with_extension("db-wal")),
            database_bytes: bytes(database),
        }
    }

    /// Checks that the database accepts writes.
    ///
    /// # Errors
    /// When it does not.
    pub async fn check_writable(&self) -> Result<(), StoreError> {
        let transaction = self.write_relaxed().await?;
        Ok(transaction.rollback().await?)
    }

    /// Removes one entry of `sessions`, `results` or `checkpoints` without blocking the threads that answer clients.
    pub async fn remove_files(&self, folder: &'static str, name: &str) {
        let (folders, name) = (self.folders.clone(), name.to_owned());
        // Fails only when the process ends; the next start removes files without a row.
        self.remove_objects(format!("{folder}/{name}"));
        let _ = tokio::task::spawn_blocking(move || folders.remove(folder, &name)).await;
    }

    /// Removes what one claim of a job has written, without blocking the threads that answer clients.
    pub async fn remove_claim(&self, job: &str, fence: i64) {
        let (folders, job) = (self.folders.clone(), job.to_owned());
        // Fails only when the process ends; the next start removes files without a row.
        self.remove_objects(format!("results/{job}/{fence}"));
        let _ = tokio::task::spawn_blocking(move || folders.remove_claim(&job, fence)).await;
    }

    /// Removes what an object store has below a folder, without waiting for it: the sweep removes what stays.
    fn remove_objects(&self, folder: String) {
        if self.blobs.are_remote() {
            let blobs = self.blobs.clone();
            tokio::spawn(async move { blobs.remove(&folder).await });
        }
    }

    /// Removes the reserve file, so that operations that free space also work on a full disk.
    pub async fn release_reserve(&self) {
        let folders = self.folders.clone();
        let _ = tokio::task::spawn_blocking(move || folders.release_reserve()).await; // fails only when the process ends
    }

    /// Creates the reserve file again if there is space.
    pub async fn create_reserve(&self) {
        let folders = self.folders.clone();
        let _ = tokio::task::spawn_blocking(move || folders.create_reserve()).await; // fails only when the process ends
    }

    /// Returns some free pages of the database to the disk if a large part of it is free.
    ///
    /// # Errors
    /// When the database fails.
    pub(super) async fn shrink(&self) -> Result<(), StoreError> {
        Ok(shrink::step(&self.readers, &self.progress_writer).await?)
    }

    /// Closes the connections after their last statement; the owner of a folder with a database empties the write-ahead log first.
    pub async fn close(&self) {
        self.readers.close().await;
        if let Some(checkpointer) = self.checkpointer() {
            if self.folders.are_owned()
                && let Err(error) = self.checkpoint().await
            {
                tracing::warn!(%error, "the last checkpoint failed; the write-ahead log stays beside the database");
            }
            checkpointer.close().await;
        }
        self.progress_writer.close().await;
        self.writer.close().await;
    }
}
