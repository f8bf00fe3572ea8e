//! The queue at depth: many waiting jobs of many tenants.

use super::*;
use std::time::Instant;

const N_CLAIMANTS: usize = 8;
const N_CLAIMS: usize = 2000;

/// Adds waiting jobs, and tenants without jobs.
async fn fill(store: &Store, n_jobs: i64, n_tenants: i64, n_idle: i64) {
    let mut transaction = store.write().await.unwrap();
    if store.is_shared() {
        // A hundred thousand rows in one statement are not what the triggers and the time limit are for.
        for prepare in ["SET LOCAL statement_timeout = 0", "ALTER TABLE jobs DISABLE TRIGGER jobs_inserted"] {
            sqlx::query(prepare).execute(&mut *transaction).await.unwrap();
        }
    }
    let idle = "WITH RECURSIVE n (i) AS (SELECT CAST(0 AS BIGINT) UNION ALL SELECT i + 1 FROM n WHERE i + 1 < $1)
                INSERT INTO tenants (name) SELECT 'idle' || CAST(i AS TEXT) FROM n";
    sqlx::query(idle).bind(n_idle).execute(&mut *transaction).await.unwrap();
    let jobs = "WITH RECURSIVE n (i) AS (SELECT CAST(0 AS BIGINT) UNION ALL SELECT i + 1 FROM n WHERE i + 1 < $1)
                INSERT INTO jobs (id, tenant, session_id, options, labels, priority, state, created_at)
                SELECT 'job_' || CAST(i AS TEXT), 'tenant' || CAST(i % $2 AS TEXT), 's', '{}', '{}', 0, 'queued',
                       '2026-01-01T00:00:00.000Z' FROM n";
    sqlx::query(jobs).bind(n_jobs).bind(n_tenants).execute(&mut *transaction).await.unwrap();
    if store.is_shared() {
        let counters = "INSERT INTO tenants (name, n_queued) SELECT tenant, count(*) FROM jobs GROUP BY tenant
                        ON CONFLICT (name) DO UPDATE SET n_queued = excluded.n_queued";
        for finish in [
            counters,
            "SELECT 1 FROM add_up_totals()",
            "ALTER TABLE jobs ENABLE TRIGGER jobs_inserted",
            "ANALYZE jobs",
            "ANALYZE tenants",
        ] {
            sqlx::query(finish).execute(&mut *transaction).await.unwrap();
        }
    }
    transaction.commit().await.unwrap();
    store.checkpoint().await.unwrap();
}

fn percentile(seconds: &mut [f64], share: f64) -> f64 {
    seconds.sort_by(f64::total_cmp);
    seconds[((seconds.len() as f64 * share) as usize).min(seconds.len() - 1)] * 1000.0
}

/// Bounds: at least 200 claims a second, the 99th percentile of a claim at most 100 ms, of an acceptance and of the figures
/// 50 ms. `WANDLESS_TEST_JOBS`: number of waiting jobs, 100,000 if missing.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "fills a database: cargo test --release --lib claims_at_depth -- --ignored --nocapture"]
async fn claims_at_depth_are_fast() {
    let n_jobs = std::env::var("WANDLESS_TEST_JOBS").map_or(100_000, |text| text.parse().unwrap());
    for n_tenants in [16, 10_000] {
        let test = TestQueue::new().await;
        fill(&test.queue.store, n_jobs, n_tenants, 10_000).await;
        let start = Instant::now();
        let claimants = (0..N_CLAIMANTS).map(|_| {
            let queue = test.queue.clone();
            tokio::spawn(async move {
                let mut seconds = Vec::new();
                for _ in 0..N_CLAIMS / N_CLAIMANTS {
                    let start = Instant::now();
                    assert!(queue.claim(i64::MAX).await.unwrap().is_some());
                    seconds.push(start.elapsed().as_secs_f64());
                }
                seconds
            })
        });
        let seconds = futures_util::future::join_all(claimants).await;
        let per_s = N_CLAIMS as f64 / start.elapsed().as_secs_f64();
        let mut claims: Vec<f64> = seconds.into_iter().flat_map(Result::unwrap).collect();
        let limits = QueueLimits { total: i64::MAX, tenant: i64::MAX, max_bytes: i64::MAX };
        let (mut accepts, mut figures) = (Vec::new(), Vec::new());
        for _ in 0..200 {
            let start = Instant::now();
            test.queue.enqueue(&new_job(0), None, limits).await.unwrap();
            accepts.push(start.elapsed().as_secs_f64());
            let start = Instant::now();
            test.queue.statistics().await.unwrap();
            figures.push(start.elapsed().as_secs_f64());
        }
        let [claim, accept, figure] = [&mut claims, &mut accepts, &mut figures].map(|s| percentile(s, 0.99));
        println!(
            "{n_jobs} jobs of {n_tenants} tenants: {per_s:.0} claims/s, p99 {claim:.1} ms (p50 {:.1}); accept p99 {accept:.1} ms \
             (p50 {:.1}); figures p99 {figure:.1} ms",
            percentile(&mut claims, 0.5),
            percentile(&mut accepts, 0.5),
        );
        assert!(per_s >= 200.0 && claim <= 100.0 && accept <= 50.0 && figure <= 50.0);
    }
}
