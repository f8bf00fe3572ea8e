//! Accepting a job from a client, once per Idempotency-Key.

use super::class::{self, options_level};
use super::fingerprint::Request;
use super::handle::Queue;
use super::job::{Job, Submitter};
use super::rows::{JOB_COLUMNS, job_from_row};
use crate::pipeline::Options;
use crate::service::failpoint::{OPTION_OF_NEXT_RELEASE, failpoint, fault, is_next_release};
use crate::service::settings::{RequestLimits, TenantLimits};
use crate::service::store::database::WriteTransaction;
use crate::service::store::error::StoreError;
use crate::service::store::random::new_id;
use crate::service::store::sessions;
use crate::service::store::tenants::{self, Tenant, Usage};
use sqlx::AssertSqlSafe;
use std::collections::BTreeMap;

/// A validated request for a job.
#[derive(Debug, Clone)]
pub struct NewJob {
    /// Owner of the job.
    pub tenant: Tenant,
    /// Id of the session to solve.
    pub session: String,
    /// All options with their values, defaults included.
    pub options: serde_json::Value,
    /// Labels set by the client.
    pub labels: BTreeMap<String, String>,
    /// Jobs of higher priority run first, among the jobs of one tenant.
    pub priority: i64,
    /// URL to call when the job ends.
    pub webhook: Option<String>,
    /// The request that submits the job.
    pub submitter: Submitter,
}

impl NewJob {
    /// What separates this request from another one under the same `Idempotency-Key`: SHA-256 of its canonical form.
    pub fn fingerprint(&self, session_sha256: &str) -> String {
        let Self { options, labels, priority, .. } = self;
        let webhook = self.webhook.as_deref();
        Request { session_sha256, options, labels, priority: *priority, webhook }.fingerprint()
    }
}

/// An `Idempotency-Key` and the request that used it.
#[derive(Debug, Clone)]
pub struct IdempotencyKey {
    /// Value of the header.
    pub key: String,
    /// [`NewJob::fingerprint`].
    pub fingerprint: String,
    /// [`fingerprint_as_sent`](super::fingerprint_as_sent) of a request whose meaning depends on another job; it is stored in place
    /// of the other one.
    pub as_sent: Option<String>,
}

impl IdempotencyKey {
    fn is_of(&self, stored: &str) -> bool {
        stored == self.fingerprint || self.as_sent.as_deref() == Some(stored)
    }
}

/// Upper bounds on the queue and on the stored bytes of the tenant.
#[derive(Debug, Clone, Copy)]
pub struct QueueLimits {
    /// Jobs of all tenants together.
    pub total: i64,
    /// Jobs of one tenant.
    pub tenant: i64,
    /// Bytes of the tenant's uploads and results, the quota.
    pub max_bytes: i64,
}

impl QueueLimits {
    /// Takes the limits from the settings.
    pub fn of(limits: &RequestLimits, tenants: &TenantLimits) -> Self {
        Self { total: limits.max_queued, tenant: tenants.max_queued, max_bytes: tenants.max_bytes }
    }
}

/// Why a job was not accepted.
#[derive(Debug, thiserror::Error)]
pub enum EnqueueError {
    /// The session does not exist.
    #[error("no such session")]
    SessionMissing,
    /// The key was used for another request before.
    #[error("the Idempotency-Key was used for another request")]
    KeyReused,
    /// The job of this key was deleted.
    #[error("the job of this Idempotency-Key was deleted")]
    JobDeleted,
    /// Too many jobs are queued.
    #[error("{waiting} jobs are already queued")]
    Full {
        /// Number of queued jobs.
        waiting: i64,
    },
    /// Too many jobs of this tenant are queued.
    #[error("{waiting} jobs of the tenant are already queued")]
    TenantFull {
        /// Number of queued jobs.
        waiting: i64,
    },
    /// The quota of the tenant is used up, so that no result could be stored.
    #[error("the tenant has used its quota: {stored} of {max} bytes are stored")]
    QuotaExceeded {
        /// Bytes that the tenant uses.
        stored: i64,
        /// Quota of the tenant, bytes.
        max: i64,
    },
    /// The store failed, or the disk has less than its minimum of free bytes.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl From<sqlx::Error> for EnqueueError {
    fn from(error: sqlx::Error) -> Self {
        Self::Store(error.into())
    }
}

impl Queue {
    /// Accepts a job; after this returns, the job is durable and will reach a final state.
    ///
    /// # Errors
    /// [`EnqueueError`].
    pub async fn enqueue(
        &self,
        new: &NewJob,
        idempotency: Option<&IdempotencyKey>,
        limits: QueueLimits,
    ) -> Result<Job, EnqueueError> {
        let mut transaction = self.store.write().await?;
        let id = new_id("job");
        if let Some(key) = idempotency.filter(|_| !fault("key.ignored"))
            && !take_key(&mut transaction, new, key, &id).await?
        {
            let known = job_of_key(&mut transaction, &new.tenant, key).await?;
            transaction.rollback().await?;
            return self.get(&new.tenant, &known).await?.ok_or(EnqueueError::JobDeleted);
        }
        self.store.require_space()?;
        let usage = tenants::lock(&self.store, &mut transaction, &new.tenant).await?;
        let class = class_of_session(&mut transaction, new).await?;
        require_capacity(usage, limits)?;
        let job = insert(&mut transaction, new, id, class).await?;
        failpoint("enqueue.inserted");
        if fault("enqueue.early") {
            tokio::spawn(async move {
                tokio::time::sleep(std::time::Duration::from_millis(300)).await;
                transaction.commit().await
            });
            return Ok(job);
        }
        if let Err(error) = self.store.commit(transaction).await
            && self.get(&new.tenant, &job.id).await?.is_none()
        {
            return Err(error.into()); // a job that is there was committed, and only the answer was lost
        }
        failpoint("enqueue.committed");
        self.announce_to_all(&job.id, true);
        Ok(job)
    }
}

impl Queue {
    /// Returns the SHA-256 of a session, which may be deleted, if a job on it was accepted under this key.
    ///
    /// # Errors
    /// When the store fails.
    pub async fn session_of_key(
        &self,
        tenant: &Tenant,
        key: &str,
        session: &str,
    ) -> Result<Option<String>, StoreError> {
        let sha256 = "SELECT session_sha256 FROM idempotency WHERE tenant = $1 AND key = $2 AND session_id = $3";
        let sha256 = sqlx::query_scalar::<_, Option<String>>(sha256).bind(tenant.name()).bind(key).bind(session);
        Ok(sha256.fetch_optional(self.store.read()).await?.flatten())
    }

    /// Returns the job that a request with this [`fingerprint_as_sent`](super::fingerprint_as_sent) has made under this key.
    ///
    /// # Errors
    /// [`EnqueueError::JobDeleted`] if that job was deleted, or when the store fails.
    pub async fn job_of_request(&self, tenant: &Tenant, key: &str, as_sent: &str) -> Result<Option<Job>, EnqueueError> {
        if fault("key.ignored") {
            return Ok(None);
        }
        let job = "SELECT job_id FROM idempotency WHERE tenant = $1 AND key = $2 AND fingerprint = $3";
        let job = sqlx::query_scalar::<_, String>(job).bind(tenant.name()).bind(key).bind(as_sent);
        let Some(job) = job.fetch_optional(self.store.read()).await? else { return Ok(None) };
        Ok(Some(self.get(tenant, &job).await?.ok_or(EnqueueError::JobDeleted)?))
    }

    /// Forgets the keys of deleted jobs that were first used more than `days` ago. Returns their number.
    ///
    /// # Errors
    /// When the store fails.
    pub(crate) async fn forget_keys(&self, days: f64) -> Result<u64, StoreError> {
        let mut transaction = self.store.write_relaxed().await?;
        let forgotten = sqlx::query(
            "DELETE FROM idempotency WHERE created_at < strftime('%Y-%m-%dT%H:%M:%fZ', 'now', $1)
               AND NOT EXISTS (SELECT 1 FROM jobs WHERE jobs.id = idempotency.job_id)",
        )
        .bind(format!("{} days", -days))
        .execute(&mut *transaction)
        .await?;
        transaction.commit().await?;
        Ok(forgotten.rows_affected())
    }
}

/// Takes a key for a new job; false if it is taken. The insertion itself finds that out, so that of two simultaneous
/// requests the second waits for the first.
async fn take_key(
    transaction: &mut WriteTransaction,
    new: &NewJob,
    key: &IdempotencyKey,
    job: &str,
) -> Result<bool, EnqueueError> {
    let inserted = sqlx::query(
        "INSERT INTO idempotency (tenant, key, fingerprint, job_id, session_id, session_sha256, created_at)
         VALUES ($1, $2, $3, $4, $5, (SELECT sha256 FROM sessions WHERE id = $5),
                 strftime('%Y-%m-%dT%H:%M:%fZ', 'now'))
         ON CONFLICT (tenant, key) DO NOTHING",
    )
    .bind(new.tenant.name())
    .bind(&key.key)
    .bind(key.as_sent.as_ref().unwrap_or(&key.fingerprint))
    .bind(job)
    .bind(&new.session)
    .execute(&mut **transaction)
    .await?;
    Ok(inserted.rows_affected() == 1)
}

/// Returns the job id stored with a taken key; an error if the key was used for another request.
async fn job_of_key(
    transaction: &mut WriteTransaction,
    tenant: &Tenant,
    key: &IdempotencyKey,
) -> Result<String, EnqueueError> {
    let row =
        sqlx::query_as("SELECT fingerprint, job_id, session_sha256 FROM idempotency WHERE tenant = $1 AND key = $2");
    let row: (String, String, Option<String>) =
        row.bind(tenant.name()).bind(&key.key).fetch_one(&mut **transaction).await?;
    let (fingerprint, job, session) = row;
    if key.is_of(&fingerprint) {
        return Ok(job);
    }
    // The fingerprint may be that of an older release, or of a request that was sent in another form; the stored job shows what was asked.
    let of_job = fingerprint_of_job(transaction, &job, session.as_deref().unwrap_or_default()).await?;
    if of_job.as_ref() == Some(&key.fingerprint) { Ok(job) } else { Err(EnqueueError::KeyReused) }
}

/// The fingerprint of the request that made a job, from what is stored of it; `None` where the job was deleted, or where this release
/// does not know its options. Fingerprints of older releases have all their options, defaults included.
async fn fingerprint_of_job(
    transaction: &mut WriteTransaction,
    job: &str,
    session_sha256: &str,
) -> Result<Option<String>, StoreError> {
    let row = sqlx::query_as("SELECT options, labels, priority, webhook FROM jobs WHERE id = $1").bind(job);
    let row: Option<(String, String, i64, Option<String>)> = row.fetch_optional(&mut **transaction).await?;
    let Some((options, labels, priority, webhook)) = row else { return Ok(None) };
    let Ok(options) = serde_json::from_str::<Options>(&options) else { return Ok(None) };
    let (options, labels) = (&serde_json::to_value(options)?, &serde_json::from_str(&labels)?);
    let webhook = webhook.as_deref();
    Ok(Some(Request { session_sha256, options, labels, priority, webhook }.fingerprint()))
}

/// The class of a job on the session, which must exist.
async fn class_of_session(transaction: &mut WriteTransaction, new: &NewJob) -> Result<i64, EnqueueError> {
    let session = sessions::get_in(transaction, &new.tenant, &new.session).await?;
    Ok(class::of_session(&session.ok_or(EnqueueError::SessionMissing)?.summary))
}

fn require_capacity(usage: Usage, limits: QueueLimits) -> Result<(), EnqueueError> {
    if usage.n_queued_of_all >= limits.total {
        return Err(EnqueueError::Full { waiting: usage.n_queued_of_all });
    }
    if usage.n_queued >= limits.tenant {
        return Err(EnqueueError::TenantFull { waiting: usage.n_queued });
    }
    if usage.stored_bytes >= limits.max_bytes && !fault("quota.none") {
        return Err(EnqueueError::QuotaExceeded { stored: usage.stored_bytes, max: limits.max_bytes });
    }
    Ok(())
}

/// The options as they are stored; in a check of upgrades with one that only the next release knows.
fn written_options(new: &NewJob) -> String {
    let mut options = new.options.clone();
    if let (true, Some(all)) = (is_next_release(), options.as_object_mut()) {
        all.insert(OPTION_OF_NEXT_RELEASE.to_owned(), true.into());
    }
    options.to_string()
}

async fn insert(transaction: &mut WriteTransaction, new: &NewJob, id: String, class: i64) -> Result<Job, EnqueueError> {
    let row = sqlx::query(AssertSqlSafe(format!(
        "INSERT INTO jobs (id, tenant, session_id, options, labels, priority, webhook, request_id, key_id, class,
                           needs, state, created_at)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, 'queued', strftime('%Y-%m-%dT%H:%M:%fZ', 'now'))
         RETURNING {JOB_COLUMNS}, NULL AS verdict, NULL AS reasons, NULL AS suspicions"
    )))
    .bind(id)
    .bind(new.tenant.name())
    .bind(&new.session)
    .bind(written_options(new))
    .bind(serde_json::to_string(&new.labels).map_err(StoreError::from)?)
    .bind(new.priority)
    .bind(&new.webhook)
    .bind(&new.submitter.request)
    .bind(&new.submitter.key)
    .bind(class)
    .bind(options_level())
    .fetch_one(&mut **transaction)
    .await?;
    Ok(job_from_row(&row)?)
}
