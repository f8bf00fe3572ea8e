//! The worker's side of the queue: claim, heartbeat, finish; each write fenced.

use super::job::{Ending, JobError, JobProgress, Phase, next_phase};
use super::{Queue, phase_from_row};
use crate::service::failpoint::{failpoint, fault};
use crate::service::store::StoreError;
use crate::service::store::artifacts::{self, Artifact};
use crate::service::store::summary::Summary;
use sqlx::{Row, Sqlite, Transaction};
use std::collections::BTreeMap;

/// One job taken by one worker.
#[derive(Debug, Clone)]
pub struct Claim {
    /// The job.
    pub job: String,
    /// Which claim of it.
    pub fence: i64,
    /// The session.
    pub session: String,
    /// Digest of the upload.
    pub session_sha256: String,
    /// Every option with its value.
    pub options: serde_json::Value,
}

/// Whether the work of a claim is still wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// Go on.
    Wanted,
    /// Somebody asked to stop.
    Canceling,
    /// Deleted, or claimed by another worker: whatever this one does, nobody will see it.
    Lost,
}

/// A result that lies in its final folder and awaits its rows.
#[derive(Debug)]
pub struct Published {
    /// Its files.
    pub artifacts: Vec<Artifact>,
    /// Its figures.
    pub summary: Summary,
}

/// What became of the job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Finished {
    /// The job is in this state now.
    Recorded(Phase),
    /// The claim was no longer valid; nothing was written.
    Lost,
}

impl Queue {
    /// Returns when something may have become claimable.
    pub async fn work(&self) {
        self.work.notified().await;
    }

    /// Wakes one more worker: for a worker that leaves with a wake-up it did not use.
    pub fn wake_next(&self) {
        self.work.notify_one();
    }

    /// Takes the first waiting job of the tenant whose turn it is, by priority, then age. A tenant with `max_running` jobs
    /// at work is passed over.
    ///
    /// # Errors
    /// When the store fails.
    pub async fn claim(&self, max_running: i64) -> Result<Option<Claim>, StoreError> {
        if fault("claim.clocked") && self.holds_jobs_of_the_future().await? {
            return Ok(None);
        }
        let mut transaction = self.store.write().await?;
        let Some(tenant) = tenant_in_turn(&mut transaction, max_running).await? else { return Ok(None) };
        let row = sqlx::query(
            "UPDATE jobs SET state = 'running', version = version + 1, fence = fence + 1, attempt = deaths + 1, boot = ?1,
                             started_at = coalesce(started_at, strftime('%Y-%m-%dT%H:%M:%fZ', 'now')),
                             solver_version = ?2, stage_seconds = '{}'
             WHERE seq = (SELECT seq FROM jobs WHERE state = 'queued' AND tenant = ?3
                          ORDER BY priority DESC, seq LIMIT 1)
             RETURNING id, fence, session_id, options,
                       (SELECT sha256 FROM sessions WHERE sessions.id = jobs.session_id) AS sha256",
        )
        .bind(&self.store.boot)
        .bind(env!("CARGO_PKG_VERSION"))
        .bind(&tenant)
        .fetch_optional(&mut *transaction)
        .await?;
        let Some(row) = row else { return Ok(None) };
        let claim = Claim {
            job: row.try_get("id")?,
            fence: row.try_get("fence")?,
            session: row.try_get("session_id")?,
            session_sha256: row.try_get("sha256")?,
            options: serde_json::from_str(row.try_get("options")?)?,
        };
        failpoint("claim.updated");
        transaction.commit().await?;
        failpoint("claim.committed");
        self.announce(&claim.job);
        Ok(Some(claim))
    }

    /// What no claim may ask; see the fault.
    async fn holds_jobs_of_the_future(&self) -> Result<bool, StoreError> {
        let future =
            "SELECT count(*) FROM jobs WHERE state = 'queued' AND created_at > strftime('%Y-%m-%dT%H:%M:%fZ', 'now')";
        Ok(sqlx::query_scalar::<_, i64>(future).fetch_one(self.store.read()).await? > 0)
    }

    /// Whether the claim's work is still wanted.
    ///
    /// # Errors
    /// When the store fails.
    pub async fn standing(&self, claim: &Claim) -> Result<Standing, StoreError> {
        let row = sqlx::query("SELECT state FROM jobs WHERE id = ? AND fence = ?").bind(&claim.job).bind(claim.fence);
        let row = row.fetch_optional(self.store.read()).await?;
        Ok(match row.as_ref().map(phase_from_row).transpose()? {
            Some(Phase::Running) => Standing::Wanted,
            Some(Phase::Canceling) => Standing::Canceling,
            _ => Standing::Lost,
        })
    }

    /// Writes how far the job is; the shown fraction never falls, whatever a second attempt reports.
    ///
    /// # Errors
    /// When the store fails.
    pub async fn heartbeat(
        &self,
        claim: &Claim,
        progress: &JobProgress,
        stage_seconds: &BTreeMap<String, f64>,
    ) -> Result<(), StoreError> {
        let mut transaction = self.store.note().await?;
        sqlx::query(
            "UPDATE jobs SET version = version + 1, stage = ?, stage_index = ?, stage_count = ?,
                             fraction = max(fraction, ?), message = ?, eta_s = ?, stage_seconds = ?
             WHERE id = ? AND fence = ? AND state IN ('running', 'canceling')",
        )
        .bind(&progress.stage)
        .bind(progress.stage_index)
        .bind(progress.stage_count)
        .bind(progress.fraction)
        .bind(&progress.message)
        .bind(progress.eta_s)
        .bind(serde_json::to_string(stage_seconds)?)
        .bind(&claim.job)
        .bind(claim.fence)
        .execute(&mut *transaction)
        .await?;
        transaction.commit().await?;
        failpoint("progress.noted");
        self.announce(&claim.job);
        Ok(())
    }

    /// Records how a claim ended, all rows in one transaction.
    ///
    /// # Errors
    /// When the store fails; nothing is recorded then, and the call may be repeated.
    pub async fn finish(
        &self,
        claim: &Claim,
        ending: &Ending<Published>,
        max_deaths: u32,
    ) -> Result<Finished, StoreError> {
        let mut transaction = self.store.write().await?;
        let row = sqlx::query(
            "SELECT state, deaths FROM jobs WHERE id = ? AND fence = ? AND state IN ('running', 'canceling')",
        )
        .bind(&claim.job)
        .bind(claim.fence);
        let Some(row) = row.fetch_optional(&mut *transaction).await? else { return Ok(Finished::Lost) };
        let next = next_phase(phase_from_row(&row)?, ending, row.try_get("deaths")?, max_deaths);
        write_ending(&mut transaction, claim, ending, next).await?;
        failpoint("finish.written");
        if let (Phase::Succeeded, Ending::Succeeded(published)) = (next, ending) {
            note_size(&mut transaction, claim, &published.artifacts).await?;
            artifacts::insert(&mut transaction, &claim.job, &published.artifacts).await?;
            published.summary.insert(&mut transaction, &claim.job).await?;
        }
        failpoint("finish.filled");
        transaction.commit().await?;
        failpoint("finish.committed");
        if next == Phase::Queued {
            self.work.notify_one();
        }
        if next.is_final() {
            self.store.remove_files("checkpoints", &claim.job).await;
        }
        if next != Phase::Succeeded {
            self.store.remove_files("results", &claim.job).await; // no row will ever name them
        }
        failpoint("finish.cleared");
        self.announce(&claim.job);
        Ok(Finished::Recorded(next))
    }
}

/// The tenant that waits and was served the longest ago; it goes to the end of the line.
async fn tenant_in_turn(
    transaction: &mut Transaction<'static, Sqlite>,
    max_running: i64,
) -> Result<Option<String>, StoreError> {
    let name = sqlx::query_scalar(
        "UPDATE tenants SET turn = 1 + (SELECT max(turn) FROM tenants)
         WHERE name = (SELECT name FROM tenants
                       WHERE EXISTS (SELECT 1 FROM jobs WHERE state = 'queued' AND tenant = name)
                         AND (SELECT count(*) FROM jobs WHERE state IN ('running', 'canceling') AND tenant = name) < ?
                       ORDER BY turn, name LIMIT 1)
         RETURNING name",
    );
    Ok(name.bind(max_running).fetch_optional(&mut **transaction).await?)
}

async fn write_ending(
    transaction: &mut Transaction<'static, Sqlite>,
    claim: &Claim,
    ending: &Ending<Published>,
    next: Phase,
) -> Result<(), StoreError> {
    let error = match (next, ending) {
        (Phase::Failed, Ending::Failed(error)) => Some(serde_json::to_string(error)?),
        (Phase::Dead, Ending::ChildDied(how)) => Some(serde_json::to_string(&dead(how))?),
        _ => None,
    };
    sqlx::query(
        "UPDATE jobs SET state = ?1, version = version + 1, boot = NULL, eta_s = NULL, error = ?2,
                         deaths = deaths + ?3,
                         fraction = CASE ?1 WHEN 'succeeded' THEN 1.0 ELSE fraction END,
                         result_fence = CASE ?1 WHEN 'succeeded' THEN fence END,
                         finished_at = CASE ?1 WHEN 'queued' THEN NULL ELSE strftime('%Y-%m-%dT%H:%M:%fZ', 'now') END
         WHERE id = ?4 AND fence = ?5",
    )
    .bind(next.name())
    .bind(error)
    .bind(matches!(ending, Ending::ChildDied(_)) && !fault("deaths.uncounted"))
    .bind(&claim.job)
    .bind(claim.fence)
    .execute(&mut **transaction)
    .await?;
    Ok(())
}

/// The tenant's quota counts it.
async fn note_size(
    transaction: &mut Transaction<'static, Sqlite>,
    claim: &Claim,
    artifacts: &[Artifact],
) -> Result<(), StoreError> {
    let bytes: u64 = artifacts.iter().map(|artifact| artifact.bytes).sum();
    let noted = sqlx::query("UPDATE jobs SET result_bytes = ? WHERE id = ?").bind(bytes as i64).bind(&claim.job);
    noted.execute(&mut **transaction).await?;
    Ok(())
}

fn dead(how: &str) -> JobError {
    JobError {
        code: "child_died".to_owned(),
        detail: format!("the job's own process died too often; the last time: {how}"),
        remedy: "look into the service's log; a smaller session or more memory may help".to_owned(),
        ..JobError::default()
    }
}
