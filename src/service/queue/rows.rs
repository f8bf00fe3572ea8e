//! Conversion of `jobs` rows to [`Job`]s.

use super::job::{Job, JobProgress, JobQuality, JobState};
use super::phase::Phase;
use crate::service::store::error::StoreError;
use crate::service::store::sql::SqlRow;
use sqlx::Row;

/// The columns that [`job_from_row`] reads, beside [`VERDICT_COLUMNS`]. They are named, here and in every statement: a server refuses a
/// prepared `*` once a newer release has added a column.
pub(super) const JOB_COLUMNS: &str =
    "id, jobs.seq AS seq, version, session_id, options, labels, priority, state, fence, attempt, stage, stage_index, stage_count,
     fraction, message, eta_s, stage_seconds, solver_version, error, result_fence, created_at, started_at, finished_at";

/// The columns of `verdicts` that it reads.
pub(super) const VERDICT_COLUMNS: &str = "verdict, reasons, suspicions";

/// Converts a row of `jobs` joined with its row of `verdicts`.
pub(super) fn job_from_row(row: &SqlRow) -> Result<Job, StoreError> {
    Ok(Job {
        id: row.try_get("id")?,
        seq: row.try_get("seq")?,
        version: row.try_get("version")?,
        session: row.try_get("session_id")?,
        options: serde_json::from_str(row.try_get("options")?)?,
        labels: serde_json::from_str(row.try_get("labels")?)?,
        priority: row.try_get("priority")?,
        state: state_from_row(row)?,
        attempt: row.try_get("attempt")?,
        progress: JobProgress {
            stage: row.try_get("stage")?,
            stage_index: row.try_get("stage_index")?,
            stage_count: row.try_get("stage_count")?,
            fraction: row.try_get("fraction")?,
            message: row.try_get("message")?,
            eta_s: row.try_get("eta_s")?,
        },
        stage_seconds: serde_json::from_str(row.try_get("stage_seconds")?)?,
        solver_version: row.try_get("solver_version")?,
        created_at: row.try_get("created_at")?,
        started_at: row.try_get("started_at")?,
    })
}

/// Reads the state's name from a row.
pub(super) fn phase_from_row(row: &SqlRow) -> Result<Phase, StoreError> {
    let name: &str = row.try_get("state")?;
    // The schema admits no other names; only a database edited by hand can fail here.
    Phase::parse(name).ok_or_else(|| sqlx::Error::Decode(format!("unknown job state `{name}`").into()).into())
}

fn state_from_row(row: &SqlRow) -> Result<JobState, StoreError> {
    let fence = row.try_get("fence")?;
    let finished_at = row.try_get::<Option<String>, _>("finished_at")?.unwrap_or_default();
    let error = || -> Result<_, StoreError> { Ok(serde_json::from_str(row.try_get("error")?)?) };
    Ok(match phase_from_row(row)? {
        Phase::Queued => JobState::Queued,
        Phase::Running => JobState::Running { fence },
        Phase::Canceling => JobState::Canceling { fence },
        Phase::Succeeded => {
            let result_fence = row.try_get("result_fence")?;
            let reasons = serde_json::from_str(row.try_get("reasons")?)?;
            let suspicions = serde_json::from_str(row.try_get("suspicions")?)?;
            JobState::Succeeded {
                finished_at,
                result_fence,
                quality: JobQuality { verdict: row.try_get("verdict")?, reasons },
                suspicions,
            }
        }
        Phase::Failed => JobState::Failed { finished_at, error: error()? },
        Phase::Canceled => JobState::Canceled { finished_at },
        Phase::Dead => JobState::Dead { finished_at, error: error()? },
    })
}
