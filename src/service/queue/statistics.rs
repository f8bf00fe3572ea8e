//! Queue statistics for the metrics page.

use super::class;
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
    /// Figures of a database that several processes share.
    pub server: ServerStatistics,
}

/// Figures of a database that several processes share; empty with SQLite.
#[derive(Debug, Default)]
pub struct ServerStatistics {
    /// Jobs without a final state by class.
    pub work_wanted: Vec<i64>,
    /// Largest share of dead rows among the tables with more than ten thousand rows.
    pub dead_tuples_ratio: f64,
    /// Age of the oldest open transaction, s.
    pub longest_transaction_s: f64,
}

impl Queue {
    /// Reads the statistics.
    ///
    /// # Errors
    /// When the store fails.
    pub async fn statistics(&self) -> Result<QueueStatistics, StoreError> {
        let oldest: Option<f64> = sqlx::query_scalar(
            "SELECT (julianday('now') - julianday(created_at)) * 86400.0 FROM jobs
             WHERE seq = (SELECT min(seq) FROM jobs WHERE state = 'queued')",
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
        let (by_state, work_wanted) = self.count_jobs().await?;
        let server = self.server_statistics(work_wanted).await?;
        let oldest_queued_s = oldest.unwrap_or(0.0).max(0.0);
        Ok(QueueStatistics { by_state, oldest_queued_s, running, webhooks_waiting, server })
    }

    /// Number of jobs by state, in alphabetical order, without zeros; with PostgreSQL also those without a final state by class.
    async fn count_jobs(&self) -> Result<(Vec<(String, i64)>, Vec<i64>), StoreError> {
        let mut phases = Phase::ALL;
        phases.sort_by_key(|phase| phase.name());
        let mut columns: Vec<String> = phases.iter().map(|phase| format!("n_{}", phase.name())).collect();
        if self.store.is_shared() {
            columns.extend((0..=class::LARGEST).map(|class| format!("n_wanted_{class}")));
        }
        let sums: Vec<String> =
            columns.iter().map(|column| format!("CAST(coalesce(sum({column}), 0) AS BIGINT)")).collect();
        let query = AssertSqlSafe(format!("SELECT {} FROM tenants", sums.join(", "))); // the names are our own
        let row = sqlx::query(query).fetch_one(self.store.read()).await?;
        let counts = (0..columns.len()).map(|column| row.try_get::<i64, _>(column)).collect::<Result<Vec<_>, _>>()?;
        let (of_states, wanted) = counts.split_at(phases.len());
        let by_state = phases.iter().map(|phase| phase.name().to_owned()).zip(of_states.iter().copied());
        Ok((by_state.filter(|(_, n_jobs)| *n_jobs > 0).collect(), wanted.to_vec()))
    }

    async fn server_statistics(&self, work_wanted: Vec<i64>) -> Result<ServerStatistics, StoreError> {
        if !self.store.is_shared() {
            return Ok(ServerStatistics::default());
        }
        let dead = "SELECT CAST(coalesce(max(n_dead_tup / CAST(n_live_tup + n_dead_tup AS DOUBLE PRECISION)), 0) AS DOUBLE PRECISION)
                    FROM pg_stat_user_tables WHERE n_live_tup + n_dead_tup > 10000";
        let transaction =
            "SELECT CAST(coalesce(max(extract(epoch FROM clock_timestamp() - xact_start)), 0) AS DOUBLE PRECISION)
             FROM pg_stat_activity
             WHERE datname = current_database() AND backend_type = 'client backend' AND pid <> pg_backend_pid()";
        Ok(ServerStatistics {
            work_wanted,
            dead_tuples_ratio: sqlx::query_scalar(dead).fetch_one(self.store.read()).await?,
            longest_transaction_s: sqlx::query_scalar(transaction).fetch_one(self.store.read()).await?,
        })
    }
}
