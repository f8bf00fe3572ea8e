//! A row of the table of deliveries.

use crate::service::store::Tenant;
use crate::service::store::sql::SqlRow;
use serde::Serialize;
use sqlx::{FromRow, Row};

/// Delivery of one event to one receiver.
#[derive(Debug, Clone, Serialize, utoipa::ToSchema)]
pub struct Delivery {
    /// Value of the header `webhook-id`.
    pub id: String,
    /// Event type: `job.succeeded`, `job.failed`, `job.canceled` or `job.dead`.
    #[schema(pattern = r"^job\.(succeeded|failed|canceled|dead)$")]
    pub event: String,
    /// URL of the receiver.
    pub url: String,
    /// `waiting`, `delivered` or `failed`.
    #[schema(pattern = "^(waiting|delivered|failed)$")]
    pub state: String,
    /// Number of calls made.
    #[schema(minimum = 0)]
    pub tries: i64,
    /// HTTP status of the last call.
    #[schema(required)]
    pub last_status: Option<i64>,
    /// Why the last call failed.
    #[schema(required)]
    pub last_error: Option<String>,
    /// Time of creation; UTC, RFC 3339.
    #[schema(format = DateTime)]
    pub created_at: String,
    /// Time of the last change; UTC, RFC 3339.
    #[schema(format = DateTime)]
    pub updated_at: String,
    #[serde(skip)]
    pub(super) job: String,
    #[serde(skip)]
    pub(super) tenant: Tenant,
}

impl FromRow<'_, SqlRow> for Delivery {
    fn from_row(row: &SqlRow) -> sqlx::Result<Self> {
        Ok(Self {
            id: row.try_get("id")?,
            event: row.try_get("event")?,
            url: row.try_get("url")?,
            state: row.try_get("state")?,
            tries: row.try_get("tries")?,
            last_status: row.try_get("last_status")?,
            last_error: row.try_get("last_error")?,
            created_at: row.try_get("created_at")?,
            updated_at: row.try_get("updated_at")?,
            job: row.try_get("job_id")?,
            tenant: row.try_get("tenant")?,
        })
    }
}
