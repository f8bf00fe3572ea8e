//! The client's side of the queue: accepting a job, once per Idempotency-Key.

use super::job::Job;
use super::rows::job_from_row;
use super::{Queue, StoreError};
use crate::service::failpoint::{failpoint, fault};
use crate::service::settings::{RequestLimits, TenantLimits};
use crate::service::store::{Tenant, new_id, tenants};
use sqlx::{Row, Sqlite, Transaction};
use std::collections::BTreeMap;

/// What a client asks for, already checked.
#[derive(Debug, Clone)]
pub struct NewJob {
    /// Whose.
    pub tenant: Tenant,
    /// Session id.
    pub session: String,
    /// Every option with its value.
    pub options: serde_json::Value,
    /// The client's own marks.
    pub labels: BTreeMap<String, String>,
    /// Higher runs first, among the tenant's own jobs.
    pub priority: i64,
    /// URL to be called at the end.
    pub webhook: Option<String>,
}

/// `Idempotency-Key` and what was asked under it.
#[derive(Debug, Clone)]
pub struct IdempotencyKey {
    /// The header's value.
    pub key: String,
    /// SHA-256 of the canonical request.
    pub fingerprint: String,
}

/// How many jobs may wait.
#[derive(Debug, Clone, Copy)]
pub struct Room {
    /// Of everybody.
    pub everybody: i64,
    /// Of the tenant.
    pub tenant: i64,
}

impl Room {
    /// What the settings say.
    pub fn of(limits: &RequestLimits, tenants: &TenantLimits) -> Self {
        Self { everybody: limits.max_queued, tenant: tenants.max_queued }
    }
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
    /// Too many jobs of this tenant wait.
    #[error("{waiting} jobs of the tenant are waiting")]
    TenantFull {
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
        room: Room,
    ) -> Result<Job, EnqueueError> {
        let mut transaction = self.store.write().await?;
        let idempotency = idempotency.filter(|_| !fault("key.ignored"));
        if let Some(asked) = idempotency
            && let Some(known) = job_of_key(&mut transaction, &new.tenant, asked).await?
        {
            transaction.rollback().await?;
            return self.get(&new.tenant, &known).await?.ok_or(EnqueueError::JobDeleted);
        }
        require_session(&mut transaction, new).await?;
        require_room(&mut transaction, &new.tenant, room).await?;
        tenants::remember(&mut transaction, &new.tenant).await?;
        let job = insert(&mut transaction, new).await?;
        if let Some(asked) = idempotency {
            remember_key(&mut transaction, &new.tenant, asked, &job.id).await?;
        }
        failpoint("enqueue.inserted");
        if fault("enqueue.early") {
            tokio::spawn(async move {
                tokio::time::sleep(std::time::Duration::from_millis(300)).await;
                transaction.commit().await
            });
            return Ok(job);
        }
        transaction.commit().await?;
        failpoint("enqueue.committed");
        self.work.notify_one();
        self.announce(&job.id);
        Ok(job)
    }
}

type Writing = Transaction<'static, Sqlite>;

/// The job that a key stands for; refused where it stood for another request.
async fn job_of_key(
    transaction: &mut Writing,
    tenant: &Tenant,
    asked: &IdempotencyKey,
) -> Result<Option<String>, EnqueueError> {
    let row = sqlx::query("SELECT fingerprint, job_id FROM idempotency WHERE tenant = ? AND key = ?");
    let Some(row) = row.bind(tenant.name()).bind(&asked.key).fetch_optional(&mut **transaction).await? else {
        return Ok(None);
    };
    if row.try_get::<&str, _>("fingerprint")? != asked.fingerprint {
        return Err(EnqueueError::KeyReused);
    }
    Ok(Some(row.try_get("job_id")?))
}

async fn require_session(transaction: &mut Writing, new: &NewJob) -> Result<(), EnqueueError> {
    let session = sqlx::query("SELECT 1 FROM sessions WHERE id = ? AND tenant = ?");
    let session = session.bind(&new.session).bind(new.tenant.name());
    session.fetch_optional(&mut **transaction).await?.map(|_| ()).ok_or(EnqueueError::SessionMissing)
}

async fn require_room(transaction: &mut Writing, tenant: &Tenant, room: Room) -> Result<(), EnqueueError> {
    let waiting = sqlx::query_scalar("SELECT count(*) FROM jobs WHERE state = 'queued'");
    let waiting: i64 = waiting.fetch_one(&mut **transaction).await?;
    if waiting >= room.everybody {
        return Err(EnqueueError::Full { waiting });
    }
    let own = sqlx::query_scalar("SELECT count(*) FROM jobs WHERE state = 'queued' AND tenant = ?").bind(tenant.name());
    let waiting: i64 = own.fetch_one(&mut **transaction).await?;
    if waiting < room.tenant { Ok(()) } else { Err(EnqueueError::TenantFull { waiting }) }
}

async fn insert(transaction: &mut Writing, new: &NewJob) -> Result<Job, EnqueueError> {
    let row = sqlx::query(
        "INSERT INTO jobs (id, tenant, session_id, options, labels, priority, webhook, state, created_at)
         VALUES (?, ?, ?, ?, ?, ?, ?, 'queued', strftime('%Y-%m-%dT%H:%M:%fZ', 'now'))
         RETURNING *, NULL AS verdict, NULL AS reasons",
    )
    .bind(new_id("job"))
    .bind(new.tenant.name())
    .bind(&new.session)
    .bind(new.options.to_string())
    .bind(serde_json::to_string(&new.labels).map_err(StoreError::from)?)
    .bind(new.priority)
    .bind(&new.webhook)
    .fetch_one(&mut **transaction)
    .await?;
    Ok(job_from_row(&row)?)
}

async fn remember_key(
    transaction: &mut Writing,
    tenant: &Tenant,
    asked: &IdempotencyKey,
    job: &str,
) -> Result<(), EnqueueError> {
    sqlx::query(
        "INSERT INTO idempotency (tenant, key, fingerprint, job_id, created_at)
         VALUES (?, ?, ?, ?, strftime('%Y-%m-%dT%H:%M:%fZ', 'now'))",
    )
    .bind(tenant.name())
    .bind(&asked.key)
    .bind(&asked.fingerprint)
    .bind(job)
    .execute(&mut **transaction)
    .await?;
    Ok(())
}
