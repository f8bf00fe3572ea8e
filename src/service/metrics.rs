//! What the service counts while it runs, and how Prometheus reads it.

use super::failpoint::fault;
use super::queue::figures::Figures;
use super::store::DiskFigures;
use axum::http::Method;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Counters of one service process.
#[derive(Debug, Default)]
pub struct Metrics {
    requests: Mutex<BTreeMap<RequestKind, Requests>>,
    /// Refusals by the code of their problem document.
    refused: Mutex<BTreeMap<&'static str, u64>>,
    /// Jobs at work and when their child last said that it lives.
    pulses: Mutex<BTreeMap<String, Instant>>,
    /// Wall seconds of every stage, all jobs together.
    stages: Mutex<BTreeMap<String, StageTime>>,
    ended: Mutex<BTreeMap<&'static str, u64>>,
    /// Open connections.
    pub connections: AtomicI64,
    /// Held answers: long polls, event streams, downloads.
    pub held: AtomicI64,
    /// Children that died or had to be killed.
    pub child_deaths: AtomicU64,
    /// Webhook calls that were answered 2xx.
    pub webhooks_delivered: AtomicU64,
    /// Webhook calls that failed.
    pub webhooks_failed: AtomicU64,
}

#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
struct RequestKind {
    method: String,
    route: String,
    status: u16,
}

#[derive(Debug, Default)]
struct Requests {
    count: u64,
    seconds: f64,
    /// Requests within each of [`BUCKETS_S`].
    within: [u64; BUCKETS_S.len()],
}

#[derive(Debug, Default)]
struct StageTime {
    count: u64,
    seconds: f64,
}

/// Upper ends of the histogram of answer times, s.
const BUCKETS_S: [f64; 7] = [0.005, 0.025, 0.1, 0.25, 1.0, 5.0, 30.0];

/// Counts something as held as long as it lives.
pub(super) struct Held(std::sync::Arc<Metrics>);

impl Held {
    pub(super) fn new(metrics: &std::sync::Arc<Metrics>) -> Self {
        metrics.held.fetch_add(1, Ordering::Relaxed);
        Self(metrics.clone())
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        if !fault("leavers.kept") {
            self.0.held.fetch_sub(1, Ordering::Relaxed);
        }
    }
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Metrics {
    /// Counts an answer; `code` is empty unless it is a problem document.
    pub(super) fn note_request(&self, method: &Method, route: &str, status: u16, code: &'static str, seconds: f64) {
        // A method that somebody has invented is no label of ours.
        let known = matches!(method.as_str(), "GET" | "HEAD" | "POST" | "DELETE" | "PUT" | "PATCH" | "OPTIONS");
        let method = if known { method.as_str() } else { "other" };
        let kind = RequestKind { method: method.to_owned(), route: route.to_owned(), status };
        let mut requests = locked(&self.requests);
        let requests = requests.entry(kind).or_default();
        requests.count += 1;
        requests.seconds += seconds;
        for (within, end) in requests.within.iter_mut().zip(BUCKETS_S) {
            *within += u64::from(seconds <= end);
        }
        if !code.is_empty() {
            *locked(&self.refused).entry(code).or_default() += 1;
        }
    }

    /// A job's child lives.
    pub(super) fn note_pulse(&self, job: &str) {
        locked(&self.pulses).insert(job.to_owned(), Instant::now());
    }

    /// A job's claim has ended in `state`.
    pub(super) fn note_end(&self, job: &str, state: &'static str) {
        locked(&self.pulses).remove(job);
        *locked(&self.ended).entry(state).or_default() += 1;
    }

    /// Wall seconds by stage of one attempt.
    pub(super) fn note_stages(&self, seconds: &BTreeMap<String, f64>) {
        let mut stages = locked(&self.stages);
        for (stage, seconds) in seconds {
            let time = stages.entry(stage.clone()).or_default();
            time.count += 1;
            time.seconds += seconds;
        }
    }

    /// Everything in Prometheus's text format (0.0.4).
    pub(super) fn page(&self, queue: &Figures, disk: &DiskFigures) -> String {
        let mut page = Page::default();
        page.head("wandless_jobs", "gauge", "Jobs in the database, by state.");
        for (state, count) in &queue.by_state {
            page.line("wandless_jobs", &[("state", state)], *count as f64);
        }
        let one = [
            ("wandless_queue_age_seconds", "Age of the oldest waiting job.", queue.oldest_queued_s),
            ("wandless_lease_age_seconds", "Longest silence of a job's process.", self.longest_silence_s()),
            (
                "wandless_jobs_running_without_live_worker",
                "Running jobs that no worker of this process knows; must be 0.",
                self.unattended(&queue.running) as f64,
            ),
            ("wandless_webhooks_waiting", "Webhook deliveries not yet made.", queue.webhooks_waiting as f64),
            ("wandless_disk_free_bytes", "Free bytes of the data folder's disk.", disk.free_bytes as f64),
            ("wandless_database_bytes", "Size of the database file.", disk.database_bytes as f64),
            ("wandless_wal_bytes", "Size of the write-ahead log.", disk.wal_bytes as f64),
            ("wandless_connections", "Open connections.", self.connections.load(Ordering::Relaxed) as f64),
            (
                "wandless_held_answers",
                "Open long polls, streams and downloads.",
                self.held.load(Ordering::Relaxed) as f64,
            ),
        ];
        for (name, help, value) in one {
            page.head(name, "gauge", help);
            page.line::<&str>(name, &[], value);
        }
        let counters = [
            ("wandless_child_deaths_total", "Job processes that died or were killed.", &self.child_deaths),
            ("wandless_webhooks_delivered_total", "Webhooks answered 2xx.", &self.webhooks_delivered),
            ("wandless_webhooks_failed_total", "Webhook calls that failed.", &self.webhooks_failed),
        ];
        for (name, help, value) in counters {
            page.head(name, "counter", help);
            page.line::<&str>(name, &[], value.load(Ordering::Relaxed) as f64);
        }
        page.head("wandless_claims_ended_total", "counter", "Ends of claims, by the state they led to.");
        for (state, count) in &*locked(&self.ended) {
            page.line("wandless_claims_ended_total", &[("state", state)], *count as f64);
        }
        page.head("wandless_stage_seconds", "summary", "Wall seconds by stage.");
        for (stage, time) in &*locked(&self.stages) {
            page.line("wandless_stage_seconds_sum", &[("stage", stage)], time.seconds);
            page.line("wandless_stage_seconds_count", &[("stage", stage)], time.count as f64);
        }
        page.head("wandless_refused_total", "counter", "Problem documents, by code.");
        for (code, count) in &*locked(&self.refused) {
            page.line("wandless_refused_total", &[("code", code)], *count as f64);
        }
        self.add_requests(&mut page);
        page.text
    }

    fn add_requests(&self, page: &mut Page) {
        page.head("wandless_request_seconds", "histogram", "Time to the head of the answer.");
        for (kind, requests) in &*locked(&self.requests) {
            let status = kind.status.to_string();
            let labels = |le: &'static str| -> Vec<(&'static str, String)> {
                let mut labels =
                    vec![("method", kind.method.clone()), ("route", kind.route.clone()), ("status", status.clone())];
                labels.extend((!le.is_empty()).then(|| ("le", le.to_owned())));
                labels
            };
            for (end, within) in BUCKETS_S.iter().zip(requests.within) {
                let mut labels = labels("");
                labels.push(("le", end.to_string()));
                page.line("wandless_request_seconds_bucket", &labels, within as f64);
            }
            page.line("wandless_request_seconds_bucket", &labels("+Inf"), requests.count as f64);
            page.line("wandless_request_seconds_sum", &labels(""), requests.seconds);
            page.line("wandless_request_seconds_count", &labels(""), requests.count as f64);
        }
    }

    fn longest_silence_s(&self) -> f64 {
        let pulses = locked(&self.pulses);
        pulses.values().map(|heard| heard.elapsed().as_secs_f64()).fold(0.0, f64::max)
    }

    fn unattended(&self, running: &[String]) -> usize {
        let pulses = locked(&self.pulses);
        running.iter().filter(|job| !pulses.contains_key(*job)).count()
    }
}

#[derive(Default)]
struct Page {
    text: String,
}

impl Page {
    fn head(&mut self, name: &str, kind: &str, help: &str) {
        self.text.push_str(&format!("# HELP {name} {help}\n# TYPE {name} {kind}\n"));
    }

    fn line<V: AsRef<str>>(&mut self, name: &str, labels: &[(&str, V)], value: f64) {
        let escaped = |value: &str| value.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n");
        let labels: Vec<String> =
            labels.iter().map(|(key, value)| format!("{key}=\"{}\"", escaped(value.as_ref()))).collect();
        let labels = if labels.is_empty() { String::new() } else { format!("{{{}}}", labels.join(",")) };
        let _ = writeln!(self.text, "{name}{labels} {value}"); // a string takes whatever it is given
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_holds_what_was_counted() {
        let metrics = Metrics::default();
        metrics.note_request(&Method::GET, "/v1/jobs/{id}", 404, "not_found", 0.02);
        metrics.note_pulse("job_1");
        metrics.note_end("job_2", "succeeded");
        metrics.note_stages(&BTreeMap::from([("cameras".to_owned(), 2.5)]));
        let queue = Figures { running: vec!["job_1".to_owned(), "job_3".to_owned()], ..Figures::default() };
        let page = metrics.page(&queue, &DiskFigures::default());
        for line in [
            "wandless_jobs_running_without_live_worker 1",
            "wandless_refused_total{code=\"not_found\"} 1",
            "wandless_stage_seconds_sum{stage=\"cameras\"} 2.5",
            "wandless_claims_ended_total{state=\"succeeded\"} 1",
            "wandless_request_seconds_bucket{method=\"GET\",route=\"/v1/jobs/{id}\",status=\"404\",le=\"0.025\"} 1",
            "wandless_request_seconds_bucket{method=\"GET\",route=\"/v1/jobs/{id}\",status=\"404\",le=\"0.005\"} 0",
        ] {
            assert!(page.lines().any(|l| l == line), "{line}\n{page}");
        }
    }
}
