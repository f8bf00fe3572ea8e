//! Recovery at start, before serving: orphaned jobs return to the queue, files without a row are removed.

use super::handle::Queue;
use crate::service::failpoint::{failpoint, fault};
use crate::service::store::error::StoreError;
use crate::service::store::sessions;
use std::collections::BTreeMap;

/// Counts of what recovery changed.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Recovered {
    /// Jobs that were running when the previous service process ended; they are queued again without counting a crash.
    pub requeued: u64,
    /// Jobs that were being canceled; they are now canceled.
    pub canceled: u64,
    /// Files and folders removed.
    pub removed: usize,
}

/// Cleans up after the previous service process. May be interrupted at any point and repeated.
///
/// The boot id alone identifies orphans, immediately and without a clock: one process owns the data folder, so no worker
/// of another boot can still be running.
///
/// # Errors
/// When the store fails.
pub async fn recover(queue: &Queue) -> Result<Recovered, StoreError> {
    if fault("recovery.forgets") {
        return Ok(Recovered::default());
    }
    if queue.store.is_shared() {
        return Ok(Recovered { removed: clear_scratch(queue)?, ..Recovered::default() }); // other processes may run the jobs
    }
    let has_orphans = has_orphans(queue).await?;
    let Orphans { requeued, canceled } = if has_orphans { release_orphans(queue).await? } else { Orphans::default() };
    failpoint("recover.committed");
    let removed = sweep(queue).await?;
    failpoint("recover.swept");
    Ok(Recovered { requeued, canceled, removed })
}

/// Counts of the orphans that were released.
#[derive(Debug, Default)]
pub(super) struct Orphans {
    /// Jobs that are queued again.
    pub(super) requeued: u64,
    /// Jobs that are canceled.
    pub(super) canceled: u64,
}

/// Whether a job runs in another boot. A statement that changes jobs writes to the disk even if it finds none.
async fn has_orphans(queue: &Queue) -> Result<bool, StoreError> {
    let any = "SELECT count(*) FROM jobs WHERE state IN ('running', 'canceling') AND boot <> $1";
    Ok(sqlx::query_scalar::<_, i64>(any).bind(&queue.store.boot).fetch_one(queue.store.read()).await? > 0)
}

/// Returns the running jobs that no worker of this process holds to the queue, and ends those that were being canceled.
///
/// # Errors
/// When the store fails.
pub(super) async fn release_orphans(queue: &Queue) -> Result<Orphans, StoreError> {
    let mut transaction = queue.store.write().await?;
    let held = queue.active.as_json(); // under the lock, so that no claim is committed in between
    if fault("recovery.blames") {
        let blamed = sqlx::query("UPDATE jobs SET crashes = crashes + 1 WHERE state = 'running'");
        blamed.execute(&mut *transaction).await?;
    }
    let requeued: Vec<String> = sqlx::query_scalar(
        "UPDATE jobs SET state = 'queued', version = version + 1, boot = NULL, eta_s = NULL
         WHERE state = 'running' AND (boot <> $1 OR id NOT IN (SELECT value FROM json_each($2))) RETURNING id",
    )
    .bind(&queue.store.boot)
    .bind(&held)
    .fetch_all(&mut *transaction)
    .await?;
    let canceled: Vec<String> = sqlx::query_scalar(
        "UPDATE jobs SET state = 'canceled', version = version + 1, boot = NULL, eta_s = NULL,
                         finished_at = strftime('%Y-%m-%dT%H:%M:%fZ', 'now')
         WHERE state = 'canceling' AND (boot <> $1 OR id NOT IN (SELECT value FROM json_each($2))) RETURNING id",
    )
    .bind(&queue.store.boot)
    .bind(&held)
    .fetch_all(&mut *transaction)
    .await?;
    failpoint("recover.updated");
    transaction.commit().await?;
    for job in requeued.iter().chain(&canceled) {
        queue.announce(job);
    }
    Ok(Orphans { requeued: requeued.len() as u64, canceled: canceled.len() as u64 })
}

/// Removes what an earlier process was writing on this machine; whatever it has finished is in the object store.
fn clear_scratch(queue: &Queue) -> Result<usize, StoreError> {
    let folders = &queue.store.folders;
    let mut removed = 0;
    for folder in ["tmp", "sessions", "results", "checkpoints"] {
        for name in folders.names(folder)? {
            folders.remove(folder, &name);
            removed += 1;
        }
    }
    Ok(removed)
}

/// Removes unfinished uploads, uploads without a row, checkpoints of ended jobs, and all results but the published ones.
async fn sweep(queue: &Queue) -> Result<usize, StoreError> {
    if queue.store.blobs.are_remote() {
        return clear_scratch(queue);
    }
    let folders = &queue.store.folders;
    let mut removed = 0;
    let mut remove = |folder: &str, name: &str| {
        folders.remove(folder, name);
        removed += 1;
    };
    for name in folders.names("tmp")? {
        remove("tmp", &name);
    }
    // A table is read only where there is a file that it could name.
    let uploads = folders.names("sessions")?;
    let known = if uploads.is_empty() { Vec::new() } else { sessions::ids(&queue.store).await? };
    for name in uploads {
        if known.binary_search(&name).is_err() {
            remove("sessions", &name);
        }
    }
    let checkpoints = folders.names("checkpoints")?;
    let open_jobs = if checkpoints.is_empty() { Vec::new() } else { open_jobs(queue).await? };
    for job in checkpoints {
        if open_jobs.binary_search(&job).is_err() {
            remove("checkpoints", &job);
        }
    }
    let results = folders.names("results")?;
    let published = if results.is_empty() { BTreeMap::new() } else { published_fences(queue).await? };
    for job in results {
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

/// Ids of the jobs without a final state, sorted.
async fn open_jobs(queue: &Queue) -> Result<Vec<String>, StoreError> {
    let ids = sqlx::query_scalar("SELECT id FROM jobs WHERE state IN ('queued', 'running', 'canceling') ORDER BY id");
    Ok(ids.fetch_all(queue.store.read()).await?)
}

async fn published_fences(queue: &Queue) -> Result<BTreeMap<String, i64>, StoreError> {
    let rows = sqlx::query_as::<_, (String, i64)>("SELECT id, result_fence FROM jobs WHERE state = 'succeeded'");
    Ok(rows.fetch_all(queue.store.read()).await?.into_iter().collect())
}
