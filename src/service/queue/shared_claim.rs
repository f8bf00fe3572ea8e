//! The claim in PostgreSQL: one statement, so that several processes claim at the same time and none holds a lock between two
//! messages.

use super::claim::Claim;
use super::class::options_level;
use super::handle::Queue;
use crate::service::failpoint::{failpoint, fault, lose_answer};
use crate::service::store::error::StoreError;
use sqlx::AssertSqlSafe;

/// The tenant's row is locked (`{lock}`): claims of the same moment take tenants in turn. A row that another claim changed after this
/// statement began is checked again when it is locked, but not sorted again: `{unserved}` passes over a tenant whose turn has moved. A job
/// that another statement holds is passed over. Of the jobs with the highest priority the one of the largest class is taken: smaller
/// ones find a worker anywhere. Each class is looked up by itself, so that jobs that do not fit cost nothing.
///
/// `$1`, `$2`: boot, release; `$3`: most running jobs of a tenant; `$4`: jobs that wait after a fault of the machine, a JSON list. What is
/// the same for every claim of a process is part of the text: with the largest class or the level of options unknown, the server expects so
/// many more rows that it plans each claim anew, which takes as long as the claim. Whether a tenant has another job is asked with a LIMIT:
/// an EXISTS becomes a join that reads every waiting job.
const CLAIM: &str = "
    WITH next AS MATERIALIZED (
        SELECT name FROM tenants
        WHERE n_queued > 0 AND n_running + n_canceling < $3
          AND (SELECT found.seq FROM generate_series(CAST(0 AS BIGINT), {largest_class}) AS fitting (class) CROSS JOIN LATERAL
                   (SELECT seq FROM jobs
                    WHERE state = 'queued' AND tenant = name AND class = fitting.class AND needs <= {level}
                      AND id NOT IN (SELECT value FROM json_each($4))
                    ORDER BY priority DESC, seq LIMIT 1) AS found LIMIT 1) IS NOT NULL
          {unserved}
        ORDER BY turn, name LIMIT 1 {lock}),
    job AS MATERIALIZED (
        SELECT found.seq FROM generate_series(CAST(0 AS BIGINT), {largest_class}) AS fitting (class) CROSS JOIN LATERAL
            (SELECT seq, priority FROM jobs
             WHERE state = 'queued' AND tenant = (SELECT name FROM next) AND class = fitting.class AND needs <= {level}
               AND id NOT IN (SELECT value FROM json_each($4))
             ORDER BY priority DESC, seq LIMIT 1 FOR UPDATE SKIP LOCKED) AS found
        ORDER BY found.priority DESC, fitting.class DESC LIMIT 1),
    turn AS (UPDATE tenants SET turn = nextval('turns') WHERE name = (SELECT name FROM next) RETURNING name)
    UPDATE jobs SET state = 'running', version = version + 1, fence = fence + 1, beat = 0, attempt = crashes + 1, boot = $1,
                    started_at = coalesce(started_at, strftime('%Y-%m-%dT%H:%M:%fZ', 'now')),
                    solver_version = $2
    WHERE seq = (SELECT seq FROM job)
    RETURNING id, fence, tenant, request_id, key_id, session_id, options, stage_seconds,
              (SELECT sha256 FROM sessions WHERE sessions.id = jobs.session_id) AS sha256";

/// The turn in the statement's snapshot: a subquery is not read anew when a locked row is checked again.
const UNSERVED: &str = "AND turn = (SELECT seen.turn FROM tenants AS seen WHERE seen.name = tenants.name)";

impl Queue {
    /// Claims a job of the tenant whose turn it is. A tenant that another claim is taking has had its turn and is passed over; where there is
    /// only that one, its row is waited for. A claim whose answer is lost has no beat, and the leader puts it back.
    pub(super) async fn claim_shared(&self, max_running: i64, waiting: &str) -> Result<Option<Claim>, StoreError> {
        let locks = if fault("row.unlocked") { ["", ""] } else { ["FOR UPDATE SKIP LOCKED", "FOR UPDATE"] };
        let (largest_class, level) = (self.largest_class().to_string(), options_level().to_string());
        let of_process = CLAIM.replace("{largest_class}", &largest_class).replace("{level}", &level);
        for (lock, unserved) in locks.into_iter().zip([UNSERVED, ""]) {
            let claim = of_process.replace("{lock}", lock).replace("{unserved}", unserved);
            let row = sqlx::query(AssertSqlSafe(claim)) // the text is our own
                .bind(&self.store.boot)
                .bind(env!("CARGO_PKG_VERSION"))
                .bind(max_running)
                .bind(waiting)
                .fetch_optional(self.store.read())
                .await?;
            let Some(row) = row else { continue };
            lose_answer().map_err(sqlx::Error::from)?;
            let claim = Claim::from_row(&row)?;
            failpoint("claim.committed");
            self.active.add(&claim.job, claim.fence);
            self.announce(&claim.job);
            return Ok(Some(claim));
        }
        Ok(None)
    }
}
