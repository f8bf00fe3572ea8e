//! Claims of workers in other processes end by their beats: a worker adds one to the beat of its claim while it is alive, and the leader
//! puts back a claim whose beat it has seen unchanged for the time of a lease, by its own monotonic clock. So no wall clock decides, and
//! while the database is away no claim ends.

use super::claim::{Claim, ClaimStatus};
use super::handle::Queue;
use super::job::JobError;
use super::phase::Phase;
use super::rows::phase_from_row;
use crate::service::failpoint::fault;
use crate::service::store::error::StoreError;
use sqlx::Row;
use sqlx::postgres::PgConnection;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// The beats that the leader has seen, and when each was new.
#[derive(Debug, Default)]
pub(crate) struct SeenBeats {
    claims: BTreeMap<String, (Beat, Instant)>,
    last_look: Option<Instant>,
}

/// The beat of one claim.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Beat {
    job: String,
    fence: i64,
    beat: i64,
}

impl SeenBeats {
    /// Notes the beats of all running claims; returns those that stand still since `lease`. After a gap between two looks nothing is
    /// known: the leader itself, or the database, may have stood still.
    fn look(&mut self, beats: Vec<Beat>, now: Instant, lease: Duration) -> Vec<Beat> {
        if self.last_look.is_some_and(|last| now.duration_since(last) > lease / 2) {
            self.claims.clear();
        }
        self.last_look = Some(now);
        let known = std::mem::take(&mut self.claims);
        for beat in beats {
            let since = known.get(&beat.job).filter(|(seen, _)| *seen == beat).map_or(now, |(_, since)| *since);
            self.claims.insert(beat.job.clone(), (beat, since));
        }
        let silent = self.claims.values().filter(|(_, since)| now.duration_since(*since) >= lease);
        silent.map(|(beat, _)| beat.clone()).collect()
    }

    /// For how long the longest unchanged beat has stood still; zero without a running job.
    pub(crate) fn longest_silence(&self) -> Duration {
        self.claims.values().map(|(_, since)| since.elapsed()).max().unwrap_or_default()
    }
}

/// The fence grows, too: what the silent worker reports later is lost, whatever became of the job. A job that was lost in a further
/// stage than ever before gets on, so its losses are counted anew. `$4`, `$5`: limit of the losses, and the error of a job that
/// reaches it.
const PUT_BACK: &str = "
    UPDATE jobs SET state = CASE WHEN state = 'canceling' THEN 'canceled' WHEN lost.losses >= $4 THEN 'failed' ELSE 'queued' END,
                    error = CASE WHEN state = 'running' AND lost.losses >= $4 THEN $5 END,
                    losses = lost.losses, lost_stage = greatest(lost_stage, stage_index),
                    version = version + 1, fence = fence + 1, boot = NULL, eta_s = NULL,
                    finished_at = CASE WHEN state = 'canceling' OR lost.losses >= $4
                                  THEN strftime('%Y-%m-%dT%H:%M:%fZ', 'now') END
    FROM (SELECT id AS job, CASE WHEN stage_index > lost_stage THEN 1 ELSE losses + 1 END AS losses FROM jobs WHERE id = $1) AS lost
    WHERE id = lost.job AND fence = $2 AND beat = $3 AND state IN ('running', 'canceling')
    RETURNING state, jobs.losses";

/// The error of a job that may be what ends its workers.
fn too_often_lost(max_losses: i64) -> JobError {
    JobError {
        code: "worker_lost".to_owned(),
        detail: format!("{max_losses} workers of the job fell silent, one after the other, before they had finished a further stage"),
        remedy: "ask the operator whether machines run out of memory (jobs.memory_bytes) or are taken away (jobs.max_losses); then \
                 submit the job again, or a shorter take"
            .to_owned(),
        ..JobError::default()
    }
}

impl Queue {
    /// Shows that the worker of a claim is alive; returns whether the claim is still valid.
    ///
    /// # Errors
    /// When the store fails.
    pub(crate) async fn beat(&self, claim: &Claim) -> Result<ClaimStatus, StoreError> {
        let mut transaction = self.store.write_relaxed().await?;
        let beat = "UPDATE jobs SET beat = beat + 1 WHERE id = $1 AND fence = $2 AND state IN ('running', 'canceling')
                    RETURNING state";
        let row = sqlx::query(beat).bind(&claim.job).bind(claim.fence).fetch_optional(&mut *transaction).await?;
        transaction.commit().await?;
        Ok(match row.as_ref().map(phase_from_row).transpose()? {
            Some(Phase::Running) => ClaimStatus::Active,
            Some(Phase::Canceling) => ClaimStatus::Canceling,
            _ => ClaimStatus::Lost,
        })
    }

    /// Puts back the claims whose beat stands still; a job that has lost `max_losses` workers in the same stage fails. Called by the
    /// leader, on the connection that makes it the leader.
    ///
    /// # Errors
    /// When the connection fails.
    pub(crate) async fn put_back_silent(
        &self,
        leader: &mut PgConnection,
        seen: &mut SeenBeats,
        lease: Duration,
        max_losses: i64,
    ) -> Result<(), StoreError> {
        let running = "SELECT id, fence, beat FROM jobs WHERE state IN ('running', 'canceling')";
        let rows = sqlx::query(running).fetch_all(&mut *leader).await?;
        let beat = |row: &sqlx::postgres::PgRow| {
            Ok::<_, sqlx::Error>(Beat {
                job: row.try_get("id")?,
                fence: row.try_get("fence")?,
                beat: row.try_get("beat")?,
            })
        };
        let beats = rows.iter().map(beat).collect::<Result<_, _>>()?;
        for silent in seen.look(beats, Instant::now(), lease) {
            if fault("recovery.forgets") {
                continue;
            }
            let lost = too_often_lost(max_losses);
            let put_back = sqlx::query(PUT_BACK).bind(&silent.job).bind(silent.fence).bind(silent.beat);
            let put_back = put_back.bind(max_losses).bind(serde_json::to_string(&lost)?);
            if let Some(row) = put_back.fetch_optional(&mut *leader).await? {
                let (state, losses): (String, i64) = (row.try_get("state")?, row.try_get("losses")?);
                let (id, fence) = (&silent.job, silent.fence);
                tracing::warn!(
                    job.id = id,
                    fence,
                    state,
                    losses,
                    "the worker of the job is silent; the job was put back"
                );
                self.announce_to_all(&silent.job, true);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEASE: Duration = Duration::from_secs(30);

    fn beat(beat: i64) -> Vec<Beat> {
        vec![Beat { job: "j".to_owned(), fence: 1, beat }]
    }

    #[test]
    fn only_a_beat_that_stands_still_ends_a_claim() {
        let (mut seen, start) = (SeenBeats::default(), Instant::now());
        let at = |s: u64| start + Duration::from_secs(s);
        for s in (0..100).step_by(5) {
            assert!(seen.look(beat(s as i64), at(s), LEASE).is_empty(), "alive at {s} s");
        }
        for s in (100..130).step_by(5) {
            assert!(seen.look(beat(100), at(s), LEASE).is_empty(), "silent for {} s", s - 100);
        }
        assert_eq!(seen.look(beat(100), at(130), LEASE), beat(100));
        let next = vec![Beat { fence: 2, ..beat(100).remove(0) }];
        assert!(seen.look(next, at(135), LEASE).is_empty(), "another claim of the same job");
    }

    #[test]
    fn a_gap_between_two_looks_ends_no_claim() {
        let (mut seen, start) = (SeenBeats::default(), Instant::now());
        assert!(seen.look(beat(1), start, LEASE).is_empty());
        assert!(seen.look(beat(1), start + 3 * LEASE, LEASE).is_empty(), "the leader stood still itself");
    }
}
