//! A row of the table of deliveries.

use crate::service::store::Tenant;
use serde::Serialize;

/// Delivery of one event to one receiver.
#[derive(Debug, Clone, Serialize, sqlx::FromRow, utoipa::ToSchema)]
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
    #[sqlx(rename = "job_id")]
    pub(super) job: String,
    #[serde(skip)]
    pub(super) tenant: Tenant,
}
