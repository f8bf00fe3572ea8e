//! Objects that no row names: left by a claim that was lost, by an upload without a row, or by a removal that failed.

use super::super::database::Store;
use super::super::error::StoreError;
use super::Blobs;
use super::objects::Listed;
use crate::service::failpoint::fault;
use std::collections::BTreeSet;

/// Age, by the clock of the object store, below which an object is never removed: its row may still be written. An upload or a
/// publication takes minutes.
const MIN_AGE_S: i64 = 24 * 3600;

/// Removes old objects without a row. Returns their number.
///
/// # Errors
/// When the object store or the database fails.
pub(crate) async fn sweep(store: &Store) -> Result<usize, StoreError> {
    sweep_older_than(store, if fault("sweep.eager") { 0 } else { MIN_AGE_S }).await
}

pub(super) async fn sweep_older_than(store: &Store, min_age_s: i64) -> Result<usize, StoreError> {
    let Blobs::Remote(remote) = &store.blobs else { return Ok(0) };
    let now = remote.objects.now().await?;
    let mut removed = 0;
    for folder in ["sessions", "results", "checkpoints"] {
        // The list is older than the rows that are read then: a row that is written meanwhile is seen.
        let objects = remote.objects.list(folder).await?;
        let old: Vec<Listed> = objects.into_iter().filter(|object| now - object.written_at >= min_age_s).collect();
        if old.is_empty() {
            continue;
        }
        let named = if fault("sweep.eager") { BTreeSet::new() } else { named_folders(store, folder).await? };
        for object in old.iter().filter(|object| !is_named(&object.key, &named)) {
            remote.objects.remove(&object.key).await?;
            removed += 1;
        }
    }
    Ok(removed)
}

/// Whether a key is one of the named ones or below one of them.
fn is_named(key: &str, named: &BTreeSet<String>) -> bool {
    let folder = key.rsplit_once('/').map_or("", |(folder, _)| folder);
    named.contains(key) || named.contains(folder)
}

/// The keys or folders of keys that rows name.
async fn named_folders(store: &Store, folder: &str) -> Result<BTreeSet<String>, StoreError> {
    let names = match folder {
        "sessions" => "SELECT 'sessions/' || id FROM sessions",
        "results" => {
            "SELECT 'results/' || id || '/' || CAST(result_fence AS TEXT) FROM jobs WHERE result_fence IS NOT NULL
             UNION ALL
             SELECT 'results/' || id || '/' || CAST(fence AS TEXT) FROM jobs WHERE state IN ('running', 'canceling')"
        }
        _ => "SELECT 'checkpoints/' || id FROM jobs WHERE state IN ('queued', 'running', 'canceling')",
    };
    let names: Vec<String> = sqlx::query_scalar(names).fetch_all(store.read()).await?;
    Ok(names.into_iter().collect())
}
