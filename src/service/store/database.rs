//! The database connections of a data folder.

use super::error::StoreError;
use super::folders::Folders;
use super::space::Space;
use super::{schema, shrink};
use crate::service::failpoint::{failpoint, fault, lose_answer};
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteSynchronous};
use sqlx::{Connection, Sqlite, Transaction};
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// How long to wait for a database that another process has locked.
const BUSY_PATIENCE: Duration = Duration::from_secs(10);

/// SQLite 3.7.0 to 3.51.2 can corrupt the file if two connections write and checkpoint at the same time.
const OLDEST_SOUND_SQLITE: [u32; 3] = [3, 51, 3];

/// An open transaction that may write.
pub(crate) type WriteTransaction = Transaction<'static, Sqlite>;

/// The database and the folders of one service process.
#[derive(Debug, Clone)]
pub struct Store {
    /// The only connection that changes job states: `synchronous = FULL`, so acknowledged changes survive a power cut.
    writer: SqlitePool,
    /// Connection for progress: `synchronous = NORMAL`; a power cut can lose the last second, but not damage the file.
    progress_writer: SqlitePool,
    readers: SqlitePool,
    /// Copies the write-ahead log into the database; the only connection that does, see [`super::pages`].
    pub(super) checkpointer: SqlitePool,
    /// Free space of the disk and uploads that are arriving.
    pub(super) space: Space,
    /// Folders of the files.
    pub folders: Folders,
    /// Id of this process: a running job of another boot is an orphan.
    pub boot: String,
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
    /// Locks the folder for this process, opens the database and migrates it to this release's schema.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn open(root: &Path) -> Result<Self, StoreError> {
        Self::open_in(Folders::open(root)?).await
    }

    async fn open_in(folders: Folders) -> Result<Self, StoreError> {
        let path = folders.database();
        Self::open_database(folders).await.map_err(|error| error.of_file(&path))
    }

    /// Opens the store beside a running service, for a command; if no service is running, same as [`Store::open`].
    ///
    /// # Errors
    /// Same as [`Store::open`].
    pub async fn open_beside(root: &Path) -> Result<Self, StoreError> {
        match Folders::open(root) {
            Err(StoreError::InUse { .. }) => Self::open_in(Folders::beside(root)?).await,
            folders => Self::open_in(folders?).await,
        }
    }

    async fn open_database(folders: Folders) -> Result<Self, StoreError> {
        failpoint("start.locked");
        let database = folders.database();
        let is_lost =
            |is_empty: bool| Ok::<_, StoreError>(is_empty && folders.hold_files()? && !fault("damage.silent"));
        let is_new = is_missing_or_empty(&database);
        if is_lost(is_new)? {
            return Err(StoreError::DatabaseLost { path: database });
        }
        let options = SqliteConnectOptions::new()
            .filename(&database)
            .journal_mode(SqliteJournalMode::Wal)
            .foreign_keys(true)
            .busy_timeout(if fault("busy.impatient") { Duration::ZERO } else { BUSY_PATIENCE })
            .pragma("wal_autocheckpoint", "0")
            .pragma("secure_delete", "ON");
        match (is_new, folders.are_owned()) {
            (true, true) => schema::create(&folders, &options).await?,
            (true, false) => await_creation(&database).await?,
            (false, _) => {}
        }
        let writer = pool(1).connect_with(options.clone().synchronous(SqliteSynchronous::Full)).await?;
        require_sound_sqlite(&writer).await?;
        if !is_new {
            // A file without its write-ahead log can be a valid database without tables.
            let n_tables: i64 = sqlx::query_scalar("SELECT count(*) FROM sqlite_master").fetch_one(&writer).await?;
            if is_lost(n_tables == 0)? {
                return Err(StoreError::DatabaseLost { path: database });
            }
            schema::migrate(&mut *writer.acquire().await?).await?;
        }
        failpoint("start.migrated");
        if folders.are_owned() && !is_new {
            shrink::rewrite_if_loose(&writer).await?;
        }
        if fault("claims.scanned") {
            sqlx::query("DROP INDEX IF EXISTS jobs_by_state").execute(&writer).await?;
        }
        folders.create_reserve();
        // The first checkpoint is made seconds after the start.
        let checkpointer = pool(1).connect_lazy_with(options.clone().synchronous(SqliteSynchronous::Full));
        let progress = options.clone().synchronous(SqliteSynchronous::Normal);
        let opening = (pool(1).connect_with(progress), pool(4).connect_with(options.read_only(true)));
        let (progress_writer, readers) = tokio::try_join!(opening.0, opening.1)?;
        Ok(Self {
            writer,
            progress_writer,
            readers,
            checkpointer,
            space: Space::default(),
            folders,
            boot: uuid::Uuid::new_v4().simple().to_string(),
        })
    }

    /// Starts a transaction that may change job states; durable once committed.
    ///
    /// # Errors
    /// When the database is locked or fails.
    pub(crate) async fn write(&self) -> Result<WriteTransaction, sqlx::Error> {
        self.writer.begin_with("BEGIN IMMEDIATE").await
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
        self.progress_writer.begin_with("BEGIN IMMEDIATE").await
    }

    /// Read-only connections.
    pub(crate) fn read(&self) -> &SqlitePool {
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
        let transaction = self.progress_writer.begin_with("BEGIN IMMEDIATE").await?;
        Ok(transaction.rollback().await?)
    }

    /// Removes one entry of `sessions`, `results` or `checkpoints` without blocking the threads that answer clients.
    pub async fn remove_files(&self, folder: &'static str, name: &str) {
        let (folders, name) = (self.folders.clone(), name.to_owned());
        // Fails only when the process ends; the next start removes files without a row.
        let _ = tokio::task::spawn_blocking(move || folders.remove(folder, &name)).await;
    }

    /// Removes what one claim of a job has written, without blocking the threads that answer clients.
    pub async fn remove_claim(&self, job: &str, fence: i64) {
        let (folders, job) = (self.folders.clone(), job.to_owned());
        // Fails only when the process ends; the next start removes files without a row.
        let _ = tokio::task::spawn_blocking(move || folders.remove_claim(&job, fence)).await;
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

    /// Closes the connections after their last statement; the owner of the folder empties the write-ahead log first.
    pub async fn close(&self) {
        self.readers.close().await;
        if self.folders.are_owned()
            && let Err(error) = self.checkpoint().await
        {
            tracing::warn!(%error, "the last checkpoint failed; the write-ahead log stays beside the database");
        }
        self.checkpointer.close().await;
        self.progress_writer.close().await;
        self.writer.close().await;
    }
}

/// A pool of at most `n` connections, which stay open.
fn pool(n: u32) -> SqlitePoolOptions {
    let pool = SqlitePoolOptions::new().max_connections(n).idle_timeout(None).max_lifetime(None);
    // SQLite ends a transaction by itself when the disk is full; sqlx's connection would then assume forever that it is
    // still inside a transaction, so it is replaced.
    let pool = pool.before_acquire(|connection, _| Box::pin(async { Ok(!connection.is_in_transaction()) }));
    pool.acquire_timeout(Duration::from_secs(30))
}

fn is_missing_or_empty(database: &Path) -> bool {
    std::fs::metadata(database).map_or(0, |file| file.len()) == 0
}

/// Waits until the service that owns the folder has created the database.
async fn await_creation(database: &Path) -> Result<(), StoreError> {
    let deadline = Instant::now() + BUSY_PATIENCE;
    while is_missing_or_empty(database) {
        if Instant::now() >= deadline {
            return Err(StoreError::Folder { path: database.to_owned(), source: io::ErrorKind::NotFound.into() });
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    Ok(())
}

async fn require_sound_sqlite(pool: &SqlitePool) -> Result<(), StoreError> {
    let found: String = sqlx::query_scalar("SELECT sqlite_version()").fetch_one(pool).await?;
    let parts: Vec<u32> = found.split('.').filter_map(|part| part.parse().ok()).collect();
    if parts.as_slice() < OLDEST_SOUND_SQLITE.as_slice() {
        return Err(StoreError::UnsoundSqlite { found });
    }
    Ok(())
}
