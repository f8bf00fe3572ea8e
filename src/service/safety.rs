//! Copies of a data folder, and whether every byte of one is still what was written.
//!
//! A backup is a folder: `wandless.db` (one consistent copy, taken by SQLite), `sessions/`, `results/` and `backup.json`
//! with the digest of every file. Files are written once and never changed, so that they can be copied while the service
//! works; what was deleted in between is taken out of the copied database, too.

mod backup;
mod inventory;
mod verify;

pub use backup::{BackupError, back_up, restore};
pub use verify::{Report, verify};

/// Name of a backup's list of files.
pub const MANIFEST: &str = "backup.json";
