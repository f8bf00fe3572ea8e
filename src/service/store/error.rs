//! Errors of the store.

use sqlx::migrate::MigrateError;
use std::path::{Path, PathBuf};

/// Why the data folder cannot be used, or a statement failed.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// A file or folder could not be created, read or written.
    #[error("{path}: {source}", path = .path.display())]
    Folder {
        /// Path of the file or folder.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// Another service process owns the folder.
    #[error("{path}: another wandless service is using this data folder; stop it, or choose another --data folder", path = .path.display())]
    InUse {
        /// The lock file.
        path: PathBuf,
    },
    /// Uploads or results exist, but the database is missing or empty.
    #[error("{path}: the database is missing or empty but the folder contains uploads or results; restore it from a backup, or choose another --data folder", path = .path.display())]
    DatabaseLost {
        /// The database file.
        path: PathBuf,
    },
    /// The file is not a database, or is damaged.
    #[error("{path}: the database is damaged: {reason}; restore it from a backup (`wandless restore`), or run `wandless verify` for details", path = .path.display())]
    DatabaseDamaged {
        /// The database file.
        path: PathBuf,
        /// Error message of SQLite.
        reason: String,
    },
    /// The database was written by a newer release.
    #[error(
        "the database contains migration {migration}, which this release does not know; use the newer wandless that wrote it"
    )]
    Newer {
        /// Number of the unknown migration.
        migration: i64,
    },
    /// The linked SQLite library has a known corruption bug.
    #[error("SQLite {found} can corrupt the database file; version 3.51.3 or newer is required")]
    UnsoundSqlite {
        /// Version of the linked library.
        found: String,
    },
    /// A migration failed.
    #[error("migration: {0}")]
    Migration(#[source] MigrateError),
    /// A statement failed.
    #[error("database: {0}")]
    Database(#[from] sqlx::Error),
    /// Fewer bytes are free than must stay free besides those for uploads that are arriving.
    #[error("{free} bytes of the disk are free, {announced} are needed for uploads, and {min} must stay free")]
    DiskFull {
        /// Free bytes.
        free: u64,
        /// Bytes of this upload and of the others that are arriving.
        announced: u64,
        /// Minimum (`limits.min_free_bytes`).
        min: u64,
    },
    /// The operating system provides no random numbers.
    #[error("the operating system provides no random numbers")]
    NoRandomness,
    /// A stored JSON text cannot be parsed.
    #[error("stored JSON: {0}")]
    Json(#[from] serde_json::Error),
}

impl StoreError {
    /// Whether the disk is full: below its minimum of free bytes, SQLite's FULL, or a failed write or shared memory allocation.
    pub fn is_disk_full(&self) -> bool {
        match self {
            Self::DiskFull { .. } => true,
            Self::Database(sqlx::Error::Database(cause)) => {
                matches!(cause.code().as_deref(), Some("13" | "778" | "4874"))
            }
            _ => false,
        }
    }

    /// Whether a repetition fails in the same way, because the values do not fit the tables: SQLite's TOOBIG, CONSTRAINT and
    /// MISMATCH, or a value that cannot be converted.
    pub fn is_of_values(&self) -> bool {
        match self {
            Self::Database(sqlx::Error::Database(cause)) => {
                let code = cause.code().and_then(|code| code.parse::<u32>().ok());
                code.is_some_and(|code| matches!(code & 0xff, 18..=20))
            }
            Self::Database(sqlx::Error::Encode(_) | sqlx::Error::Decode(_) | sqlx::Error::ColumnDecode { .. }) => true,
            Self::Json(_) => true,
            _ => false,
        }
    }

    /// Converts SQLite's CORRUPT and NOTADB to [`StoreError::DatabaseDamaged`] with the path of the file.
    pub(super) fn of_file(self, path: &Path) -> Self {
        let cause = match &self {
            Self::Database(cause) | Self::Migration(MigrateError::Execute(cause)) => cause,
            _ => return self,
        };
        let error = cause.as_database_error().filter(|error| matches!(error.code().as_deref(), Some("11" | "26")));
        match error {
            Some(error) => Self::DatabaseDamaged { path: path.to_owned(), reason: error.message().to_owned() },
            None => self,
        }
    }
}
