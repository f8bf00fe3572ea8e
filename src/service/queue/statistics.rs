//! Queue statistics for the metrics page.

use super::handle::Queue;
use crate::service::store::error::StoreError;

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
        let by_state = sqlx::query_as(
            "SELECT state, sum(jobs) FROM job_counts GROUP BY state HAVING sum(jobs) > 0 ORDER BY state",
        );
        let by_state = by_state.fetch_all(self.store.read()).await?;
        let oldest: Option<f64> = sqlx::query_scalar(
            // The first queued job of each tenant, by an index.
            "SELECT (julianday('now') - julianday(min(created_at))) * 86400.0 FROM jobs
             WHERE seq IN (SELECT (SELECT min(seq) FROM jobs WHERE tenant = name AND state = 'queued') FROM tenants)",
        )
        .fetch_one(self.store.read())
        .await?;
        let running = sqlx::query_scalar("SELECT id FROM jobs WHERE state IN ('running', 'canceling') ORDER BY id");
        let running = running.fetch_all(self.store.read()).await?;
        let waiting = sqlx::query_scalar("SELECT count(*) FROM webhook_deliveries WHERE state = 'waiting'");
        let webhooks_waiting = waiting.fetch_one(self.store.read()).await?;
        Ok(QueueStatistics { by_state, oldest_queued_s: oldest.unwrap_or(0.0).max(0.0), running, webhooks_waiting })
    }
}
