//! Worker operations on the queue: claim and heartbeat. Each write checks the claim's fence.

use super::handle::Queue;
use super::job::{JobProgress, Submitter};
use super::phase::Phase;
use super::recovery::{Orphans, release_orphans};
use super::rows::phase_from_row;
use crate::service::failpoint::{failpoint, fault};
use crate::service::store::database::WriteTransaction;
use crate::service::store::error::StoreError;
use crate::service::store::sql::{SqlRow, float};
use sqlx::Row;
use std::collections::BTreeMap;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Interval in which an idle worker looks for claimable jobs.
const RECHECK_INTERVAL: Duration = Duration::from_secs(2);

/// One job claimed by one worker.
#[derive(Debug, Clone)]
pub struct Claim {
    /// Job id.
    pub job: String,
    /// Number of the claim; each claim of a job increments it.
    pub fence: i64,
    /// Owner of the job.
    pub tenant: String,
    /// The request that submitted the job.
    pub submitter: Submitter,
    /// Session id.
    pub session: String,
    /// SHA-256 of the upload, hex.
    pub session_sha256: String,
    /// All options with their values, defaults included.
    pub options: serde_json::Value,
    /// Wall time of each stage in the claims before this one, s: a job that continues does not run the early stages again.
    pub stage_seconds: BTreeMap<String, f64>,
}

impl Claim {
    pub(super) fn from_row(row: &SqlRow) -> Result<Self, StoreError> {
        Ok(Self {
            job: row.try_get("id")?,
            fence: row.try_get("fence")?,
            tenant: row.try_get("tenant")?,
            submitter: Submitter { request: row.try_get("request_id")?, key: row.try_get("key_id")? },
            session: row.try_get("session_id")?,
            session_sha256: row.try_get("sha256")?,
            options: serde_json::from_str(row.try_get("options")?)?,
            stage_seconds: serde_json::from_str(row.try_get("stage_seconds")?)?,
        })
    }
}

/// Whether a claim is still valid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ClaimStatus {
    /// The worker should continue.
    Active,
    /// A cancel was requested.
    Canceling,
    /// The job was deleted or claimed by another worker; writes of this claim have no effect.
    Lost,
}

impl Queue {
    /// Waits until a job may be claimable: after a wake-up, or after some seconds, because free disk space and the end of a
    /// job's wait wake no worker.
    pub async fn work(&self) {
        let _ = tokio::time::timeout(RECHECK_INTERVAL, self.work.notified()).await; // both mean: look again
    }

    /// Wakes one more worker; called by a worker that stops and may have consumed a wake-up.
    pub fn wake_next(&self) {
        self.work.notify_one();
    }

    /// Claims the first queued job of the tenant whose turn it is, by priority, then age. Tenants with `max_running`
    /// running jobs are skipped, and so are jobs that wait after a fault of the machine. While the disk has less than its
    /// minimum of free bytes, no job is claimed: it could not write its result.
    ///
    /// # Errors
    /// When the store fails.
    pub async fn claim(&self, max_running: i64) -> Result<Option<Claim>, StoreError> {
        if fault("claim.clocked") && self.has_jobs_dated_in_the_future().await? {
            return Ok(None);
        }
        self.release_strays().await?;
        if !self.has_queued_jobs().await? || !self.has_space()? {
            return Ok(None);
        }
        let Some(waiting) = self.deferrals().waiting(Instant::now()).map(|ids| serde_json::to_string(&ids)) else {
            return Ok(None);
        };
        let waiting = waiting?;
        #[cfg(feature = "scale")]
        if self.store.is_shared() {
            return self.claim_shared(max_running, &waiting).await;
        }
        self.claim_alone(max_running, &waiting).await
    }

    /// The claim in SQLite, whose write transaction is the only one.
    async fn claim_alone(&self, max_running: i64, waiting: &str) -> Result<Option<Claim>, StoreError> {
        let mut transaction = self.store.write().await?;
        let Some(tenant) = next_tenant(&mut transaction, max_running, waiting).await? else { return Ok(None) };
        let row = sqlx::query(
            "UPDATE jobs SET state = 'running', version = version + 1, fence = fence + 1, attempt = crashes + 1, boot = $1,
                             started_at = coalesce(started_at, strftime('%Y-%m-%dT%H:%M:%fZ', 'now')),
                             solver_version = $2
             WHERE seq = (SELECT seq FROM jobs WHERE state = 'queued' AND tenant = $3
                            AND id NOT IN (SELECT value FROM json_each($4))
                          ORDER BY priority DESC, seq LIMIT 1)
             RETURNING id, fence, tenant, request_id, key_id, session_id, options, stage_seconds,
                       (SELECT sha256 FROM sessions WHERE sessions.id = jobs.session_id) AS sha256",
        )
        .bind(&self.store.boot)
        .bind(env!("CARGO_PKG_VERSION"))
        .bind(&tenant)
        .bind(waiting)
        .fetch_optional(&mut *transaction)
        .await?;
        let Some(row) = row else { return Ok(None) };
        let claim = Claim::from_row(&row)?;
        failpoint("claim.updated");
        self.active.add(&claim.job, claim.fence);
        if let Err(error) = self.store.commit(transaction).await {
            self.active.lose(&claim.job, claim.fence);
            return Err(error.into());
        }
        failpoint("claim.committed");
        self.announce(&claim.job);
        Ok(Some(claim))
    }

    /// Returns jobs to the queue whose claim was committed although this process saw an error.
    async fn release_strays(&self) -> Result<(), StoreError> {
        if !self.active.take_strays() {
            return Ok(());
        }
        match release_orphans(self).await {
            Ok(Orphans { requeued, canceled }) if requeued + canceled > 0 => {
                tracing::warn!(requeued, canceled, "jobs whose claim was committed without an answer were put back");
                Ok(())
            }
            Ok(_) => Ok(()),
            Err(error) => {
                self.active.note_strays();
                Err(error)
            }
        }
    }

    async fn has_queued_jobs(&self) -> Result<bool, StoreError> {
        let any = "SELECT CASE WHEN EXISTS (SELECT 1 FROM jobs WHERE state = 'queued') THEN 1 ELSE 0 END";
        Ok(sqlx::query_scalar::<_, i64>(any).fetch_one(self.store.read()).await? == 1)
    }

    /// Whether the disk has its minimum of free bytes; a change is logged once.
    fn has_space(&self) -> Result<bool, StoreError> {
        match self.store.require_space() {
            Ok(()) => {
                if self.lacks_space.swap(false, Ordering::Relaxed) {
                    tracing::info!("the disk has free space again; jobs are claimed");
                }
                Ok(true)
            }
            Err(error @ StoreError::DiskFull { .. }) => {
                if !self.lacks_space.swap(true, Ordering::Relaxed) {
                    tracing::error!(%error, "no job is claimed until disk space is freed");
                }
                Ok(false)
            }
            Err(error) => Err(error),
        }
    }

    /// Compares times with the clock, which no claim may do; used by the fault `claim.clocked` only.
    async fn has_jobs_dated_in_the_future(&self) -> Result<bool, StoreError> {
        let future =
            "SELECT count(*) FROM jobs WHERE state = 'queued' AND created_at > strftime('%Y-%m-%dT%H:%M:%fZ', 'now')";
        Ok(sqlx::query_scalar::<_, i64>(future).fetch_one(self.store.read()).await? > 0)
    }

    /// Reads whether the claim is still valid.
    ///
    /// # Errors
    /// When the store fails.
    pub async fn claim_status(&self, claim: &Claim) -> Result<ClaimStatus, StoreError> {
        if fault("fence.none") {
            return Ok(ClaimStatus::Active);
        }
        let row = sqlx::query("SELECT state FROM jobs WHERE id = $1 AND fence = $2").bind(&claim.job).bind(claim.fence);
        let row = row.fetch_optional(self.store.read()).await?;
        Ok(match row.as_ref().map(phase_from_row).transpose()? {
            Some(Phase::Running) => ClaimStatus::Active,
            Some(Phase::Canceling) => ClaimStatus::Canceling,
            _ => ClaimStatus::Lost,
        })
    }

    /// Writes the progress of the job; the stored fraction never decreases, even in a second attempt. `stage_seconds`: of this claim.
    ///
    /// # Errors
    /// When the store fails.
    pub async fn heartbeat(
        &self,
        claim: &Claim,
        progress: &JobProgress,
        stage_seconds: &BTreeMap<String, f64>,
    ) -> Result<(), StoreError> {
        let mut all_seconds = claim.stage_seconds.clone();
        for (stage, seconds) in stage_seconds {
            *all_seconds.entry(stage.clone()).or_default() += seconds;
        }
        let mut transaction = self.store.write_relaxed().await?;
        sqlx::query(
            "UPDATE jobs SET version = version + 1, stage = $1, stage_index = $2, stage_count = $3,
                             fraction = CASE WHEN fraction < $4 THEN $4 ELSE fraction END, message = $5, eta_s = $6, stage_seconds = $7
             WHERE id = $8 AND fence = $9 AND state IN ('running', 'canceling')",
        )
        .bind(&progress.stage)
        .bind(progress.stage_index)
        .bind(progress.stage_count)
        .bind(progress.fraction)
        .bind(&progress.message)
        .bind(float(progress.eta_s))
        .bind(serde_json::to_string(&all_seconds)?)
        .bind(&claim.job)
        .bind(claim.fence)
        .execute(&mut *transaction)
        .await?;
        transaction.commit().await?;
        failpoint("progress.noted");
        self.announce(&claim.job);
        Ok(())
    }
}

/// Returns the tenant with queued jobs that was served the longest ago, and moves it to the end of the order.
async fn next_tenant(
    transaction: &mut WriteTransaction,
    max_running: i64,
    waiting: &str,
) -> Result<Option<String>, StoreError> {
    let name = sqlx::query_scalar(
        "UPDATE tenants SET turn = 1 + (SELECT max(turn) FROM tenants)
         WHERE name = (SELECT name FROM tenants
                       WHERE n_queued > 0 AND n_running + n_canceling < $1
                         AND EXISTS (SELECT 1 FROM jobs WHERE state = 'queued' AND tenant = name
                                       AND id NOT IN (SELECT value FROM json_each($2)))
                       ORDER BY turn, name LIMIT 1)
         RETURNING name",
    );
    Ok(name.bind(max_running).bind(waiting).fetch_optional(&mut **transaction).await?)
}
