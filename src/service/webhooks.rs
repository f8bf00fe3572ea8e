//! Webhooks: calls that notify a client that its job has ended (Standard Webhooks 1.0).
//!
//! Delivery is at least once: receivers recognise repetitions by `webhook-id`. A database trigger inserts the delivery in
//! the transaction that ends the job; this task makes the calls, waits longer after each failure, and stores the outcome.
//! Tenants take turns (`turns.rs`).

mod call;
mod delivery;
mod target;
mod turns;

pub use call::signature;
pub use delivery::Delivery;
pub use target::{NetworkError, Networks, TargetError, check_url};

use super::failpoint::failpoint;
use super::queue::job::Job;
use super::settings::WebhookSettings;
use super::shared::Shared;
use super::store::{Store, StoreError, Tenant, tenants};
use call::{Call, CallOutcome};
use sqlx::AssertSqlSafe;
use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::task::{Id, JoinSet};
use tokio::time::MissedTickBehavior;
use turns::{Turns, Waiting};

/// The columns of a delivery, named as those of jobs and sessions.
const COLUMNS: &str = "id, job_id, tenant, event, url, state, tries, last_status, last_error, created_at, updated_at";

/// Shortest interval between two checks for due deliveries.
const CHECK_INTERVAL: Duration = Duration::from_secs(1);

/// Number of due deliveries that are read at once: enough for the turns of a hundred tenants.
const MAX_WAITING: i64 = 512;

/// Makes the calls until the service stops.
pub(super) async fn run(shared: Shared, networks: Arc<Networks>) {
    let mut calls: JoinSet<()> = JoinSet::new();
    let mut ids: HashMap<Id, String> = HashMap::new();
    let (mut turns, mut waiting) = (Turns::default(), Vec::new());
    let mut checks = tokio::time::interval(CHECK_INTERVAL);
    checks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            _ = checks.tick() => {
                if !shared.leadership.is_held() {
                    waiting.clear();
                    continue;
                }
                let start = Instant::now();
                match due(&shared).await {
                    Ok(due) => {
                        waiting = due.into_iter().filter(|due| !turns.is_running(&due.id)).map(Waiting::new).collect();
                    }
                    Err(error) => tracing::error!(%error, "cannot read the due webhooks; trying again"),
                }
                // A hundred thousand due deliveries take a second to read: at most a tenth of the time is spent on it.
                checks.reset_after(CHECK_INTERVAL.max(10 * start.elapsed()));
            }
            () = shared.draining.cancelled() => return, // the next start repeats interrupted calls
            Some(ended) = calls.join_next_with_id() => {
                let call = ended.map_or_else(|error| error.id(), |(call, ())| call);
                if let Some(id) = ids.remove(&call) {
                    turns.end(&id);
                }
            }
        }
        while let Some(delivery) = turns.next(&mut waiting) {
            let id = delivery.id.clone();
            let call = calls.spawn(deliver(shared.clone(), networks.clone(), delivery));
            ids.insert(call.id(), id);
        }
    }
}

/// Returns the due deliveries: of each tenant first tries before repetitions and one URL after the other, and the first
/// ones of all tenants before the second ones, so that no tenant and no URL fills the list.
async fn due(shared: &Shared) -> Result<Vec<Delivery>, StoreError> {
    let longest = 2 * wait_after(shared.settings.webhooks.max_tries, &shared.settings.webhooks).as_secs();
    let rows = sqlx::query_as(AssertSqlSafe(format!(
        "WITH due AS (
             SELECT *, row_number() OVER (PARTITION BY tenant, url ORDER BY tries > 0, seq) AS place_of_url
             FROM webhook_deliveries
             WHERE state = 'waiting' AND (next_try_at <= unixepoch() OR next_try_at > unixepoch() + $1)),
         placed AS (
             SELECT *, row_number() OVER (PARTITION BY tenant ORDER BY tries > 0, place_of_url, seq) AS place FROM due)
         SELECT {COLUMNS} FROM placed ORDER BY place, seq LIMIT $2"
    )))
    .bind(longest as i64)
    .bind(MAX_WAITING)
    .fetch_all(shared.store.read());
    Ok(rows.await?)
}

/// Makes one try.
async fn deliver(shared: Shared, networks: Arc<Networks>, delivery: Delivery) {
    failpoint("webhook.due");
    let outcome = match prepare_call(&shared, &delivery).await {
        Ok(Some(call)) => {
            let timeout = shared.settings.webhooks.timeout;
            let called = tokio::task::spawn_blocking(move || call.make(&networks, timeout)).await;
            called.unwrap_or_else(|error| CallOutcome::failed(None, error.to_string()))
        }
        Ok(None) => return, // the job was deleted, and the delivery with it
        Err(error) => CallOutcome::failed(None, error.to_string()),
    };
    let counter =
        if outcome.is_delivered() { &shared.metrics.webhooks_delivered } else { &shared.metrics.webhooks_failed };
    counter.inc();
    tracing::info!(
        job.id = delivery.job,
        tenant = delivery.tenant.name(),
        delivery.id = delivery.id,
        status = outcome.status,
        error = outcome.error,
        "webhook called"
    );
    failpoint("webhook.called");
    if let Err(error) = record(&shared, &delivery, &outcome).await {
        tracing::error!(delivery.id = delivery.id, %error, "cannot store the outcome of a webhook call; the call will be repeated");
    }
    failpoint("webhook.noted");
}

async fn prepare_call(shared: &Shared, delivery: &Delivery) -> Result<Option<Call>, StoreError> {
    let tenant = &delivery.tenant;
    let Some(job) = shared.queue.get(tenant, &delivery.job).await? else { return Ok(None) };
    let secrets = tenants::signing_secrets(&shared.store, tenant).await?;
    let body = serde_json::to_vec(&payload(delivery, &job))?;
    Ok(Some(Call { id: delivery.id.clone(), url: delivery.url.clone(), secrets, body }))
}

/// Body of the event: the job and its outcome, without results; receivers fetch those with their API key.
fn payload(delivery: &Delivery, job: &Job) -> serde_json::Value {
    serde_json::json!({
        "type": delivery.event,
        "timestamp": delivery.created_at,
        "data": {
            "id": job.id,
            "state": job.state.phase().name(),
            "session": job.session,
            "labels": job.labels,
            "finished_at": job.state.finished_at(),
            "quality": job.state.quality(),
            "error": job.state.error(),
            "links": { "self": format!("/v1/jobs/{}", job.id), "result": format!("/v1/jobs/{}/result", job.id) },
        },
    })
}

async fn record(shared: &Shared, delivery: &Delivery, outcome: &CallOutcome) -> Result<(), StoreError> {
    let settings = &shared.settings.webhooks;
    let tries = delivery.tries + 1;
    let state = match outcome.is_delivered() {
        true => "delivered",
        false if tries >= settings.max_tries => "failed",
        false => "waiting",
    };
    let mut transaction = shared.store.write_relaxed().await?;
    sqlx::query(
        "UPDATE webhook_deliveries
         SET state = $1, tries = $2, next_try_at = unixepoch() + $3, last_status = $4, last_error = $5,
             updated_at = strftime('%Y-%m-%dT%H:%M:%fZ', 'now')
         WHERE id = $6",
    )
    .bind(state)
    .bind(tries)
    .bind(wait_after(tries, settings).as_secs() as i64)
    .bind(outcome.status.map(i64::from))
    .bind(&outcome.error)
    .bind(&delivery.id)
    .execute(&mut *transaction)
    .await?;
    Ok(transaction.commit().await?)
}

/// Wait after `tries` calls: the first wait plus (tries - 1)^4 seconds.
fn wait_after(tries: i64, settings: &WebhookSettings) -> Duration {
    let n = u64::try_from(tries - 1).unwrap_or(0).min(100);
    settings.first_wait + Duration::from_secs(n.pow(4))
}

/// Lists a job's deliveries, oldest first.
///
/// # Errors
/// When the store fails.
pub async fn deliveries_of(store: &Store, tenant: &Tenant, job: &str) -> Result<Vec<Delivery>, StoreError> {
    let rows = format!("SELECT {COLUMNS} FROM webhook_deliveries WHERE job_id = $1 AND tenant = $2 ORDER BY seq");
    let rows = sqlx::query_as(AssertSqlSafe(rows));
    Ok(rows.bind(job).bind(tenant.name()).fetch_all(store.read()).await?)
}

/// Makes a delivery due again, whatever its state; `None` if it does not exist.
///
/// # Errors
/// When the store fails.
pub async fn redeliver(store: &Store, tenant: &Tenant, job: &str, id: &str) -> Result<Option<Delivery>, StoreError> {
    let mut transaction = store.write().await?;
    let delivery = sqlx::query_as(AssertSqlSafe(format!(
        "UPDATE webhook_deliveries
         SET state = 'waiting', tries = 0, next_try_at = 0, updated_at = strftime('%Y-%m-%dT%H:%M:%fZ', 'now')
         WHERE id = $1 AND job_id = $2 AND tenant = $3 RETURNING {COLUMNS}"
    )))
    .bind(id)
    .bind(job)
    .bind(tenant.name())
    .fetch_optional(&mut *transaction)
    .await?;
    transaction.commit().await?;
    Ok(delivery)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_grow_and_end_within_two_hours() {
        let settings = WebhookSettings::default();
        let waits: Vec<u64> = (1..settings.max_tries).map(|tries| wait_after(tries, &settings).as_secs()).collect();
        assert_eq!(waits[..3], [15, 16, 31]);
        assert!(waits.is_sorted() && waits.iter().sum::<u64>() < 7200, "{waits:?}");
    }
}
