//! Rows of the published files of a job, which are served by their digest.

use super::database::{Store, WriteTransaction};
use super::error::StoreError;
pub use super::published::{Artifact, FileDigest, digest_file, digest_of, scan};
use super::sql::{ROWS_IN_ONE_STATEMENT, insert_rows};

/// Inserts the rows of a job that is about to succeed.
///
/// # Errors
/// When the database fails.
pub async fn insert(transaction: &mut WriteTransaction, job: &str, artifacts: &[Artifact]) -> Result<(), StoreError> {
    for artifacts in artifacts.chunks(ROWS_IN_ONE_STATEMENT) {
        let columns = ["job_id", "name", "media_type", "bytes", "sha256"];
        let mut insert = insert_rows("artifacts", &columns, artifacts.len());
        for Artifact { name, media_type, bytes, sha256 } in artifacts {
            insert = insert.bind(job).bind(name).bind(media_type).bind(*bytes as i64).bind(sha256);
        }
        insert.execute(&mut **transaction).await?;
    }
    Ok(())
}

/// Returns one file of a job by name.
///
/// # Errors
/// When the store fails.
pub async fn get(store: &Store, job: &str, name: &str) -> Result<Option<Artifact>, StoreError> {
    let row = sqlx::query_as("SELECT name, media_type, bytes, sha256 FROM artifacts WHERE job_id = $1 AND name = $2")
        .bind(job)
        .bind(name);
    Ok(row.fetch_optional(store.read()).await?)
}

const ALL_FILES: &str = "SELECT name, media_type, bytes, sha256 FROM artifacts WHERE job_id = $1 ORDER BY name";

/// Returns all files of a job by name.
///
/// # Errors
/// When the store fails.
pub async fn list(store: &Store, job: &str) -> Result<Vec<Artifact>, StoreError> {
    Ok(sqlx::query_as(ALL_FILES).bind(job).fetch_all(store.read()).await?)
}

/// Returns all files of a job whose row the transaction has locked.
///
/// # Errors
/// When the store fails.
pub async fn list_locked(transaction: &mut WriteTransaction, job: &str) -> Result<Vec<Artifact>, StoreError> {
    Ok(sqlx::query_as(ALL_FILES).bind(job).fetch_all(&mut **transaction).await?)
}
