//! Errors of a move.

use crate::service::safety::BackupError;
use crate::service::store::StoreError;
use std::io;
use std::path::PathBuf;

/// Why a service was not moved.
#[derive(Debug, thiserror::Error)]
pub enum TransferError {
    /// The folder holds no database.
    #[error("{}: the folder has no database of a service", path.display())]
    NoDatabase {
        /// The folder.
        path: PathBuf,
    },
    /// The target is not a PostgreSQL server.
    #[error(
        "store.url is sqlite:, but a service is moved to a PostgreSQL server; name it with WANDLESS_STORE__URL or --config, and the object store with WANDLESS_BLOBS__URL"
    )]
    NoServer,
    /// The target is in use.
    #[error(
        "the target is not empty: its table {table} has {rows} rows; move to a new database, since two services are never merged"
    )]
    NotEmpty {
        /// A table with rows.
        table: &'static str,
        /// Their number.
        rows: i64,
    },
    /// Files of the data folder are missing or damaged.
    #[error(
        "{n} files of the data folder are missing or damaged, the first one {first}; run `wandless verify` on it, and restore them or delete their sessions and jobs"
    )]
    Damaged {
        /// Number of the files.
        n: usize,
        /// The first one and what is wrong.
        first: String,
    },
    /// The database has a table or a column that this release does not move.
    #[error("the database has {what}, which this release does not move")]
    Unknown {
        /// The table or column.
        what: String,
    },
    /// A table reads back with other rows.
    #[error("the table {table} reads back with other rows than those that were written; nothing was committed")]
    Differs {
        /// Name of the table.
        table: &'static str,
    },
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The copy of the database failed.
    #[error(transparent)]
    Copy(#[from] BackupError),
    /// A database or the object store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl From<sqlx::Error> for TransferError {
    fn from(error: sqlx::Error) -> Self {
        Self::Store(error.into())
    }
}
