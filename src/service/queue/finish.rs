//! The end of a claim: its outcome is recorded once, however often it is reported.
//!
//! If the answer to a COMMIT is lost, the worker reports again what is already recorded. The row shows it: the job has ended or is
//! queued under the same fence, or its result has that fence, and only this claim can have done that.

use super::claim::Claim;
use super::handle::Queue;
use super::job::JobError;
use super::outcome::{ClaimOutcome, next_phase};
use super::phase::Phase;
use super::rows::phase_from_row;
use crate::service::failpoint::{failpoint, fault};
use crate::service::store::artifacts::{self, Artifact};
use crate::service::store::database::WriteTransaction;
use crate::service::store::error::StoreError;
use crate::service::store::summary::Summary;
use sqlx::Row;
use std::time::{Duration, Instant};

/// A result in its final folder whose rows are not yet written.
#[derive(Debug)]
pub struct Published {
    /// Files of the result.
    pub artifacts: Vec<Artifact>,
    /// Summary rows of the result.
    pub summary: Summary,
}

/// Result of [`Queue::finish`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Finished {
    /// The job is now in this state.
    Recorded(Phase),
    /// The claim was no longer valid; nothing was written.
    Lost,
}

/// The row of a claim.
enum ClaimRow {
    /// The claim runs; its row is locked.
    Open { phase: Phase, crashes: i64 },
    /// This claim has ended; the job is now in this state.
    Ended(Phase),
    /// The job was deleted or claimed again.
    Lost,
}

impl Queue {
    /// Records the outcome of a claim, all rows in one transaction. A repetition gives the recorded state.
    ///
    /// # Errors
    /// When the store fails; the call can be repeated, whether or not the transaction was committed.
    pub async fn finish(
        &self,
        claim: &Claim,
        outcome: &ClaimOutcome<Published>,
        max_crashes: u32,
    ) -> Result<Finished, StoreError> {
        let mut transaction = self.store.write().await?;
        let (next, wait) = match lock_row(&mut transaction, claim).await? {
            ClaimRow::Open { phase, crashes } => {
                let (wait, class) = match phase {
                    Phase::Running => (self.wait_after(claim, outcome), self.class_after(outcome)),
                    _ => (None, None),
                };
                let is_run_again = wait.is_some() || class.is_some();
                let next = if is_run_again { Phase::Queued } else { next_phase(phase, outcome, crashes, max_crashes) };
                if let (Phase::Succeeded, ClaimOutcome::Succeeded(published)) = (next, outcome) {
                    artifacts::insert(&mut transaction, &claim.job, &published.artifacts).await?;
                    published.summary.insert(&mut transaction, &claim.job).await?;
                }
                failpoint("finish.filled");
                write_outcome(&mut transaction, claim, outcome, &Next { phase: next, wait, class }).await?;
                failpoint("finish.written");
                self.store.commit(transaction).await?;
                failpoint("finish.committed");
                (next, wait)
            }
            ClaimRow::Ended(phase) => {
                transaction.rollback().await?;
                (phase, if phase == Phase::Queued { self.wait_after(claim, outcome) } else { None })
            }
            ClaimRow::Lost => {
                transaction.rollback().await?;
                self.active.remove(&claim.job, claim.fence);
                return Ok(Finished::Lost);
            }
        };
        self.active.remove(&claim.job, claim.fence);
        if let (Some(wait), ClaimOutcome::Failed(error)) = (wait, outcome) {
            self.deferrals().defer(&claim.job, Instant::now(), wait);
            let (code, detail, wait_s) = (&error.code, &error.detail, wait.as_secs());
            tracing::warn!(code, detail, wait_s, "the machine failed the job; it waits for its next try");
        }
        self.clear_files(claim, next).await;
        failpoint("finish.cleared");
        self.announce_to_all(&claim.job, next == Phase::Queued);
        Ok(Finished::Recorded(next))
    }

    /// Time until the next try of a job that met a fault of the machine; `None` for other outcomes and after too many tries.
    fn wait_after(&self, claim: &Claim, outcome: &ClaimOutcome<Published>) -> Option<Duration> {
        match outcome {
            ClaimOutcome::Failed(error) if error.is_of_machine() => self.deferrals().next_wait(&claim.job),
            _ => None,
        }
    }

    /// Removes the files that no row refers to. The files of a later claim of the same job stay: another worker may have
    /// claimed a queued job since the commit.
    async fn clear_files(&self, claim: &Claim, next: Phase) {
        if next.is_final() {
            self.deferrals().forget(&claim.job);
            self.store.remove_files("checkpoints", &claim.job).await;
        }
        match next {
            Phase::Succeeded => {}
            Phase::Queued => self.store.remove_claim(&claim.job, claim.fence).await,
            _ => self.store.remove_files("results", &claim.job).await,
        }
    }
}

/// Locks the row of a running claim by its first change, so that nothing else changes the job until the commit.
async fn lock_row(transaction: &mut WriteTransaction, claim: &Claim) -> Result<ClaimRow, StoreError> {
    let lock = sqlx::query(if fault("fence.none") {
        "UPDATE jobs SET version = version + 1, boot = coalesce(boot, ''), state = 'running', fence = $2
         WHERE id = $1 AND fence >= $2 AND state IN ('queued', 'running') RETURNING state, crashes"
    } else {
        "UPDATE jobs SET version = version + 1 WHERE id = $1 AND fence = $2 AND state IN ('running', 'canceling')
         RETURNING state, crashes"
    });
    let open = lock.bind(&claim.job).bind(claim.fence).fetch_optional(&mut **transaction).await?;
    if let Some(row) = open {
        return Ok(ClaimRow::Open { phase: phase_from_row(&row)?, crashes: row.try_get("crashes")? });
    }
    // Later fences of a succeeded job are those of results with further formats.
    let ended = sqlx::query("SELECT state FROM jobs WHERE id = $1 AND (fence = $2 OR result_fence = $2)");
    let ended = ended.bind(&claim.job).bind(claim.fence).fetch_optional(&mut **transaction).await?;
    Ok(match ended {
        Some(row) if !fault("commit.forgotten") => ClaimRow::Ended(phase_from_row(&row)?),
        _ => ClaimRow::Lost,
    })
}

/// What follows from the end of a claim.
struct Next {
    /// State of the job.
    phase: Phase,
    /// Time until the next try after a fault of the machine.
    wait: Option<Duration>,
    /// Class in which the job is run again.
    class: Option<i64>,
}

async fn write_outcome(
    transaction: &mut WriteTransaction,
    claim: &Claim,
    outcome: &ClaimOutcome<Published>,
    next: &Next,
) -> Result<(), StoreError> {
    let message = match (next, outcome) {
        (Next { wait: Some(wait), .. }, ClaimOutcome::Failed(error)) => {
            Some(format!("waiting {} s for the next try: {}", wait.as_secs(), error.detail))
        }
        (Next { class: Some(class), .. }, ClaimOutcome::Failed(error)) => {
            Some(format!("waiting for a worker of class {class}: {}", error.detail))
        }
        _ => None,
    };
    let error = match (next.phase, outcome) {
        (Phase::Failed, ClaimOutcome::Failed(error)) => Some(serde_json::to_string(error)?),
        (Phase::Dead, ClaimOutcome::Crashed(how)) => Some(serde_json::to_string(&crashed_too_often(how))?),
        _ => None,
    };
    // The size of the result counts towards the tenant's quota.
    let result_bytes = match (next.phase, outcome) {
        (Phase::Succeeded, ClaimOutcome::Succeeded(published)) => {
            Some(published.artifacts.iter().map(|artifact| artifact.bytes).sum::<u64>() as i64)
        }
        _ => None,
    };
    sqlx::query(
        "UPDATE jobs SET state = $1, boot = NULL, eta_s = NULL, error = $2,
                         crashes = crashes + $3, message = coalesce($6, message), class = coalesce($7, class),
                         result_bytes = coalesce($8, result_bytes),
                         fraction = CASE $1 WHEN 'succeeded' THEN 1.0 ELSE fraction END,
                         result_fence = CASE $1 WHEN 'succeeded' THEN fence END,
                         finished_at = CASE $1 WHEN 'queued' THEN NULL ELSE strftime('%Y-%m-%dT%H:%M:%fZ', 'now') END
         WHERE id = $4 AND fence = $5",
    )
    .bind(next.phase.name())
    .bind(error)
    .bind(i64::from(matches!(outcome, ClaimOutcome::Crashed(_)) && !fault("crashes.uncounted")))
    .bind(&claim.job)
    .bind(claim.fence)
    .bind(message)
    .bind(next.class)
    .bind(result_bytes)
    .execute(&mut **transaction)
    .await?;
    Ok(())
}

fn crashed_too_often(how: &str) -> JobError {
    JobError {
        code: "child_died".to_owned(),
        detail: format!("the job's process crashed too often; last crash: {how}"),
        remedy: "read the service log; try a smaller session or more memory".to_owned(),
        ..JobError::default()
    }
}
