//! The client's side of the queue: accepting a job, once per Idempotency-Key.

use super::job::Job;
use super::rows::job_from_row;
use super::{Queue, StoreError};
use crate::service::store::new_id;
use sqlx::{Row, Sqlite, Transaction};
use std::collections::BTreeMap;

/// What a client asks for, already checked.
#[derive(Debug, Clone)]
pub struct NewJob {
    /// Session id.
    pub session: String,
    /// Every option with its value.
    pub options: serde_json::Value,
    /// The client's own marks.
    pub labels: BTreeMap<String, String>,
    /// Higher runs first.
    pub priority: i64,
}

/// `Idempotency-Key` and what was asked under it.
#[derive(Debug, Clone)]
pub struct IdempotencyKey {
    /// The header's value.
    pub key: String,
    /// SHA-256 of the canonical request.
    pub fingerprint: String,
}

/// Why a job was not accepted.
#[derive(Debug, thiserror::Error)]
pub enum EnqueueError {
    /// No such session.
    #[error("no such session")]
    SessionMissing,
    /// The key was used for another request.
    #[error("the Idempotency-Key was used for another request")]
    KeyReused,
    /// The key's job was deleted.
    #[error("the job of this Idempotency-Key was deleted")]
    JobDeleted,
    /// Too many jobs wait.
    #[error("{waiting} jobs are waiting")]
    Full {
        /// How many.
        waiting: i64,
    },
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl From<sqlx::Error> for EnqueueError {
    fn from(error: sqlx::Error) -> Self {
        Self::Store(error.into())
    }
}

impl Queue {
    /// Accepts a job; once this has returned it will reach a final state.
    ///
    /// # Errors
    /// [`EnqueueError`].
    pub async fn enqueue(
        &self,
        new: &NewJob,
        idempotency: Option<&IdempotencyKey>,
        max_queued: i64,
    ) -> Result<Job, EnqueueError> {
        let mut transaction = self.store.write().await?;
        if let Some(asked) = idempotency
            && let Some(known) = job_of_key(&mut transaction, asked).await?
        {
            transaction.rollback().await?;
            return self.get(&known).await?.ok_or(EnqueueError::JobDeleted);
        }
        require_session(&mut transaction, &new.session).await?;
        require_room(&mut transaction, max_queued).await?;
        let job = insert(&mut transaction, new).await?;
        if let Some(asked) = idempotency {
            remember_key(&mut transaction, asked, &job.id).await?;
        }
        transaction.commit().await?;
        self.work.notify_one();
        self.announce(&job.id);
        Ok(job)
    }
}

type Writing = Transaction<'static, Sqlite>;

/// The job that a key stands for; refused where it stood for another request.
async fn job_of_key(transaction: &mut Writing, asked: &IdempotencyKey) -> Result<Option<String>, EnqueueError> {
    let row = sqlx::query("SELECT fingerprint, job_id FROM idempotency WHERE key = ?").bind(&asked.key);
    let Some(row) = row.fetch_optional(&mut **transaction).await? else { return Ok(None) };
    if row.try_get::<&str, _>("fingerprint")? != asked.fingerprint {
        return Err(EnqueueError::KeyReused);
    }
    Ok(Some(row.try_get("job_id")?))
}

async fn require_session(transaction: &mut Writing, id: &str) -> Result<(), EnqueueError> {
    let session = sqlx::query("SELECT 1 FROM sessions WHERE id = ?").bind(id);
    session.fetch_optional(&mut **transaction).await?.map(|_| ()).ok_or(EnqueueError::SessionMissing)
}

async fn require_room(transaction: &mut Writing, max_queued: i64) -> Result<(), EnqueueError> {
    let waiting = sqlx::query_scalar("SELECT count(*) FROM jobs WHERE state = 'queued'");
    let waiting: i64 = waiting.fetch_one(&mut **transaction).await?;
    if waiting < max_queued { Ok(()) } else { Err(EnqueueError::Full { waiting }) }
}

async fn insert(transaction: &mut Writing, new: &NewJob) -> Result<Job, EnqueueError> {
    let row = sqlx::query(
        "INSERT INTO jobs (id, session_id, options, labels, priority, state, created_at)
         VALUES (?, ?, ?, ?, ?, 'queued', strftime('%Y-%m-%dT%H:%M:%fZ', 'now'))
         RETURNING *, NULL AS verdict, NULL AS reasons",
    )
    .bind(new_id("job"))
    .bind(&new.session)
    .bind(new.options.to_string())
    .bind(serde_json::to_string(&new.labels).map_err(StoreError::from)?)
    .bind(new.priority)
    .fetch_one(&mut **transaction)
    .await?;
    Ok(job_from_row(&row)?)
}

async fn remember_key(transaction: &mut Writing, asked: &IdempotencyKey, job: &str) -> Result<(), EnqueueError> {
    sqlx::query(
        "INSERT INTO idempotency (key, fingerprint, job_id, created_at)
         VALUES (?, ?, ?, strftime('%Y-%m-%dT%H:%M:%fZ', 'now'))",
    )
    .bind(&asked.key)
    .bind(&asked.fingerprint)
    .bind(job)
    .execute(&mut **transaction)
    .await?;
    Ok(())
}
