//! Moves a stopped service of one machine, its SQLite database and its files, to a PostgreSQL server and an object store.
//!
//! The data folder is only read: its database is copied, and the copy is brought to the tables of this release. Files go first, each
//! compared with its digest after it was stored; then all rows in one transaction, which is committed only if every table reads back
//! as it was. So the target is empty or complete, and an interrupted move is repeated: files that are there are not stored again.

mod error;
mod files;
mod moved;
mod rows;
mod source;

pub use error::TransferError;
pub use moved::{FileProgress, Moved};

use super::Settings;
use super::bodies;
use super::store::{Store, new_id};
use source::Source;
use std::path::Path;

/// Moves the service of the data folder `from` to the database and the object store of the settings.
///
/// # Errors
/// [`TransferError`]; no row of the target was changed then.
pub async fn transfer(
    from: &Path,
    settings: &Settings,
    progress: impl Fn(FileProgress),
) -> Result<Moved, TransferError> {
    let scratch = source::Scratch::create(&std::env::temp_dir().join(new_id("wandless-migrate")))?;
    let source = Source::open(from, &scratch.0.join("source")).await?;
    let settings = Settings { data: scratch.0.join("target"), ..settings.clone() };
    let target = Store::open_for(&settings).await?;
    if !target.is_shared() {
        return Err(TransferError::NoServer);
    }
    rows::require_empty(&target).await?;
    let mut moved =
        Moved { bodies: bodies::list(&bodies::folder(from)).map_or(0, |bodies| bodies.len()), ..Moved::default() };
    files::store(&source, from, &target, &mut moved, progress).await?;
    rows::store(&source, &target, &mut moved).await?;
    source.close().await;
    target.close().await;
    Ok(moved)
}
