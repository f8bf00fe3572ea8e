//! Replacement of a published result by one with further formats.

use super::handle::Queue;
use crate::service::failpoint::failpoint;
use crate::service::store::artifacts::{self, Artifact};
use crate::service::store::error::StoreError;
use crate::service::store::tenants::Tenant;
use sqlx::Row;

/// A published result that is to get further formats.
#[derive(Debug)]
pub struct Extension {
    /// Fence of the published result.
    pub published: i64,
    /// Files of the published result.
    pub files: Vec<Artifact>,
    /// Fence of the result with further formats, which no other attempt has: processes that extend one result at the same time
    /// write different folders and objects, and a failed attempt is not in the way of the next one.
    pub fence: i64,
}

impl Queue {
    /// Takes the next fence of a succeeded job for a result with further formats; `None` if there is none of that id. The
    /// document of the job, and so its version, stays the same.
    ///
    /// # Errors
    /// When the store fails; at most a number is lost then.
    pub async fn begin_extension(&self, tenant: &Tenant, job: &str) -> Result<Option<Extension>, StoreError> {
        let mut transaction = self.store.write().await?;
        let take = sqlx::query(
            "UPDATE jobs SET fence = fence + 1 WHERE id = $1 AND tenant = $2 AND state = 'succeeded'
             RETURNING fence, result_fence",
        );
        let taken = take.bind(job).bind(tenant.name()).fetch_optional(&mut *transaction).await?;
        let Some(row) = taken else { return Ok(None) };
        // Under the lock of the row: the files are those of the fence.
        let files = artifacts::list_locked(&mut transaction, job).await?;
        transaction.commit().await?;
        Ok(Some(Extension { published: row.try_get("result_fence")?, files, fence: row.try_get("fence")? }))
    }

    /// Refers a succeeded job to the files of an extension. The folder of the result before stays until the next start:
    /// downloads and backups that have begun read it, and its files share their bytes with those of the new folder.
    /// Returns false, without a change, if the job was deleted or its result was replaced meanwhile.
    ///
    /// # Errors
    /// When the store fails; nothing is recorded then.
    pub async fn replace_result(
        &self,
        tenant: &Tenant,
        job: &str,
        extension: &Extension,
        files: &[Artifact],
    ) -> Result<bool, StoreError> {
        let bytes: u64 = files.iter().map(|file| file.bytes).sum();
        let mut transaction = self.store.write().await?;
        let replaced = sqlx::query(
            "UPDATE jobs SET result_fence = $1, version = version + 1, result_bytes = $2
             WHERE id = $3 AND tenant = $4 AND state = 'succeeded' AND result_fence = $5",
        )
        .bind(extension.fence)
        .bind(bytes as i64)
        .bind(job)
        .bind(tenant.name())
        .bind(extension.published)
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
