//! Backup, restore and verification of a data folder.
//!
//! A backup is a folder: `wandless.db` (one consistent copy, made by SQLite), `sessions/`, `results/` and `backup.json`
//! with the digest of every file. Files are written once and never changed, so they can be copied while the service
//! runs; rows whose files were deleted during the copy are removed from the copied database.

mod backup;
mod inventory;
mod verify;

pub use backup::{BackupError, back_up, restore};
pub use verify::{Report, verify};
