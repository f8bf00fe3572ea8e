//! The database file of a data folder: opened, created or migrated, with one connection for each kind of work.

use super::blobs::Blobs;
use super::database::{Engine, Store};
use super::error::StoreError;
use super::folders::Folders;
use super::space::Space;
use super::sql::SqlPool;
use super::{schema, shrink};
use crate::service::failpoint::{failpoint, fault};
use sqlx::pool::PoolOptions;
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqliteSynchronous};
use sqlx::{ConnectOptions, Connection, Database, Sqlite};
use std::io;
use std::path::Path;
use std::time::{Duration, Instant};

/// How long to wait for a database that another process has locked.
const BUSY_PATIENCE: Duration = Duration::from_secs(10);

/// SQLite 3.7.0 to 3.51.2 can corrupt the file if two connections write and checkpoint at the same time.
const OLDEST_SOUND_SQLITE: [u32; 3] = [3, 51, 3];

/// Settings of every connection: checkpoints are made in [`super::pages`] alone, and deleted rows leave no bytes in the file.
const PRAGMAS: [(&str, &str); 2] = [("wal_autocheckpoint", "0"), ("secure_delete", "ON")];

/// Opens the database of a data folder; uploads and results are in the folder, too.
///
/// # Errors
/// [`StoreError`].
pub(super) async fn open(folders: Folders) -> Result<Store, StoreError> {
    let path = folders.database();
    open_database(folders).await.map_err(|error| error.of_file(&path))
}

async fn open_database(folders: Folders) -> Result<Store, StoreError> {
    failpoint("start.locked");
    let database = folders.database();
    let is_lost = |is_empty: bool| Ok::<_, StoreError>(is_empty && folders.hold_files()? && !fault("damage.silent"));
    let is_new = is_missing_or_empty(&database);
    if is_lost(is_new)? {
        return Err(StoreError::DatabaseLost { path: database });
    }
    let options = PRAGMAS.iter().fold(
        SqliteConnectOptions::new()
            .filename(&database)
            .journal_mode(SqliteJournalMode::Wal)
            .foreign_keys(true)
            .busy_timeout(busy_patience()),
        |options, (name, value)| options.pragma(*name, *value),
    );
    match (is_new, folders.are_owned()) {
        (true, true) => schema::create(&folders, &options).await?,
        (true, false) => await_creation(&database).await?,
        (false, _) => {}
    }
    // A pool repeats what fails after a connection is made until its patience ends. What is wrong with the file is found here, and
    // the connection stays until there is another one: the last one would empty the write-ahead log.
    let probe = options.connect().await?;
    let writer = connect(1, &options, SqliteSynchronous::Full).await?;
    probe.close().await?;
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
    let checkpointer = pool::<Sqlite>(1).connect_lazy_with(options.clone().synchronous(SqliteSynchronous::Full));
    let reading = options.clone().read_only(true);
    let (progress_writer, readers) = tokio::try_join!(
        connect(1, &options, SqliteSynchronous::Normal),
        connect(4, &reading, SqliteSynchronous::Full)
    )?;
    Ok(Store {
        writer,
        progress_writer,
        readers,
        engine: Engine::Sqlite { checkpointer },
        space: Space::default(),
        blobs: Blobs::Folder(folders.clone()),
        folders,
        boot: uuid::Uuid::new_v4().simple().to_string(),
    })
}

fn busy_patience() -> Duration {
    if fault("busy.impatient") { Duration::ZERO } else { BUSY_PATIENCE }
}

/// A pool of `n` connections of the SQL layer with these options.
#[cfg(not(feature = "scale"))]
async fn connect(n: u32, options: &SqliteConnectOptions, synchronous: SqliteSynchronous) -> sqlx::Result<SqlPool> {
    pool(n).connect_with(options.clone().synchronous(synchronous)).await
}

/// A pool of `n` connections of the SQL layer with these options, which it takes as a URL; that has no place for pragmas.
#[cfg(feature = "scale")]
async fn connect(n: u32, options: &SqliteConnectOptions, synchronous: SqliteSynchronous) -> sqlx::Result<SqlPool> {
    use super::sql::SqlOptions;
    use sqlx::{AssertSqlSafe, Executor};
    use std::sync::Arc;
    sqlx::any::install_default_drivers();
    let patience = busy_patience().as_millis();
    let mut pragmas = format!("PRAGMA busy_timeout = {patience}; PRAGMA journal_mode = WAL; PRAGMA foreign_keys = ON;");
    let level = if matches!(synchronous, SqliteSynchronous::Normal) { "NORMAL" } else { "FULL" };
    for (name, value) in PRAGMAS.iter().chain(&[("synchronous", level)]) {
        pragmas.push_str(&format!(" PRAGMA {name} = {value};"));
    }
    let pragmas: Arc<str> = pragmas.into();
    let pool = pool::<sqlx::Any>(n).after_connect(move |connection, _| {
        let pragmas = AssertSqlSafe(pragmas.clone()); // the words are our own
        Box::pin(async move { connection.execute(sqlx::raw_sql(pragmas)).await.map(drop) })
    });
    pool.connect_with(SqlOptions::from_url(&options.to_url_lossy())?).await
}

/// A pool of at most `n` connections, which stay open.
fn pool<DB: Database>(n: u32) -> PoolOptions<DB> {
    let pool = PoolOptions::<DB>::new().max_connections(n).idle_timeout(None).max_lifetime(None);
    // SQLite ends a transaction by itself when the disk is full; sqlx's connection would then assume forever that it is
    // still inside a transaction, so it is replaced.
    let pool = pool.before_acquire(|connection, _| {
        let is_sound = !connection.is_in_transaction();
        Box::pin(async move { Ok(is_sound) })
    });
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

async fn require_sound_sqlite(pool: &SqlPool) -> Result<(), StoreError> {
    let found: String = sqlx::query_scalar("SELECT sqlite_version()").fetch_one(pool).await?;
    let parts: Vec<u32> = found.split('.').filter_map(|part| part.parse().ok()).collect();
    if parts.as_slice() < OLDEST_SOUND_SQLITE.as_slice() {
        return Err(StoreError::UnsoundSqlite { found });
    }
    Ok(())
}
