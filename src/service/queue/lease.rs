//! Claims of workers in other processes end by their beats: a worker adds one to the beat of its claim while it is alive, and the leader
//! puts back a claim whose beat it has seen unchanged for the time of a lease, by its own monotonic clock. So no wall clock decides, and
//! while the database is away no claim ends.

use super::claim::{Claim, ClaimStatus};
use super::handle::Queue;
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

    /// Puts back the claims whose beat stands still. Called by the leader, on the connection that makes it the leader.
    ///
    /// # Errors
    /// When the connection fails.
    pub(crate) async fn put_back_silent(
        &self,
        leader: &mut PgConnection,
        seen: &mut SeenBeats,
        lease: Duration,
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
            // The fence grows, too: what the silent worker reports later is lost, whatever became of the job.
            let put_back = "UPDATE jobs SET state = CASE state WHEN 'canceling' THEN 'canceled' ELSE 'queued' END,
                                            version = version + 1, fence = fence + 1, boot = NULL, eta_s = NULL,
                                            finished_at = CASE state WHEN 'canceling'
                                                          THEN strftime('%Y-%m-%dT%H:%M:%fZ', 'now') END
                            WHERE id = $1 AND fence = $2 AND beat = $3 AND state IN ('running', 'canceling')";
            let put_back = sqlx::query(put_back).bind(&silent.job).bind(silent.fence).bind(silent.beat);
            if put_back.execute(&mut *leader).await?.rows_affected() == 1 {
                tracing::warn!(
                    job.id = silent.job,
                    fence = silent.fence,
                    "the worker of the job is silent; the job was put back"
                );
                self.announce_to_all(&silent.job, true).await;
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
