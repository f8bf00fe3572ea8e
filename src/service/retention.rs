//! What is removed by itself: old jobs with their results, and sessions that no job names. Nothing unless asked for.

use super::Shared;
use super::settings::Retention;
use super::store::{StoreError, Tenant, sessions};
use sqlx::Row;
use std::time::{Duration, Instant, SystemTime};

/// Between two rounds.
const ROUND: Duration = Duration::from_secs(600);

/// A clock that has run so much faster or slower than the machine since the last round was set by hand; nothing is removed
/// by such a clock.
const TRUSTED_DRIFT: Duration = Duration::from_secs(300);

/// Rows removed in one statement's turn: a long list must not hold up those that write.
const BATCH: i64 = 100;

/// Removes what is old, until the service stops.
pub(super) async fn run(shared: Shared) {
    let retention = shared.settings.retention.clone();
    if retention.jobs_days.is_none() && retention.sessions_days.is_none() {
        return;
    }
    let start = (Instant::now(), SystemTime::now());
    while !shared.draining.is_cancelled() {
        if is_trusted(start) {
            if let Err(error) = remove_old(&shared, &retention).await {
                tracing::error!(%error, "what is old could not be removed; trying again later");
            }
        } else {
            tracing::warn!("the clock was set while the service ran: nothing is removed until the next start");
        }
        tokio::select! {
            () = tokio::time::sleep(ROUND) => {}
            () = shared.draining.cancelled() => {}
        }
    }
}

/// Whether the wall clock has run along with the machine's own.
fn is_trusted((machine, wall): (Instant, SystemTime)) -> bool {
    let passed = machine.elapsed();
    wall.elapsed().is_ok_and(|told| told.abs_diff(passed) < TRUSTED_DRIFT)
}

async fn remove_old(shared: &Shared, retention: &Retention) -> Result<(), StoreError> {
    if let Some(days) = retention.jobs_days {
        while remove_jobs(shared, days).await? == BATCH as usize {}
    }
    if let Some(days) = retention.sessions_days {
        while remove_sessions(shared, days).await? == BATCH as usize {}
    }
    Ok(())
}

async fn remove_jobs(shared: &Shared, days: f64) -> Result<usize, StoreError> {
    const OLD: &str =
        "SELECT id, tenant FROM jobs WHERE finished_at < strftime('%Y-%m-%dT%H:%M:%fZ', 'now', ?) ORDER BY seq LIMIT ?";
    let old = of_batch(shared, OLD, days).await?;
    for (id, tenant) in &old {
        shared.queue.delete(tenant, id).await?;
        tracing::info!(job.id = id, "the job was old and is removed");
    }
    Ok(old.len())
}

async fn remove_sessions(shared: &Shared, days: f64) -> Result<usize, StoreError> {
    const OLD: &str = "SELECT id, tenant FROM sessions
         WHERE created_at < strftime('%Y-%m-%dT%H:%M:%fZ', 'now', ?)
           AND NOT EXISTS (SELECT 1 FROM jobs WHERE jobs.session_id = sessions.id)
         ORDER BY seq LIMIT ?";
    let old = of_batch(shared, OLD, days).await?;
    for (id, tenant) in &old {
        match sessions::remove(&shared.store, tenant, id).await {
            Ok(()) => tracing::info!(session.id = id, "the session was old and is removed"),
            Err(sessions::RemoveError::Store(error)) => return Err(error),
            Err(_) => {} // somebody was quicker, or has just submitted a job on it
        }
    }
    Ok(old.len())
}

/// Ids and owners of the first that `query` calls older than some days.
async fn of_batch(shared: &Shared, query: &'static str, days: f64) -> Result<Vec<(String, Tenant)>, StoreError> {
    let rows = sqlx::query(query).bind(format!("-{days} days")).bind(BATCH).fetch_all(shared.store.read()).await?;
    rows.iter().map(|row| Ok((row.try_get("id")?, Tenant::stored(row.try_get("tenant")?)))).collect()
}
