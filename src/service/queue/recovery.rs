//! What a start does before anything is served: orphans go back to the queue, files that no row names are removed.

use super::Queue;
use crate::service::failpoint::{failpoint, fault};
use crate::service::store::{StoreError, sessions};
use sqlx::Row;
use std::collections::BTreeMap;

/// What was found.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Recovered {
    /// Jobs that ran when the last service died: they wait again, and no death is counted against them.
    pub requeued: u64,
    /// Jobs that were being canceled: they are canceled.
    pub canceled: u64,
    /// Files and folders removed.
    pub removed: usize,
}

/// Mends what the death of the last service left. Safe to die in and to repeat.
///
/// The boot id alone says who is an orphan, at once and without a clock: one process owns the data folder, so nobody of
/// another boot can still be at work.
///
/// # Errors
/// When the store fails.
pub async fn recover(queue: &Queue) -> Result<Recovered, StoreError> {
    if fault("recovery.forgets") {
        return Ok(Recovered::default());
    }
    let mut transaction = queue.store.write().await?;
    if fault("recovery.blames") {
        let blamed = sqlx::query("UPDATE jobs SET deaths = deaths + 1 WHERE state = 'running'");
        blamed.execute(&mut *transaction).await?;
    }
    let requeued = sqlx::query(
        "UPDATE jobs SET state = 'queued', version = version + 1, boot = NULL, eta_s = NULL
         WHERE state = 'running' AND boot <> ?",
    )
    .bind(&queue.store.boot)
    .execute(&mut *transaction)
    .await?
    .rows_affected();
    let canceled = sqlx::query(
        "UPDATE jobs SET state = 'canceled', version = version + 1, boot = NULL, eta_s = NULL,
                         finished_at = strftime('%Y-%m-%dT%H:%M:%fZ', 'now')
         WHERE state = 'canceling' AND boot <> ?",
    )
    .bind(&queue.store.boot)
    .execute(&mut *transaction)
    .await?
    .rows_affected();
    failpoint("recover.updated");
    transaction.commit().await?;
    failpoint("recover.committed");
    let removed = sweep(queue).await?;
    failpoint("recover.swept");
    Ok(Recovered { requeued, canceled, removed })
}

/// Removes uploads on their way, uploads without a row, stages of ended jobs, and results other than the published ones.
async fn sweep(queue: &Queue) -> Result<usize, StoreError> {
    let folders = &queue.store.folders;
    let mut removed = 0;
    let mut remove = |folder: &str, name: &str| {
        folders.remove(folder, name);
        removed += 1;
    };
    for name in folders.names("tmp")? {
        remove("tmp", &name);
    }
    let known = sessions::ids(&queue.store).await?;
    for name in folders.names("sessions")? {
        if known.binary_search(&name).is_err() {
            remove("sessions", &name);
        }
    }
    let unended = unended(queue).await?;
    for job in folders.names("checkpoints")? {
        if unended.binary_search(&job).is_err() {
            remove("checkpoints", &job);
        }
    }
    let published = published_fences(queue).await?;
    for job in folders.names("results")? {
        match published.get(&job) {
            None => remove("results", &job),
            Some(fence) => {
                for claim in folders.names(&format!("results/{job}"))? {
                    if claim != fence.to_string() {
                        remove("results", &format!("{job}/{claim}"));
                    }
                }
            }
        }
    }
    Ok(removed)
}

/// Jobs that may still be resumed, sorted.
async fn unended(queue: &Queue) -> Result<Vec<String>, StoreError> {
    let ids = sqlx::query_scalar("SELECT id FROM jobs WHERE state IN ('queued', 'running', 'canceling') ORDER BY id");
    Ok(ids.fetch_all(queue.store.read()).await?)
}

async fn published_fences(queue: &Queue) -> Result<BTreeMap<String, i64>, StoreError> {
    let rows = sqlx::query("SELECT id, result_fence FROM jobs WHERE state = 'succeeded'");
    let rows = rows.fetch_all(queue.store.read()).await?;
    rows.iter().map(|row| Ok((row.try_get("id")?, row.try_get("result_fence")?))).collect()
}
