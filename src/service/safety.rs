//! Backup, restore and verification of a data folder.
//!
//! A backup is a folder that only its owner can read: `wandless.db` (one consistent copy, made by SQLite), `sessions/`,
//! `results/`, `bodies/` and `backup.json` with the digest of every file. Files are written once and never changed, so they can be copied while the service
//! runs; rows whose files were deleted during the copy are removed from the copied database.

mod backup;
mod error;
mod inventory;
mod source;
mod staging;
mod verify;
#[cfg(feature = "scale")]
mod verify_shared;

#[cfg(feature = "scale")]
pub(in crate::service) use backup::copy_database;
pub use backup::{back_up, restore};
pub use error::BackupError;
pub use verify::{Report, verify};
#[cfg(feature = "scale")]
pub use verify_shared::{SharedReport, verify_shared};
