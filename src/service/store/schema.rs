//! The tables of the database: created at once in a new file, migrated step by step in the file of an earlier release.
//! `migrations/sqlite` is the only text of them.

use super::error::StoreError;
use super::folders::{Folders, publish};
use super::{migrations, private};
use crate::service::failpoint::failpoint;
use sqlx::migrate::{Migrate, MigrateError};
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqliteSynchronous};
use sqlx::{ConnectOptions, Connection};
use std::fs::File;
use std::io;
use std::path::Path;

/// Endings of the files that SQLite keeps beside a database.
const COMPANIONS: [&str; 3] = ["-journal", "-wal", "-shm"];

/// Runs the migrations that the database does not have yet.
///
/// # Errors
/// [`StoreError::Newer`] for a database of a later release, [`StoreError::Migration`] for a failed statement.
pub(super) async fn migrate(database: &mut impl Migrate) -> Result<(), StoreError> {
    migrations::SQLITE.run_direct(None, database, false).await.map_err(|error| match error {
        MigrateError::VersionMissing(migration) => StoreError::Newer { migration },
        other => StoreError::Migration(other),
    })
}

/// Creates the database of an owned folder. `options`: of its later connections.
///
/// The file gets its name when it is complete and on the disk. If the process or the machine ends before, the next start
/// finds no database and creates it; so all tables take one transaction and one write to the disk.
///
/// # Errors
/// When a file or a statement fails.
pub(super) async fn create(folders: &Folders, options: &SqliteConnectOptions) -> Result<(), StoreError> {
    let (path, staging) = (folders.database(), folders.new_database());
    // A log without its database, or of an interrupted creation, would be read into the new file.
    for file in [&path, &staging] {
        remove_companions(file).map_err(|source| StoreError::Folder { path: file.clone(), source })?;
    }
    let created = private::create_file(&staging); // SQLite gives the write-ahead log the same mode
    created.map_err(|source| StoreError::Folder { path: staging.clone(), source })?;
    let options = options.clone().filename(&staging).journal_mode(SqliteJournalMode::Memory);
    let mut database = options.synchronous(SqliteSynchronous::Off).connect().await?;
    // Only an empty file takes this setting. As an option of the connection it would be written before `synchronous` holds.
    sqlx::query("PRAGMA auto_vacuum = INCREMENTAL").execute(&mut database).await?;
    let mut transaction = database.begin().await?;
    migrate(&mut *transaction).await?;
    transaction.commit().await?;
    // The file keeps this setting; a later connection would change it with four writes to the disk.
    sqlx::query("PRAGMA journal_mode = WAL").execute(&mut database).await?;
    database.close().await?;
    let synced = File::open(&staging).and_then(|file| file.sync_all());
    failpoint("create.written");
    let published = synced.and_then(|()| publish(&staging, &path));
    published.map_err(|source| StoreError::Folder { path, source })?;
    failpoint("create.named");
    Ok(())
}

fn remove_companions(database: &Path) -> io::Result<()> {
    for ending in COMPANIONS {
        let mut name = database.as_os_str().to_owned();
        name.push(ending);
        match std::fs::remove_file(Path::new(&name)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
    }
    Ok(())
}
