//! Queue statistics for the metrics page.

use super::handle::Queue;
use super::phase::Phase;
use crate::service::store::error::StoreError;
use sqlx::{AssertSqlSafe, Row};

/// Current counts of the queue.
#[derive(Debug, Default)]
pub struct QueueStatistics {
    /// Number of jobs by state; states without jobs are omitted.
    pub by_state: Vec<(String, i64)>,
    /// Age of the oldest queued job, s; 0 if the queue is empty or the clock was set back.
    pub oldest_queued_s: f64,
    /// Ids of the running jobs.
    pub running: Vec<String>,
    /// Pending webhook deliveries.
    pub webhooks_waiting: i64,
}

impl Queue {
    /// Reads the statistics.
    ///
    /// # Errors
    /// When the store fails.
    pub async fn statistics(&self) -> Result<QueueStatistics, StoreError> {
        let oldest: Option<f64> = sqlx::query_scalar(
            // The first queued job of each tenant, by an index.
            "SELECT (julianday('now') - julianday(created_at)) * 86400.0 FROM jobs
             WHERE seq = (SELECT min((SELECT min(seq) FROM jobs WHERE tenant = name AND state = 'queued')) FROM tenants
                          WHERE n_queued > 0)",
        )
        .fetch_optional(self.store.read())
        .await?;
        // Where several processes share the database, each answers for the jobs that it has claimed.
        let boot = if self.store.is_shared() { &*self.store.boot } else { "" };
        let running =
            "SELECT id FROM jobs WHERE state IN ('running', 'canceling') AND ($1 = '' OR boot = $1) ORDER BY id";
        let running = sqlx::query_scalar(running).bind(boot).fetch_all(self.store.read()).await?;
        let waiting = sqlx::query_scalar("SELECT count(*) FROM webhook_deliveries WHERE state = 'waiting'");
        let webhooks_waiting = waiting.fetch_one(self.store.read()).await?;
        let by_state = self.count_by_state().await?;
        Ok(QueueStatistics { by_state, oldest_queued_s: oldest.unwrap_or(0.0).max(0.0), running, webhooks_waiting })
    }

    /// Number of jobs by state, in alphabetical order, without zeros.
    async fn count_by_state(&self) -> Result<Vec<(String, i64)>, StoreError> {
        let mut phases = Phase::ALL;
        phases.sort_by_key(|phase| phase.name());
        let sums = phases.map(|phase| format!("CAST(coalesce(sum(n_{}), 0) AS BIGINT)", phase.name())).join(", ");
        let query = AssertSqlSafe(format!("SELECT {sums} FROM tenants")); // the names are our own
        let row = sqlx::query(query).fetch_one(self.store.read()).await?;
        let mut counts = Vec::new();
        for (column, phase) in phases.iter().enumerate() {
            counts.push((phase.name().to_owned(), row.try_get::<i64, _>(column)?));
        }
        counts.retain(|(_, n_jobs)| *n_jobs > 0);
        Ok(counts)
    }
}
