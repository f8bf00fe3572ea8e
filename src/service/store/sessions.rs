//! Rows of uploaded sessions; the uploaded bytes are stored in the folder `sessions/`.

use super::database::{Store, WriteTransaction};
use super::error::StoreError;
use super::listing::{Listed, read_page};
use super::sql::SqlRow;
use super::tenants::{self, Tenant};
use crate::pipeline::CameraFacts;
use crate::service::failpoint::{failpoint, fault};
use serde::{Deserialize, Serialize};
use sqlx::{AssertSqlSafe, Row};

/// The columns that [`from_row`] reads; named, since a server refuses a prepared `*` once a newer release has added a column.
const COLUMNS: &str =
    "seq, id, sha256, bytes, name, cameras, n_frames, people_max, keypoint_convention, format, warnings, created_at";

/// Longest name of a session, bytes: several lines of text. Lists return the name of each session.
pub const MAX_NAME_BYTES: usize = 256;

/// Summary of a valid upload, as reported to clients.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct SessionSummary {
    /// Name of the session.
    pub name: String,
    /// SHA-256 of the uploaded bytes, hex.
    pub sha256: String,
    /// Number of cameras.
    pub cameras: usize,
    /// Number of frames on the common time line.
    pub frames: usize,
    /// Largest number of detections in one frame of a view.
    pub people_max: usize,
    /// Keypoint convention, in its canonical spelling.
    pub keypoint_convention: String,
    /// Input format of the upload.
    pub format: String,
    /// Harmless irregularities, one sentence each.
    pub warnings: Vec<String>,
    /// Size of the upload, bytes.
    pub bytes: u64,
    /// Facts about the cameras for validating options, in the session's order.
    pub camera_facts: Vec<CameraFacts>,
}

/// A stored session.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = Session)]
pub struct StoredSession {
    /// Session id: `session_` and random bits.
    pub id: String,
    /// Summary of the upload.
    #[serde(flatten)]
    pub summary: SessionSummary,
    /// Time of the upload; UTC, RFC 3339.
    #[schema(format = DateTime)]
    pub created_at: String,
    /// Position in the list of all sessions.
    #[serde(skip)]
    pub seq: i64,
}

/// Result of [`add`]: the new session, or the existing session with the same bytes.
#[derive(Debug)]
pub struct Added {
    /// The stored session.
    pub session: StoredSession,
    /// False if a session with the same bytes existed.
    pub is_new: bool,
}

/// Why a session was not added.
#[derive(Debug, thiserror::Error)]
pub enum AddError {
    /// The upload would exceed the tenant's quota.
    #[error("the upload exceeds the quota: {stored} of {max} bytes are used")]
    QuotaExceeded {
        /// Bytes that the tenant uses.
        stored: i64,
        /// Quota of the tenant, bytes.
        max: i64,
    },
    /// The name is too long for lists.
    #[error("the session's name has {bytes} bytes; at most {MAX_NAME_BYTES} are possible")]
    NameTooLong {
        /// Bytes of the name.
        bytes: usize,
    },
    /// The name has a character that PostgreSQL cannot store.
    #[error("the session's name has the character U+0000")]
    NameUnstorable,
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl From<sqlx::Error> for AddError {
    fn from(error: sqlx::Error) -> Self {
        Self::Store(error.into())
    }
}

/// Why a session was not removed.
#[derive(Debug, thiserror::Error)]
pub enum RemoveError {
    /// The session does not exist.
    #[error("no such session")]
    Missing,
    /// A job without a final state uses the session.
    #[error("job {job} uses the session")]
    InUse {
        /// Id of one such job.
        job: String,
    },
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl From<sqlx::Error> for RemoveError {
    fn from(error: sqlx::Error) -> Self {
        Self::Store(error.into())
    }
}

/// Adds a session whose bytes are already durable under its id; `max_bytes` is the tenant's quota.
///
/// # Errors
/// [`AddError`].
pub async fn add(
    store: &Store,
    tenant: &Tenant,
    id: &str,
    summary: &SessionSummary,
    max_bytes: i64,
) -> Result<Added, AddError> {
    if summary.name.len() > MAX_NAME_BYTES {
        return Err(AddError::NameTooLong { bytes: summary.name.len() });
    }
    if summary.name.contains('\0') {
        return Err(AddError::NameUnstorable);
    }
    let mut transaction = store.write().await?;
    let stored = tenants::lock(store, &mut transaction, tenant).await?.stored_bytes;
    let row = sqlx::query(AssertSqlSafe(format!(
        "INSERT INTO sessions (id, tenant, sha256, bytes, name, cameras, n_frames, people_max, keypoint_convention,
                               format, warnings, created_at)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, strftime('%Y-%m-%dT%H:%M:%fZ', 'now'))
         ON CONFLICT (tenant, sha256) DO NOTHING
         RETURNING {COLUMNS}"
    )))
    .bind(id)
    .bind(tenant.name())
    .bind(&summary.sha256)
    .bind(summary.bytes as i64)
    .bind(&summary.name)
    .bind(serde_json::to_string(&summary.camera_facts).map_err(StoreError::from)?)
    .bind(summary.frames as i64)
    .bind(summary.people_max as i64)
    .bind(&summary.keypoint_convention)
    .bind(&summary.format)
    .bind(serde_json::to_string(&summary.warnings).map_err(StoreError::from)?)
    .fetch_optional(&mut *transaction)
    .await?;
    let Some(row) = row else {
        let known =
            sqlx::query(AssertSqlSafe(format!("SELECT {COLUMNS} FROM sessions WHERE tenant = $1 AND sha256 = $2")));
        let known = known.bind(tenant.name()).bind(&summary.sha256).fetch_one(&mut *transaction).await?;
        return Ok(Added { session: from_row(&known)?, is_new: false });
    };
    if stored.saturating_add_unsigned(summary.bytes) > max_bytes && !fault("quota.none") {
        return Err(AddError::QuotaExceeded { stored, max: max_bytes }); // the insertion is rolled back
    }
    let session = from_row(&row)?;
    store.commit(transaction).await?;
    Ok(Added { session, is_new: true })
}

/// Returns a tenant's session by id.
///
/// # Errors
/// When the store fails.
pub async fn get(store: &Store, tenant: &Tenant, id: &str) -> Result<Option<StoredSession>, StoreError> {
    let row = sqlx::query(AssertSqlSafe(format!("SELECT {COLUMNS} FROM sessions WHERE id = $1 AND tenant = $2")));
    let row = row.bind(id).bind(tenant.name()).fetch_optional(store.read()).await?;
    row.as_ref().map(from_row).transpose()
}

/// Returns a tenant's session by id, as a transaction sees it.
///
/// # Errors
/// When the store fails.
pub(crate) async fn get_in(
    transaction: &mut WriteTransaction,
    tenant: &Tenant,
    id: &str,
) -> Result<Option<StoredSession>, StoreError> {
    let row = sqlx::query(AssertSqlSafe(format!("SELECT {COLUMNS} FROM sessions WHERE id = $1 AND tenant = $2")));
    let row = row.bind(id).bind(tenant.name()).fetch_optional(&mut **transaction).await?;
    row.as_ref().map(from_row).transpose()
}

/// Returns a tenant's session by the digest of its bytes.
///
/// # Errors
/// When the store fails.
pub async fn get_by_sha256(store: &Store, tenant: &Tenant, sha256: &str) -> Result<Option<StoredSession>, StoreError> {
    let row = sqlx::query(AssertSqlSafe(format!("SELECT {COLUMNS} FROM sessions WHERE tenant = $1 AND sha256 = $2")));
    let row = row.bind(tenant.name()).bind(sha256);
    row.fetch_optional(store.read()).await?.as_ref().map(from_row).transpose()
}

/// Lists a tenant's sessions older than `before` (a `seq`), newest first, at most `max_rows`.
///
/// # Errors
/// When the store fails.
pub async fn list(
    store: &Store,
    tenant: &Tenant,
    before: i64,
    max_rows: i64,
) -> Result<Listed<StoredSession>, StoreError> {
    let rows = sqlx::query(AssertSqlSafe(format!(
        "SELECT {COLUMNS}, octet_length(name) + octet_length(cameras) + octet_length(warnings) AS row_bytes
         FROM sessions WHERE tenant = $1 AND seq < $2 ORDER BY seq DESC LIMIT $3"
    )));
    let rows = rows.bind(tenant.name()).bind(before).bind(max_rows + 1).fetch(store.read());
    read_page(rows, max_rows, from_row).await
}

/// Returns all session ids, sorted.
///
/// # Errors
/// When the store fails.
pub async fn ids(store: &Store) -> Result<Vec<String>, StoreError> {
    Ok(sqlx::query_scalar("SELECT id FROM sessions ORDER BY id").fetch_all(store.read()).await?)
}

/// Removes a tenant's session and its bytes.
///
/// # Errors
/// [`RemoveError::InUse`] while a job without a final state uses it.
pub async fn remove(store: &Store, tenant: &Tenant, id: &str) -> Result<(), RemoveError> {
    match try_to_remove(store, tenant, id).await {
        Err(RemoveError::Store(error)) if error.is_disk_full() => {
            store.release_reserve().await;
            try_to_remove(store, tenant, id).await
        }
        done => done,
    }
}

async fn try_to_remove(store: &Store, tenant: &Tenant, id: &str) -> Result<(), RemoveError> {
    let mut transaction = store.write().await?;
    tenants::lock(store, &mut transaction, tenant).await?;
    let job: Option<String> = sqlx::query_scalar(
        "SELECT id FROM jobs WHERE session_id = $1 AND tenant = $2 AND state IN ('queued', 'running', 'canceling') LIMIT 1",
    )
    .bind(id)
    .bind(tenant.name())
    .fetch_optional(&mut *transaction)
    .await?;
    if let Some(job) = job {
        return Err(RemoveError::InUse { job });
    }
    let deleted = sqlx::query("DELETE FROM sessions WHERE id = $1 AND tenant = $2").bind(id).bind(tenant.name());
    let deleted = deleted.execute(&mut *transaction).await?;
    if deleted.rows_affected() == 0 {
        return Err(RemoveError::Missing);
    }
    failpoint("session.marked");
    if let Err(error) = store.commit(transaction).await
        && get(store, tenant, id).await?.is_some()
    {
        return Err(error.into()); // a session that is gone was removed, and only the answer was lost
    }
    failpoint("session.committed");
    store.remove_files("sessions", id).await;
    failpoint("session.removed");
    store.create_reserve().await;
    Ok(())
}

fn from_row(row: &SqlRow) -> Result<StoredSession, StoreError> {
    let camera_facts: Vec<CameraFacts> = serde_json::from_str(row.try_get("cameras")?)?;
    let summary = SessionSummary {
        name: row.try_get("name")?,
        sha256: row.try_get("sha256")?,
        cameras: camera_facts.len(),
        frames: row.try_get::<i64, _>("n_frames")? as usize,
        people_max: row.try_get::<i64, _>("people_max")? as usize,
        keypoint_convention: row.try_get("keypoint_convention")?,
        format: row.try_get("format")?,
        warnings: serde_json::from_str(row.try_get("warnings")?)?,
        bytes: row.try_get::<i64, _>("bytes")? as u64,
        camera_facts,
    };
    Ok(StoredSession {
        id: row.try_get("id")?,
        summary,
        created_at: row.try_get("created_at")?,
        seq: row.try_get("seq")?,
    })
}
