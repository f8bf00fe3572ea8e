//! The data folder: one SQLite database and the files its rows name. Nothing else knows which database or disk it is.

pub mod artifacts;
mod error;
pub mod folders;
pub mod keys;
mod log;
pub(crate) mod pages;
pub mod sessions;
pub mod summary;
pub mod tenants;

pub use error::StoreError;
pub use folders::{DATABASE, Folders};
pub use tenants::Tenant;

use crate::service::failpoint::{failpoint, fault};
use sqlx::migrate::{MigrateError, Migrator};
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteSynchronous};
use sqlx::{Connection, Sqlite, Transaction};
use std::path::{Path, PathBuf};
use std::time::Duration;

static MIGRATIONS: Migrator = sqlx::migrate!("./migrations");

/// How long a database that another process holds is waited for.
const BUSY_PATIENCE: Duration = Duration::from_secs(10);

/// 3.7.0 to 3.51.2 can corrupt the file when two connections write and checkpoint at the same moment.
const OLDEST_SOUND_SQLITE: [u32; 3] = [3, 51, 3];

/// The database and the folders of one service process.
#[derive(Debug, Clone)]
pub struct Store {
    /// The one connection that changes states: `synchronous = FULL`, so what was acknowledged survives a power cut.
    writer: SqlitePool,
    /// Progress is written here: `synchronous = NORMAL`, the last second may be lost, the file never.
    notes: SqlitePool,
    readers: SqlitePool,
    /// Copies the log into the database; no other connection does, see [`pages`].
    keeper: SqlitePool,
    /// Where the files lie.
    pub folders: Folders,
    /// Names this process: a running job of another boot is an orphan.
    pub boot: String,
}

/// The data folder in figures; what the system does not tell is 0.
#[derive(Debug, Default)]
pub struct DiskFigures {
    /// Bytes that the disk has left for us.
    pub free_bytes: u64,
    /// Size of the database file.
    pub database_bytes: u64,
    /// Size of its write-ahead log.
    pub wal_bytes: u64,
}

impl Store {
    /// Takes the folder for this process, opens the database and brings it to this release's schema.
    ///
    /// # Errors
    /// [`StoreError`], each naming what stands in the way.
    pub async fn open(root: &Path) -> Result<Self, StoreError> {
        Self::open_in(Folders::open(root)?).await
    }

    async fn open_in(folders: Folders) -> Result<Self, StoreError> {
        let path = folders.database();
        Self::open_database(folders).await.map_err(|error| error.of_file(&path))
    }

    /// The store of a service that is at work, for a command beside it; where none is at work, as [`Store::open`].
    ///
    /// # Errors
    /// As there.
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
            |has_nothing: bool| Ok::<_, StoreError>(has_nothing && folders.hold_files()? && !fault("damage.silent"));
        if is_lost(std::fs::metadata(&database).map_or(0, |m| m.len()) == 0)? {
            return Err(StoreError::DatabaseLost { path: database });
        }
        let options = SqliteConnectOptions::new()
            .filename(&database)
            .create_if_missing(true)
            .journal_mode(SqliteJournalMode::Wal)
            .foreign_keys(true)
            .busy_timeout(if fault("busy.impatient") { Duration::ZERO } else { BUSY_PATIENCE })
            .pragma("wal_autocheckpoint", "0")
            .pragma("secure_delete", "ON");
        let pool = |options: SqliteConnectOptions, n: u32| {
            let pool = SqlitePoolOptions::new().max_connections(n).idle_timeout(None).max_lifetime(None);
            // SQLite ends a transaction by itself where the disk is full; the connection then believes for ever that it is
            // still inside of one, and is replaced.
            let pool = pool.before_acquire(|connection, _| Box::pin(async { Ok(!connection.is_in_transaction()) }));
            pool.acquire_timeout(Duration::from_secs(30)).connect_with(options)
        };
        let writer = pool(options.clone().synchronous(SqliteSynchronous::Full), 1).await?;
        require_sound_sqlite(&writer).await?;
        // A file without its write-ahead log can be a whole database without a table.
        let n_tables: i64 = sqlx::query_scalar("SELECT count(*) FROM sqlite_master").fetch_one(&writer).await?;
        if is_lost(n_tables == 0)? {
            return Err(StoreError::DatabaseLost { path: database });
        }
        MIGRATIONS.run(&writer).await.map_err(|error| match error {
            MigrateError::VersionMissing(migration) => StoreError::Newer { migration },
            other => StoreError::Migration(other),
        })?;
        failpoint("start.migrated");
        if fault("claims.scanned") {
            sqlx::query("DROP INDEX IF EXISTS jobs_by_state").execute(&writer).await?;
        }
        folders.take_reserve();
        let notes = pool(options.clone().synchronous(SqliteSynchronous::Normal), 1).await?;
        let keeper = pool(options.clone().synchronous(SqliteSynchronous::Full), 1).await?;
        let readers = pool(options.read_only(true), 4).await?;
        Ok(Self { writer, notes, readers, keeper, folders, boot: uuid::Uuid::new_v4().simple().to_string() })
    }

    /// A transaction that may change states; durable once committed.
    ///
    /// # Errors
    /// When the database does not answer.
    pub(crate) async fn write(&self) -> Result<Transaction<'static, Sqlite>, sqlx::Error> {
        self.writer.begin_with("BEGIN IMMEDIATE").await
    }

    /// A transaction whose loss in a power cut would not be missed.
    ///
    /// # Errors
    /// When the database does not answer.
    pub(crate) async fn note(&self) -> Result<Transaction<'static, Sqlite>, sqlx::Error> {
        self.notes.begin_with("BEGIN IMMEDIATE").await
    }

    /// Connections that only read.
    pub(crate) fn read(&self) -> &SqlitePool {
        &self.readers
    }

    /// How full the disk is and how large the database.
    pub fn disk_figures(&self) -> DiskFigures {
        let bytes = |path: PathBuf| std::fs::metadata(path).map_or(0, |file| file.len());
        let database = self.folders.database();
        DiskFigures {
            free_bytes: self.folders.free_bytes().unwrap_or(0),
            wal_bytes: bytes(database.with_extension("db-wal")),
            database_bytes: bytes(database),
        }
    }

    /// Whether the database takes writes.
    ///
    /// # Errors
    /// When it does not.
    pub async fn check_writable(&self) -> Result<(), StoreError> {
        let transaction = self.notes.begin_with("BEGIN IMMEDIATE").await?;
        Ok(transaction.rollback().await?)
    }

    /// Removes one name of `sessions` or `results` without holding up the threads that answer clients.
    pub async fn remove_files(&self, folder: &'static str, name: &str) {
        let (folders, name) = (self.folders.clone(), name.to_owned());
        // Fails only where the process ends; the next start removes what no row names.
        let _ = tokio::task::spawn_blocking(move || folders.remove(folder, &name)).await;
    }

    /// Gives the bytes up that were kept for this moment: what frees space must work on a full disk, too.
    pub async fn give_reserve_up(&self) {
        let folders = self.folders.clone();
        let _ = tokio::task::spawn_blocking(move || folders.give_reserve_up()).await; // fails only where the process ends
    }

    /// Keeps bytes back again, where there is room.
    pub async fn take_reserve(&self) {
        let folders = self.folders.clone();
        let _ = tokio::task::spawn_blocking(move || folders.take_reserve()).await; // fails only where the process ends
    }

    /// Closes the connections after their last statement; whoever owns the folder leaves no log behind.
    pub async fn close(&self) {
        self.readers.close().await;
        if self.folders.are_owned()
            && let Err(error) = self.checkpoint().await
        {
            tracing::warn!(%error, "the log stays beside the database");
        }
        self.keeper.close().await;
        self.notes.close().await;
        self.writer.close().await;
    }
}

async fn require_sound_sqlite(pool: &SqlitePool) -> Result<(), StoreError> {
    let found: String = sqlx::query_scalar("SELECT sqlite_version()").fetch_one(pool).await?;
    let parts: Vec<u32> = found.split('.').filter_map(|part| part.parse().ok()).collect();
    if parts.as_slice() < OLDEST_SOUND_SQLITE.as_slice() {
        return Err(StoreError::UnsoundSqlite { found });
    }
    Ok(())
}

/// A fresh id: `<kind>_` and 122 random bits.
pub fn new_id(kind: &str) -> String {
    format!("{kind}_{}", uuid::Uuid::new_v4().simple())
}
