//! Replacement of a published result by one with further formats.

use super::handle::Queue;
use crate::service::failpoint::failpoint;
use crate::service::store::artifacts::{self, Artifact};
use crate::service::store::error::StoreError;
use crate::service::store::tenants::Tenant;

impl Queue {
    /// Refers a succeeded job to the files in the folder of `fence + 1` instead of that of `fence`, which stays until the next
    /// start: downloads and backups that have begun read it, and its files share their bytes with those of the new folder.
    /// Returns false, without a change, if the job was deleted or its result was replaced meanwhile.
    ///
    /// # Errors
    /// When the store fails; nothing is recorded then.
    pub async fn replace_result(
        &self,
        tenant: &Tenant,
        job: &str,
        fence: i64,
        files: &[Artifact],
    ) -> Result<bool, StoreError> {
        let bytes: u64 = files.iter().map(|file| file.bytes).sum();
        let mut transaction = self.store.write().await?;
        let replaced = sqlx::query(
            "UPDATE jobs SET fence = $1 + 1, result_fence = $1 + 1, version = version + 1, result_bytes = $2
             WHERE id = $3 AND tenant = $4 AND state = 'succeeded' AND result_fence = $1",
        )
        .bind(fence)
        .bind(bytes as i64)
        .bind(job)
        .bind(tenant.name())
        .execute(&mut *transaction)
        .await?;
        if replaced.rows_affected() == 0 {
            return Ok(false);
        }
        sqlx::query("DELETE FROM artifacts WHERE job_id = $1").bind(job).execute(&mut *transaction).await?;
        artifacts::insert(&mut transaction, job, files).await?;
        failpoint("exports.written");
        transaction.commit().await?;
        failpoint("exports.committed");
        self.announce_to_all(job, false);
        Ok(true)
    }
}
