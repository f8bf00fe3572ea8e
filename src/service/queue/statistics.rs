//! Queue statistics for the metrics page.

use super::class;
use super::handle::Queue;
use super::phase::Phase;
use crate::service::store::Store;
use crate::service::store::error::StoreError;
use crate::service::store::sql::SqlRow;
use crate::service::store::tenants::counters_of_all;
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
        // Where several processes share the database, each answers for the jobs that it has claimed.
        let boot = if self.store.is_shared() { &*self.store.boot } else { "" };
        let running =
            "SELECT id FROM jobs WHERE state IN ('running', 'canceling') AND ($1 = '' OR boot = $1) ORDER BY id";
        let running = sqlx::query_scalar(running).bind(boot).fetch_all(self.store.read()).await?;
        let figures = figures(&self.store);
        let row = sqlx::query(AssertSqlSafe(figures)).fetch_one(self.store.read()).await?; // the text is our own
        Ok(QueueStatistics { running, ..from_row(&row, self.store.is_shared())? })
    }
}

/// One statement for all figures, since a busy server lets each one wait. `n_{state}` and `n_wanted_{class}` are sums
/// over the counters.
fn figures(store: &Store) -> String {
    let mut sums: Vec<String> = Phase::ALL.iter().map(|phase| format!("n_{}", phase.name())).collect();
    let mut figures = vec![
        "(SELECT (julianday('now') - julianday(created_at)) * 86400.0 FROM jobs
          WHERE seq = (SELECT min(seq) FROM jobs WHERE state = 'queued')) AS oldest_queued_s",
        "(SELECT count(*) FROM webhook_deliveries WHERE state = 'waiting') AS webhooks_waiting",
    ];
    if store.is_shared() {
        sums.extend((0..=class::LARGEST).map(wanted));
        figures.extend([DEAD_TUPLES_RATIO, LONGEST_TRANSACTION_S]);
    }
    let sums: Vec<String> =
        sums.iter().map(|sum| format!("CAST(coalesce(sum({sum}), 0) AS BIGINT) AS {sum}")).collect();
    format!("SELECT {}, {} FROM {}", sums.join(", "), figures.join(", "), counters_of_all(store))
}

fn wanted(class: i64) -> String {
    format!("n_wanted_{class}")
}

const DEAD_TUPLES_RATIO: &str = "
    (SELECT CAST(coalesce(max(n_dead_tup / CAST(n_live_tup + n_dead_tup AS DOUBLE PRECISION)), 0) AS DOUBLE PRECISION)
     FROM pg_stat_user_tables WHERE n_live_tup + n_dead_tup > 10000) AS dead_tuples_ratio";

const LONGEST_TRANSACTION_S: &str = "
    (SELECT CAST(coalesce(max(extract(epoch FROM clock_timestamp() - xact_start)), 0) AS DOUBLE PRECISION)
     FROM pg_stat_activity
     WHERE datname = current_database() AND backend_type = 'client backend' AND pid <> pg_backend_pid()) AS longest_transaction_s";

/// The figures of [`figures`]; without the running jobs.
fn from_row(row: &SqlRow, is_shared: bool) -> Result<QueueStatistics, StoreError> {
    let mut by_state = Vec::new();
    for phase in Phase::ALL {
        by_state.push((phase.name().to_owned(), row.try_get::<i64, _>(&*format!("n_{}", phase.name()))?));
    }
    by_state.retain(|(_, n_jobs)| *n_jobs > 0);
    by_state.sort();
    let mut server = ServerStatistics::default();
    if is_shared {
        for class in 0..=class::LARGEST {
            server.work_wanted.push(row.try_get(&*wanted(class))?);
        }
        server.dead_tuples_ratio = row.try_get("dead_tuples_ratio")?;
        server.longest_transaction_s = row.try_get("longest_transaction_s")?;
    }
    let oldest_queued_s = row.try_get::<Option<f64>, _>("oldest_queued_s")?.unwrap_or(0.0).max(0.0);
    let webhooks_waiting = row.try_get("webhooks_waiting")?;
    Ok(QueueStatistics { by_state, oldest_queued_s, running: Vec::new(), webhooks_waiting, server })
}
