//! The leader: of the processes that share a database one puts back the jobs of silent workers, calls webhooks, removes old data and sweeps
//! the object store. With SQLite the only process is the leader.
//!
//! It holds a lock of the PostgreSQL server on a connection of its own. The server releases the lock with the connection, so there are
//! never two leaders for longer than the time in which a lost connection is noticed; what a leader does is safe even then: jobs are
//! put back by compare-and-set, and a webhook that is called twice has the same id.

use crate::service::failpoint::{fault, sweep_interval};
use crate::service::queue::lease::SeenBeats;
use crate::service::shared::Shared;
use crate::service::store::StoreError;
use crate::service::store::blobs::strays;
use sqlx::postgres::PgConnection;
use std::time::{Duration, Instant};
use tokio::task::JoinHandle;

/// Number of the lock.
const LOCK: i64 = 0x7761_6e64; // "wand" in ASCII

/// Time between two tries to become the leader.
const CANDIDACY: Duration = Duration::from_secs(3);

/// Time between two sweeps of the object store.
const SWEEP_INTERVAL: Duration = Duration::from_secs(3600);

/// A leader whose connection does not answer for this time is none.
const ANSWER_LIMIT: Duration = Duration::from_secs(10);

/// Leads while the lock is held, and tries to become the leader otherwise, until the service stops.
pub(super) async fn run(shared: Shared) {
    tokio::select! {
        () = shared.draining.cancelled() => {}
        () = async {
            loop {
                if let Err(error) = lead(&shared).await {
                    tracing::warn!(%error, "not the leader; trying again");
                }
                shared.leadership.set(false);
                tokio::time::sleep(CANDIDACY).await;
            }
        } => {}
    }
    shared.leadership.set(false);
}

async fn lead(shared: &Shared) -> Result<(), StoreError> {
    let Some(mut connection) = shared.store.own_connection().await? else { return Ok(()) };
    while !is_locked(&mut connection).await? {
        tokio::time::sleep(CANDIDACY).await;
    }
    tracing::info!("this process is the leader");
    shared.leadership.set(true);
    let (mut seen, mut last_sweep) = (SeenBeats::default(), Instant::now());
    let mut sweeping: Option<JoinHandle<()>> = None; // a large bucket takes longer than the interval
    let settings = &shared.settings.worker;
    loop {
        let max_losses = i64::from(shared.settings.jobs.max_losses);
        let look = shared.queue.put_back_silent(&mut connection, &mut seen, settings.lease, max_losses);
        match tokio::time::timeout(ANSWER_LIMIT, look).await {
            Ok(looked) => looked?,
            Err(_) => return Ok(()), // the connection ends here, and the lock with it
        }
        shared.metrics.note_beats(seen.longest_silence());
        let is_due = last_sweep.elapsed() >= sweep_interval(SWEEP_INTERVAL) || fault("sweep.eager");
        if is_due && sweeping.as_ref().is_none_or(JoinHandle::is_finished) {
            last_sweep = Instant::now();
            sweeping = Some(sweep(shared.clone()));
        }
        tokio::time::sleep(settings.beat).await;
    }
}

async fn is_locked(connection: &mut PgConnection) -> Result<bool, StoreError> {
    Ok(sqlx::query_scalar("SELECT pg_try_advisory_lock($1)").bind(LOCK).fetch_one(connection).await?)
}

/// Sweeps the object store beside the leader's work.
fn sweep(shared: Shared) -> JoinHandle<()> {
    tokio::spawn(async move {
        match strays::sweep(&shared.store).await {
            Ok(0) => {}
            Ok(removed) => tracing::info!(removed, "objects without a row were removed"),
            Err(error) => tracing::warn!(%error, "the object store cannot be swept; trying again in an hour"),
        }
    })
}
