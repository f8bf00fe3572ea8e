//! Why the store cannot do what it is asked for.

use sqlx::migrate::MigrateError;
use std::path::{Path, PathBuf};

/// Why the data folder cannot be used, or a statement failed.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The folder could not be made, read or written.
    #[error("{path}: {source}", path = .path.display())]
    Folder {
        /// Which file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Another service owns the folder.
    #[error("{path}: another wandless service is using this data folder", path = .path.display())]
    InUse {
        /// The lock file.
        path: PathBuf,
    },
    /// Uploads or results are there, but the database is not.
    #[error("{path}: the database is missing or empty although the folder holds uploads or results; restore it from a backup, or choose another --data folder", path = .path.display())]
    DatabaseLost {
        /// The database file.
        path: PathBuf,
    },
    /// What lies there is no database, or no whole one.
    #[error("{path}: {reason}; restore it from a backup (`wandless restore`), or see what `wandless verify` says", path = .path.display())]
    DatabaseDamaged {
        /// The database file.
        path: PathBuf,
        /// What SQLite said.
        reason: String,
    },
    /// The database was written by a newer release.
    #[error("the database holds migration {migration}, which this release does not know: a newer wandless wrote it")]
    Newer {
        /// The unknown migration.
        migration: i64,
    },
    /// The library linked has a known corruption bug.
    #[error("SQLite {found} can corrupt its file; 3.51.3 or newer is needed")]
    UnsoundSqlite {
        /// The linked version.
        found: String,
    },
    /// A migration failed.
    #[error("migration: {0}")]
    Migration(#[source] MigrateError),
    /// A statement failed.
    #[error("database: {0}")]
    Database(#[from] sqlx::Error),
    /// The system gives no random numbers.
    #[error("the system gives no random numbers")]
    NoRandomness,
    /// A stored JSON text is no longer readable.
    #[error("stored JSON: {0}")]
    Json(#[from] serde_json::Error),
}

impl StoreError {
    /// Whether the disk is what stands in the way: SQLite's FULL, or a write, or its shared memory that found no room.
    pub fn is_disk_full(&self) -> bool {
        let Self::Database(sqlx::Error::Database(cause)) = self else { return false };
        matches!(cause.code().as_deref(), Some("13" | "778" | "4874"))
    }

    /// The same error, naming the file where it is no whole database: SQLite's CORRUPT and NOTADB.
    pub(super) fn of_file(self, path: &Path) -> Self {
        let cause = match &self {
            Self::Database(cause) | Self::Migration(MigrateError::Execute(cause)) => cause,
            _ => return self,
        };
        let said = cause.as_database_error().filter(|said| matches!(said.code().as_deref(), Some("11" | "26")));
        match said {
            Some(said) => Self::DatabaseDamaged { path: path.to_owned(), reason: said.message().to_owned() },
            None => self,
        }
    }
}
