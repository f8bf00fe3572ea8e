//! Metrics of one service process, as OpenMetrics text for Prometheus.

use super::failpoint::fault;
use super::queue::statistics::QueueStatistics;
use super::store::DiskUsage;
use axum::http::Method;
use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::{Metric, Registry};
use std::collections::BTreeMap;
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
#[cfg(feature = "scale")]
use std::time::Duration;
use std::time::Instant;

/// Media type of the metrics page.
pub(super) const MEDIA_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Upper bounds of the histogram of response times, s.
const BUCKETS_S: [f64; 7] = [0.005, 0.025, 0.1, 0.25, 1.0, 5.0, 30.0];

/// `N` labels, each a name and a value.
type Labels<const N: usize> = [(&'static str, String); N];
/// Histograms by `N` labels.
type Histograms<const N: usize> = Family<Labels<N>, Histogram, fn() -> Histogram>;
type Seconds = Gauge<f64, AtomicU64>;

/// Metrics of one service process. Gauges of the queue and of the disk are set when the page is written.
#[derive(Debug)]
pub struct Metrics {
    registry: Registry,
    /// Jobs with a running child process, and when the process last sent a message.
    heartbeats: Mutex<BTreeMap<String, Instant>>,
    jobs: Family<Labels<1>, Gauge>,
    queue_age_s: Seconds,
    silence_s: Seconds,
    unattended_jobs: Gauge,
    webhooks_waiting: Gauge,
    work_wanted: Family<Labels<1>, Gauge>,
    is_leader: Gauge,
    beat_age_s: Seconds,
    dead_tuples: Seconds,
    longest_transaction_s: Seconds,
    disk_free_bytes: Gauge,
    database_bytes: Gauge,
    wal_bytes: Gauge,
    /// Open connections.
    pub connections: Gauge,
    /// Open long polls, event streams and downloads.
    pub held: Gauge,
    /// Child processes that crashed or were killed.
    pub child_crashes: Counter,
    /// Webhook calls that were answered 2xx.
    pub webhooks_delivered: Counter,
    /// Webhook calls that failed.
    pub webhooks_failed: Counter,
    ended: Family<Labels<1>, Counter>,
    refused: Family<Labels<1>, Counter>,
    stages: Histograms<1>,
    requests: Histograms<3>,
}

impl Default for Metrics {
    fn default() -> Self {
        let mut registry = Registry::with_prefix("wandless");
        let r = &mut registry;
        let waiting = "Webhook deliveries not yet made";
        Self {
            heartbeats: Mutex::default(),
            jobs: add(r, "jobs", "Jobs in the database, by state", Family::default()),
            queue_age_s: add(r, "queue_age_seconds", "Age of the oldest waiting job", Gauge::default()),
            silence_s: add(r, "lease_age_seconds", "Longest silence of a job's process", Gauge::default()),
            unattended_jobs: add(
                r,
                "jobs_running_without_live_worker",
                "Running jobs without a worker in this process; must be 0",
                Gauge::default(),
            ),
            webhooks_waiting: add(r, "webhooks_waiting", waiting, Gauge::default()),
            work_wanted: add(r, "work_wanted", "Jobs without a final state, by class of memory", Family::default()),
            is_leader: add(
                r,
                "leader",
                "Whether this process is the leader; the sum over all must be 1",
                Gauge::default(),
            ),
            beat_age_s: add(r, "beat_age_seconds", "Longest silence of a worker, seen by the leader", Gauge::default()),
            dead_tuples: add(r, "dead_tuples_ratio", "Largest share of dead rows of a table", Gauge::default()),
            longest_transaction_s: add(
                r,
                "longest_transaction_seconds",
                "Age of the oldest open transaction of the database",
                Gauge::default(),
            ),
            disk_free_bytes: add(r, "disk_free_bytes", "Free bytes of the data folder's disk", Gauge::default()),
            database_bytes: add(r, "database_bytes", "Size of the database file", Gauge::default()),
            wal_bytes: add(r, "wal_bytes", "Size of the write-ahead log", Gauge::default()),
            connections: add(r, "connections", "Open connections", Gauge::default()),
            held: add(r, "held_answers", "Open long polls, streams and downloads", Gauge::default()),
            child_crashes: add(r, "child_crashes", "Job processes that crashed or were killed", Counter::default()),
            webhooks_delivered: add(r, "webhooks_delivered", "Webhooks answered 2xx", Counter::default()),
            webhooks_failed: add(r, "webhooks_failed", "Webhook calls that failed", Counter::default()),
            ended: add(r, "claims_ended", "Ended claims, by the resulting job state", Family::default()),
            refused: add(r, "refused", "Problem documents, by code", Family::default()),
            stages: add(r, "stage_seconds", "Wall seconds by stage", Family::new_with_constructor(without_buckets)),
            requests: add(
                r,
                "request_seconds",
                "Time to the head of the answer",
                Family::new_with_constructor(with_buckets),
            ),
            registry,
        }
    }
}

/// Registers a metric and returns it.
fn add<M: Metric + Clone>(registry: &mut Registry, name: &str, help: &str, metric: M) -> M {
    registry.register(name, help, metric.clone());
    metric
}

fn with_buckets() -> Histogram {
    Histogram::new(BUCKETS_S)
}

fn without_buckets() -> Histogram {
    Histogram::new([])
}

/// Counts one held answer as long as it exists.
pub(super) struct Held(Arc<Metrics>);

impl Held {
    pub(super) fn new(metrics: &Arc<Metrics>) -> Self {
        metrics.held.inc();
        Self(metrics.clone())
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        if !fault("leavers.kept") {
            self.0.held.dec();
        }
    }
}

impl Metrics {
    /// Counts a response; `code` is the code of its problem document, empty for other responses.
    pub(super) fn note_request(&self, method: &Method, route: &str, status: u16, code: &'static str, seconds: f64) {
        // Invented methods share one label, so that clients cannot create any number of time series.
        let known = matches!(method.as_str(), "GET" | "HEAD" | "POST" | "DELETE" | "PUT" | "PATCH" | "OPTIONS");
        let method = if known { method.as_str() } else { "other" };
        let labels = [("method", method.to_owned()), ("route", route.to_owned()), ("status", status.to_string())];
        self.requests.get_or_create(&labels).observe(seconds);
        if !code.is_empty() {
            self.refused.get_or_create(&[("code", code.to_owned())]).inc();
        }
    }

    /// Notes that a job's child process is alive.
    pub(super) fn note_heartbeat(&self, job: &str) {
        self.heartbeats().insert(job.to_owned(), Instant::now());
    }

    /// Notes for how long the most silent worker has sent no beat; called by the leader.
    #[cfg(feature = "scale")]
    pub(super) fn note_beats(&self, silence: Duration) {
        self.beat_age_s.set(silence.as_secs_f64());
    }

    /// Counts a claim that ended in `state`.
    pub(super) fn note_end(&self, job: &str, state: &'static str) {
        self.heartbeats().remove(job);
        self.ended.get_or_create(&[("state", state.to_owned())]).inc();
    }

    /// Adds the wall seconds by stage of one attempt.
    pub(super) fn note_stages(&self, seconds: &BTreeMap<String, f64>) {
        for (stage, seconds) in seconds {
            self.stages.get_or_create(&[("stage", stage.clone())]).observe(*seconds);
        }
    }

    /// Writes all metrics as OpenMetrics text.
    pub(super) fn page(&self, queue: &QueueStatistics, disk: &DiskUsage, is_leader: bool) -> String {
        self.jobs.clear();
        for (state, count) in &queue.by_state {
            self.jobs.get_or_create(&[("state", state.clone())]).set(*count);
        }
        let heartbeats = self.heartbeats().clone();
        let silence_s = heartbeats.values().map(|heard| heard.elapsed().as_secs_f64()).fold(0.0, f64::max);
        self.silence_s.set(silence_s);
        self.unattended_jobs.set(queue.running.iter().filter(|job| !heartbeats.contains_key(*job)).count() as i64);
        self.queue_age_s.set(queue.oldest_queued_s);
        self.webhooks_waiting.set(queue.webhooks_waiting);
        self.is_leader.set(i64::from(is_leader));
        if !is_leader {
            self.beat_age_s.set(0.0);
        }
        for (class, wanted) in queue.server.work_wanted.iter().enumerate() {
            self.work_wanted.get_or_create(&[("class", class.to_string())]).set(*wanted);
        }
        self.dead_tuples.set(queue.server.dead_tuples_ratio);
        self.longest_transaction_s.set(queue.server.longest_transaction_s);
        self.disk_free_bytes.set(disk.free_bytes as i64);
        self.database_bytes.set(disk.database_bytes as i64);
        self.wal_bytes.set(disk.wal_bytes as i64);
        let mut page = String::new();
        let _ = encode(&mut page, &self.registry); // writing to a string cannot fail
        page
    }

    fn heartbeats(&self) -> MutexGuard<'_, BTreeMap<String, Instant>> {
        self.heartbeats.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::queue::statistics::ServerStatistics;

    #[test]
    fn page_contains_all_counts() {
        let metrics = Metrics::default();
        metrics.note_request(&Method::GET, "/v1/jobs/{id}", 404, "not_found", 0.02);
        metrics.note_heartbeat("job_1");
        metrics.note_end("job_2", "succeeded");
        metrics.note_stages(&BTreeMap::from([("cameras".to_owned(), 2.5)]));
        let by_state = vec![("running".to_owned(), 2)];
        let running = vec!["job_1".to_owned(), "job_3".to_owned()];
        let server = ServerStatistics { work_wanted: vec![0, 7], ..ServerStatistics::default() };
        let queue = QueueStatistics { by_state, running, server, ..QueueStatistics::default() };
        let page = metrics.page(&queue, &DiskUsage::default(), true);
        for line in [
            "# HELP wandless_jobs Jobs in the database, by state.",
            "wandless_jobs{state=\"running\"} 2",
            "wandless_jobs_running_without_live_worker 1",
            "wandless_child_crashes_total 0",
            "wandless_leader 1",
            "wandless_work_wanted{class=\"1\"} 7",
            "wandless_refused_total{code=\"not_found\"} 1",
            "wandless_stage_seconds_sum{stage=\"cameras\"} 2.5",
            "wandless_claims_ended_total{state=\"succeeded\"} 1",
            "wandless_request_seconds_bucket{le=\"0.025\",method=\"GET\",route=\"/v1/jobs/{id}\",status=\"404\"} 1",
            "wandless_request_seconds_bucket{le=\"0.005\",method=\"GET\",route=\"/v1/jobs/{id}\",status=\"404\"} 0",
        ] {
            assert!(page.lines().any(|l| l == line), "{line}\n{page}");
        }
    }
}
