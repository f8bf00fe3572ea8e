//! Errors of backup, restore and verification.

use crate::service::bodies::BodyRegistryError;
use crate::service::store::StoreError;
use std::io;
use std::path::PathBuf;

/// Why a backup or a restore failed.
#[derive(Debug, thiserror::Error)]
pub enum BackupError {
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The target folder is not empty.
    #[error("{}: the folder is not empty; choose another one", path.display())]
    Occupied {
        /// Path of the target folder.
        path: PathBuf,
    },
    /// The target folder has no name of its own.
    #[error("{}: the target has no name; give a path that ends with the name of a new folder", path.display())]
    Unnamed {
        /// The given path.
        path: PathBuf,
    },
    /// The registered bodies cannot be read.
    #[error(transparent)]
    Bodies(#[from] BodyRegistryError),
    /// Uploads and results are not in the data folder.
    #[error(
        "the uploads and results are in {url}; back up the database with the tools of its system and the object store by versions of its objects (docs/operating.md)"
    )]
    Elsewhere {
        /// URL of the object store.
        url: String,
    },
    /// A file differs from its digest.
    #[error("{name}: the file of {owner} is missing or damaged; the target folder was not created")]
    Damaged {
        /// Path below the folder.
        name: String,
        /// Id of the session or job.
        owner: String,
    },
    /// The list of files cannot be read.
    #[error("{}: {source}", path.display())]
    Manifest {
        /// Path of the list.
        path: PathBuf,
        /// Parse error.
        source: serde_json::Error,
    },
    /// The database failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl From<sqlx::Error> for BackupError {
    fn from(error: sqlx::Error) -> Self {
        Self::Store(error.into())
    }
}
