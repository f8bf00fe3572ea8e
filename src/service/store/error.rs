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
    /// Only newer releases may use the database.
    #[error(
        "the database needs wandless {oldest} or newer, this is {}; upgrade this node", env!("CARGO_PKG_VERSION")
    )]
    TooOld {
        /// The oldest release that may use it.
        oldest: String,
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
    /// The setting needs a feature of the build that is missing.
    #[error(
        "{setting} names {value}, but this program was built without the feature `scale`; set it to {embedded}, or use a build with PostgreSQL and S3"
    )]
    WithoutScale {
        /// Name of the setting.
        setting: &'static str,
        /// Its value, without secrets.
        value: String,
        /// The value that needs nothing.
        embedded: &'static str,
    },
    /// The URL of the database is not understood. It is not repeated: it can hold a password.
    #[error("store.url: expected `sqlite:` or postgres://user:password@host/database")]
    StoreUrl,
    /// The PostgreSQL server is too old.
    #[error("PostgreSQL {found} is too old; version 15 or newer is required")]
    OldPostgres {
        /// Major version of the server.
        found: i64,
    },
    /// The URL of the object store is not understood.
    #[error("blobs.url is {url}: {reason}")]
    BlobsUrl {
        /// The URL, which holds no secret.
        url: String,
        /// What was expected.
        reason: String,
    },
    /// The files of the database are in another store.
    #[error("blobs.url is {given}, but the uploads and results of this database are in {known}; set blobs.url to that")]
    OtherBlobs {
        /// URL of the store with the files.
        known: String,
        /// The setting.
        given: String,
    },
    /// The object store fails or does not answer.
    #[error("{key}: the object store failed: {source}")]
    Blobs {
        /// Key of the object.
        key: String,
        /// Its error.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// An object is missing or has other bytes than those that were stored.
    #[error("{key}: {reason}")]
    BlobDamaged {
        /// Key of the object.
        key: String,
        /// What is wrong.
        reason: &'static str,
    },
    /// The object store keeps no versions of objects.
    #[error("no object can be brought back: {reason}")]
    Unversioned {
        /// Why.
        reason: String,
    },
    /// The operating system provides no random numbers.
    #[error("the operating system provides no random numbers")]
    NoRandomness,
    /// A stored JSON text cannot be parsed.
    #[error("stored JSON: {0}")]
    Json(#[from] serde_json::Error),
}

impl StoreError {
    /// Whether the disk is full: below its minimum of free bytes, SQLite's FULL, or a failed write or shared memory allocation, or
    /// PostgreSQL's `disk_full`.
    pub fn is_disk_full(&self) -> bool {
        match self {
            Self::DiskFull { .. } => true,
            Self::Database(sqlx::Error::Database(cause)) => {
                matches!(cause.code().as_deref(), Some("13" | "778" | "4874" | "53100"))
            }
            _ => false,
        }
    }

    /// Whether a repetition fails in the same way, because the values do not fit the tables: SQLite's TOOBIG, CONSTRAINT and
    /// MISMATCH, PostgreSQL's classes 22 and 23, or a value that cannot be converted.
    pub fn is_of_values(&self) -> bool {
        match self {
            Self::Database(sqlx::Error::Database(cause)) => {
                let code = cause.code().unwrap_or_default();
                match code.parse::<u32>() {
                    Ok(code) if !is_sqlstate(&cause.code()) => matches!(code & 0xff, 18..=20),
                    _ => ["22", "23"].iter().any(|class| code.starts_with(class)),
                }
            }
            Self::Database(sqlx::Error::Encode(_) | sqlx::Error::Decode(_) | sqlx::Error::ColumnDecode { .. }) => true,
            Self::Json(_) => true,
            _ => false,
        }
    }

    /// Whether the database is busy or away for a moment, so that a repetition can succeed: SQLite's BUSY and LOCKED; of PostgreSQL a
    /// lost connection, a full server, a restart, a lock that took too long, a deadlock.
    pub fn is_busy(&self) -> bool {
        match self {
            Self::Database(sqlx::Error::PoolTimedOut) => true,
            Self::Database(sqlx::Error::Io(_) | sqlx::Error::Tls(_)) => cfg!(feature = "scale"),
            Self::Database(sqlx::Error::Database(cause)) => match cause.code().as_deref() {
                Some("5" | "6" | "261" | "517") => true,
                Some(code) if is_sqlstate(&cause.code()) => {
                    ["08", "40", "53", "55", "57", "25P"].iter().any(|class| code.starts_with(class)) && code != "53100"
                }
                _ => false,
            },
            _ => false,
        }
    }

    /// A setting that needs the feature `scale`.
    #[cfg(not(feature = "scale"))]
    pub(super) fn without_scale(setting: &'static str, value: &str, embedded: &'static str) -> Self {
        Self::WithoutScale { setting, value: value.to_owned(), embedded }
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

/// Whether a code is one of PostgreSQL, five characters; those of SQLite are numbers of up to four digits.
fn is_sqlstate(code: &Option<std::borrow::Cow<'_, str>>) -> bool {
    code.as_ref().is_some_and(|code| code.len() == 5)
}
