//! Results from which a job with corrections continues.

use super::handle::Queue;
use crate::service::store::error::StoreError;

/// Most results that are offered to a job: any of them has what the job needs, if it was solved with the same options.
const MAX_RESULTS: i64 = 8;

impl Queue {
    /// Job and fence of the newest results of a tenant's session.
    ///
    /// # Errors
    /// When the store fails.
    pub async fn results_of_session(&self, tenant: &str, session: &str) -> Result<Vec<(String, i64)>, StoreError> {
        let rows = sqlx::query_as(
            "SELECT id, result_fence FROM jobs WHERE session_id = $1 AND tenant = $2 AND state = 'succeeded'
             ORDER BY seq DESC LIMIT $3",
        );
        Ok(rows.bind(session).bind(tenant).bind(MAX_RESULTS).fetch_all(self.store.read()).await?)
    }
}
