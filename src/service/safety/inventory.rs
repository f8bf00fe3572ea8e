//! The files that a database refers to.

use crate::service::store::StoreError;
use serde::{Deserialize, Serialize};
use sqlx::sqlite::SqliteRow;
use sqlx::{FromRow, Row, SqlitePool};

/// One file below a data folder.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub(super) struct NamedFile {
    /// Path below the data folder, with `/`.
    pub(super) name: String,
    /// SHA-256 of the published file, hex.
    pub(super) sha256: String,
    /// Id of the owner, `session_…` or `job_…`, or `bodies`; empty for the database itself.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub(super) owner: String,
}

impl FromRow<'_, SqliteRow> for NamedFile {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        Ok(Self { name: row.try_get("name")?, sha256: row.try_get("sha256")?, owner: row.try_get("owner")? })
    }
}

/// Lists all uploads and published files, sorted by name.
pub(super) async fn named_files(database: &SqlitePool) -> Result<Vec<NamedFile>, StoreError> {
    let rows = sqlx::query_as(
        "SELECT id AS owner, 'sessions/' || id AS name, sha256 FROM sessions
         UNION ALL
         SELECT jobs.id, 'results/' || jobs.id || '/' || result_fence || '/' || name, sha256
         FROM artifacts JOIN jobs ON jobs.id = artifacts.job_id
         ORDER BY name",
    );
    Ok(rows.fetch_all(database).await?)
}
