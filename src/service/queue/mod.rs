//! The queue is the `jobs` table: what was accepted reaches exactly one final state, whatever dies.
//!
//! Execution is at least once, publication exactly once: a claim raises the job's `fence`, and every later write of that
//! claim says `AND fence = ?`; where no row answers, the worker throws its work away. No transaction outlasts one group
//! of statements, and none is open while a job runs.
//!
//! Why not a queue library: the promise wants a fence per attempt, deaths counted per job and an orphan known by its boot,
//! not by a clock; all of it is a few statements on a table that the service needs anyway.

mod acceptance;
pub mod figures;
pub mod job;
mod phase;
pub mod recovery;
mod rows;
mod work;

#[cfg(test)]
mod tests;

pub use acceptance::{EnqueueError, IdempotencyKey, NewJob, Room};
pub use work::{Claim, Finished, Published, Standing};

use super::failpoint::failpoint;
use super::store::{Store, StoreError, Tenant};
use job::{Job, Phase};
use rows::{job_from_row, phase_from_row};
use std::sync::Arc;
use tokio::sync::{Notify, broadcast};

/// The queue of one service process. Cloning shares it.
#[derive(Debug, Clone)]
pub struct Queue {
    pub(super) store: Store,
    /// Wakes a worker: something may be claimed.
    work: Arc<Notify>,
    /// Says whose row has changed.
    changes: broadcast::Sender<Arc<str>>,
    /// Passes on what a job's process has written to its log.
    log: broadcast::Sender<LogLine>,
}

/// One line of a job's own process.
#[derive(Debug, Clone)]
pub struct LogLine {
    /// The job.
    pub job: Arc<str>,
    /// What it wrote.
    pub line: Arc<str>,
}

/// Which jobs to list.
#[derive(Debug, Clone, Default)]
pub struct JobFilter {
    /// Only those in this state.
    pub state: Option<Phase>,
    /// Only those with this label.
    pub label: Option<LabelFilter>,
    /// Only those older than this `seq`.
    pub before: Option<i64>,
}

/// `key` or `key=value`.
#[derive(Debug, Clone)]
pub struct LabelFilter {
    /// The label's name.
    pub key: String,
    /// Its value, where it matters.
    pub value: Option<String>,
}

/// What came of asking a job to stop.
#[derive(Debug)]
pub enum Cancel {
    /// It stops, or has been stopped before.
    Accepted(Box<Job>),
    /// It had ended otherwise.
    AlreadyFinal(Phase),
    /// There is no such job.
    Missing,
}

impl Queue {
    /// The queue over a store.
    pub fn new(store: Store) -> Self {
        Self { store, work: Arc::default(), changes: broadcast::channel(1024).0, log: broadcast::channel(256).0 }
    }

    /// Hears of every change from now on.
    pub fn listen(&self) -> broadcast::Receiver<Arc<str>> {
        self.changes.subscribe()
    }

    /// Hears every line of every job's process from now on.
    pub fn listen_to_logs(&self) -> broadcast::Receiver<LogLine> {
        self.log.subscribe()
    }

    /// Passes a line on to whoever listens.
    pub fn tell_line(&self, job: &str, line: &str) {
        let _ = self.log.send(LogLine { job: job.into(), line: line.into() }); // nobody listening is fine
    }

    fn announce(&self, job: &str) {
        let _ = self.changes.send(job.into()); // nobody listening is fine
    }

    /// A tenant's job of an id.
    ///
    /// # Errors
    /// When the store fails.
    pub async fn get(&self, tenant: &Tenant, id: &str) -> Result<Option<Job>, StoreError> {
        let row = sqlx::query(
            "SELECT jobs.*, verdict, reasons FROM jobs LEFT JOIN verdicts ON verdicts.job_id = jobs.id
             WHERE jobs.id = ? AND tenant = ?",
        )
        .bind(id)
        .bind(tenant.name())
        .fetch_optional(self.store.read())
        .await?;
        row.as_ref().map(job_from_row).transpose()
    }

    /// A tenant's jobs newest first, at most `limit`.
    ///
    /// # Errors
    /// When the store fails.
    pub async fn list(&self, tenant: &Tenant, filter: &JobFilter, limit: i64) -> Result<Vec<Job>, StoreError> {
        let rows = sqlx::query(
            "SELECT jobs.*, verdict, reasons FROM jobs LEFT JOIN verdicts ON verdicts.job_id = jobs.id
             WHERE tenant = ?6 AND seq < ?1 AND (?2 IS NULL OR state = ?2)
               AND (?3 IS NULL OR EXISTS (SELECT 1 FROM json_each(jobs.labels) AS label
                                          WHERE label.key = ?3 AND (?4 IS NULL OR label.value = ?4)))
             ORDER BY seq DESC LIMIT ?5",
        )
        .bind(filter.before.unwrap_or(i64::MAX))
        .bind(filter.state.map(Phase::name))
        .bind(filter.label.as_ref().map(|label| label.key.as_str()))
        .bind(filter.label.as_ref().and_then(|label| label.value.as_deref()))
        .bind(limit)
        .bind(tenant.name())
        .fetch_all(self.store.read())
        .await?;
        rows.iter().map(job_from_row).collect()
    }

    /// Asks a job to stop: a waiting one is canceled at once, a running one by its worker.
    ///
    /// # Errors
    /// When the store fails.
    pub async fn cancel(&self, tenant: &Tenant, id: &str) -> Result<Cancel, StoreError> {
        match self.try_to_cancel(tenant, id).await {
            Err(error) if error.is_disk_full() => {
                self.store.give_reserve_up().await;
                self.try_to_cancel(tenant, id).await
            }
            done => done,
        }
    }

    async fn try_to_cancel(&self, tenant: &Tenant, id: &str) -> Result<Cancel, StoreError> {
        let mut transaction = self.store.write().await?;
        sqlx::query(
            "UPDATE jobs SET state = 'canceled', version = version + 1, eta_s = NULL,
                             finished_at = strftime('%Y-%m-%dT%H:%M:%fZ', 'now')
             WHERE id = ? AND tenant = ? AND state = 'queued'",
        )
        .bind(id)
        .bind(tenant.name())
        .execute(&mut *transaction)
        .await?;
        sqlx::query(
            "UPDATE jobs SET state = 'canceling', version = version + 1
             WHERE id = ? AND tenant = ? AND state = 'running'",
        )
        .bind(id)
        .bind(tenant.name())
        .execute(&mut *transaction)
        .await?;
        failpoint("cancel.marked");
        transaction.commit().await?;
        failpoint("cancel.committed");
        self.announce(id);
        let Some(job) = self.get(tenant, id).await? else { return Ok(Cancel::Missing) };
        if job.state.phase() == Phase::Canceled {
            self.store.remove_files("checkpoints", id).await; // of an attempt before a restart
        }
        Ok(match job.state.phase() {
            Phase::Canceling | Phase::Canceled => Cancel::Accepted(Box::new(job)),
            phase => Cancel::AlreadyFinal(phase),
        })
    }

    /// Removes a job in any state and its files; the worker of a running one sees it gone and kills the child. False where
    /// there was none.
    ///
    /// # Errors
    /// When the store fails.
    pub async fn delete(&self, tenant: &Tenant, id: &str) -> Result<bool, StoreError> {
        match self.try_to_delete(tenant, id).await {
            Err(error) if error.is_disk_full() => {
                self.store.give_reserve_up().await;
                self.try_to_delete(tenant, id).await
            }
            done => done,
        }
    }

    async fn try_to_delete(&self, tenant: &Tenant, id: &str) -> Result<bool, StoreError> {
        let mut transaction = self.store.write().await?;
        let deleted = sqlx::query("DELETE FROM jobs WHERE id = ? AND tenant = ?").bind(id).bind(tenant.name());
        let deleted = deleted.execute(&mut *transaction).await?;
        failpoint("delete.marked");
        transaction.commit().await?;
        if deleted.rows_affected() == 0 {
            return Ok(false);
        }
        failpoint("delete.committed");
        self.announce(id);
        self.store.remove_files("results", id).await;
        self.store.remove_files("checkpoints", id).await;
        failpoint("delete.removed");
        self.store.take_reserve().await;
        Ok(true)
    }
}
