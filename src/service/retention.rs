//! Automatic removal of old jobs with their results and of old sessions without jobs, both off by default, and of the
//! Idempotency-Keys of deleted jobs.

use super::shared::Shared;
use super::store::clock::{self, SuspectClock};
use super::store::{StoreError, Tenant, sessions};
use std::time::{Duration, Instant, SystemTime};

/// Interval between two removals.
const INTERVAL: Duration = Duration::from_secs(600);

/// Maximal difference between the wall clock and the monotonic clock since the start. With a larger difference the wall
/// clock was probably set by hand, and nothing is removed.
const MAX_DRIFT: Duration = Duration::from_secs(300);

/// Rows removed at a time, so that a long list does not block writers.
const BATCH: i64 = 100;

/// Days after its first use after which the key of a deleted job is forgotten; a later repetition of the request is a new
/// job. Clients repeat a request for minutes, rarely for days.
const KEY_DAYS: f64 = 30.0;

/// Removes old jobs, sessions and Idempotency-Keys until the service stops.
pub(super) async fn run(shared: Shared) {
    let start = (Instant::now(), SystemTime::now());
    let (mut last, mut is_reported) = (Instant::now(), false);
    while !shared.draining.is_cancelled() {
        if !shared.leadership.is_held() {
            last = Instant::now(); // another process removes what is old
        } else if is_clock_plausible(start) {
            let ran_s = last.elapsed().as_secs() as i64;
            last = Instant::now();
            let suspect = clock::observe(&shared.store, ran_s).await;
            if let Ok(Some(suspect)) = suspect
                && !std::mem::replace(&mut is_reported, true)
            {
                report(suspect);
            }
            let removed = match suspect {
                Ok(None) => remove_old(&shared).await,
                Ok(Some(_)) => Ok(()),
                Err(error) => Err(error),
            };
            if let Err(error) = removed {
                tracing::error!(%error, "old jobs or sessions could not be removed; trying again later");
            }
        } else {
            tracing::warn!(
                "the system clock was changed while the service was running; nothing is removed until the next start"
            );
        }
        tokio::select! {
            () = tokio::time::sleep(INTERVAL) => {}
            () = shared.draining.cancelled() => {}
        }
    }
}

fn report(SuspectClock { days_ahead, hours_left }: SuspectClock) {
    tracing::error!(
        days_ahead,
        hours_left,
        "the system clock is far ahead of the last time that the service has seen; correct it if it is wrong: nothing is \
         removed by age until the service has run for these hours"
    );
}

/// Whether the wall clock and the monotonic clock agree about the time since `start`.
fn is_clock_plausible((monotonic, wall): (Instant, SystemTime)) -> bool {
    let elapsed = monotonic.elapsed();
    wall.elapsed().is_ok_and(|by_wall| by_wall.abs_diff(elapsed) < MAX_DRIFT)
}

async fn remove_old(shared: &Shared) -> Result<(), StoreError> {
    let retention = &shared.settings.retention;
    let keys = shared.queue.forget_keys(KEY_DAYS).await?;
    tracing::debug!(keys, "old Idempotency-Keys of deleted jobs removed");
    if let Some(days) = retention.jobs_days {
        while remove_jobs(shared, days).await? == BATCH as usize {}
    }
    if let Some(days) = retention.sessions_days {
        while remove_sessions(shared, days).await? == BATCH as usize {}
    }
    Ok(())
}

async fn remove_jobs(shared: &Shared, days: f64) -> Result<usize, StoreError> {
    const OLD: &str = "SELECT id, tenant FROM jobs WHERE finished_at < strftime('%Y-%m-%dT%H:%M:%fZ', 'now', $1) ORDER BY finished_at LIMIT $2";
    let old = next_batch(shared, OLD, days).await?;
    for (id, tenant) in &old {
        shared.queue.delete(tenant, id).await?;
        tracing::info!(job.id = id, "old job removed");
    }
    Ok(old.len())
}

async fn remove_sessions(shared: &Shared, days: f64) -> Result<usize, StoreError> {
    const OLD: &str = "SELECT id, tenant FROM sessions
         WHERE created_at < strftime('%Y-%m-%dT%H:%M:%fZ', 'now', $1)
           AND NOT EXISTS (SELECT 1 FROM jobs WHERE jobs.session_id = sessions.id)
         ORDER BY seq LIMIT $2";
    let old = next_batch(shared, OLD, days).await?;
    for (id, tenant) in &old {
        match sessions::remove(&shared.store, tenant, id).await {
            Ok(()) => tracing::info!(session.id = id, "old session removed"),
            Err(sessions::RemoveError::Store(error)) => return Err(error),
            Err(_) => {} // removed meanwhile, or a job was just submitted on it
        }
    }
    Ok(old.len())
}

/// Returns ids and tenants of the next rows of `query` that are older than `days`.
async fn next_batch(shared: &Shared, query: &'static str, days: f64) -> Result<Vec<(String, Tenant)>, StoreError> {
    let rows = sqlx::query_as(query).bind(format!("-{days} days")).bind(BATCH);
    Ok(rows.fetch_all(shared.store.read()).await?)
}
