//! What an operator may set; every default is visible here, with its reason.
//!
//! The same names stand in the settings file (TOML), in the environment (`WANDLESS_LIMITS__MAX_UPLOAD_BYTES`) and behind
//! `--set limits.max_upload_bytes=…`; [`layers`] puts them together. Durations are seconds there.

pub mod layers;
mod seconds;

use serde::{Deserialize, Serialize};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

/// Where the service listens unless told otherwise: the loopback only, where no key is asked for until one was made.
pub const DEFAULT_LISTEN: &str = "127.0.0.1:8700";

/// Where the service keeps its data unless told otherwise.
pub const DEFAULT_DATA: &str = "./wandless-data";

/// Everything the service is told at its start.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Folder of the database, the uploads and the results; one service at a time owns it.
    pub data: PathBuf,
    /// Address to listen on; port 0 takes a free one.
    pub listen: SocketAddr,
    /// The binary started as `run-job` for each job; the running one unless told otherwise.
    #[serde(skip)]
    pub program: PathBuf,
    /// What uploads and requests may cost.
    pub limits: RequestLimits,
    /// What one tenant may hold and use.
    pub tenants: TenantLimits,
    /// How jobs are run.
    pub jobs: JobSettings,
    /// Who is told of a job's end, and how.
    pub webhooks: WebhookSettings,
    /// What is removed by itself.
    pub retention: Retention,
    /// Origins of other sites whose pages may call the API (`https://studio.example`); none unless listed.
    pub cors_origins: Vec<String>,
    /// How long a stop waits for open downloads before it cuts them.
    #[serde(rename = "drain_limit_s", with = "seconds")]
    pub drain_limit: Duration,
}

/// Bounds on what one client can hold or fill.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RequestLimits {
    /// Largest upload, bytes as sent.
    pub max_upload_bytes: u64,
    /// Largest JSON request that is no upload, bytes.
    pub max_json_bytes: u64,
    /// A request's head must have come within this time; idle connections end after it too.
    #[serde(rename = "header_timeout_s", with = "seconds")]
    pub header_timeout: Duration,
    /// An upload that sends nothing for so long is cut.
    #[serde(rename = "body_idle_timeout_s", with = "seconds")]
    pub body_idle_timeout: Duration,
    /// A connection without a request at work is kept for the next one so long.
    #[serde(rename = "keep_alive_s", with = "seconds")]
    pub keep_alive: Duration,
    /// An upload must send at least this much in each `body_window`.
    pub body_min_bytes: u64,
    /// See `body_min_bytes`.
    #[serde(rename = "body_window_s", with = "seconds")]
    pub body_window: Duration,
    /// A client that takes nothing of an answer for so long is cut.
    #[serde(rename = "write_timeout_s", with = "seconds")]
    pub write_timeout: Duration,
    /// Open connections; more wait in the kernel's queue.
    pub max_connections: usize,
    /// Longest `?wait=`.
    #[serde(rename = "max_wait_s", with = "seconds")]
    pub max_wait: Duration,
    /// Jobs of everybody that may wait; more are answered 429.
    pub max_queued: i64,
    /// Uploads are refused with 507 while the disk has less than this left.
    pub min_free_bytes: u64,
    /// Wrong keys that one address may try a second before it is answered 429.
    pub bad_keys_per_s: f64,
}

/// Bounds on one tenant.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TenantLimits {
    /// Uploads and results together, bytes.
    pub max_bytes: i64,
    /// Jobs that may wait.
    pub max_queued: i64,
    /// Jobs at work at the same time.
    pub max_running: i64,
    /// Requests a second; a burst may be twice as much. Only where keys are asked for.
    pub requests_per_s: f64,
}

/// How jobs are run.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct JobSettings {
    /// Jobs at the same time.
    pub concurrent: usize,
    /// Solver threads of one job; 0 takes all cores.
    pub threads: usize,
    /// Deaths of its own child after which a job is `dead`.
    pub max_deaths: u32,
    /// Between the polite and the forced end of a child.
    #[serde(rename = "kill_grace_s", with = "seconds")]
    pub kill_grace: Duration,
    /// A child says at least once a second that it lives; one silent for so long is killed.
    #[serde(rename = "silence_limit_s", with = "seconds")]
    pub silence_limit: Duration,
    /// A child that makes no progress for so long is killed.
    #[serde(rename = "stall_limit_s", with = "seconds")]
    pub stall_limit: Duration,
    /// Address space of one child, bytes: a job that needs more fails with `out_of_memory`. 0 takes three quarters of the
    /// machine's memory (or of the control group's), shared between the concurrent jobs.
    pub memory_bytes: u64,
}

/// Who is told of a job's end, and how.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WebhookSettings {
    /// Networks that webhooks may call although they are private, as `10.1.0.0/16` or one address.
    pub allowed_networks: Vec<String>,
    /// A receiver that has not answered by then has failed.
    #[serde(rename = "timeout_s", with = "seconds")]
    pub timeout: Duration,
    /// Tries of one delivery.
    pub max_tries: i64,
    /// Wait before the second try; the n-th wait is this plus n^4 seconds.
    #[serde(rename = "first_wait_s", with = "seconds")]
    pub first_wait: Duration,
}

/// What is removed by itself; nothing unless asked for.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Retention {
    /// Jobs that ended so many days ago are deleted with their results.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub jobs_days: Option<f64>,
    /// Sessions that were uploaded so many days ago and that no job names are deleted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sessions_days: Option<f64>,
}

impl Settings {
    /// The defaults for a data folder and an address.
    ///
    /// # Errors
    /// When the path of the running binary cannot be found out.
    pub fn new(data: PathBuf, listen: SocketAddr) -> std::io::Result<Self> {
        Ok(Self { data, listen, program: std::env::current_exe()?, ..Self::default() })
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            data: PathBuf::from(DEFAULT_DATA),
            listen: DEFAULT_LISTEN.parse().expect("the default is an address"),
            program: PathBuf::new(),
            limits: RequestLimits::default(),
            tenants: TenantLimits::default(),
            jobs: JobSettings::default(),
            webhooks: WebhookSettings::default(),
            retention: Retention::default(),
            cors_origins: Vec::new(),
            drain_limit: Duration::from_secs(8), // with the child's end well inside the 10 s of a supervisor
        }
    }
}

impl Default for RequestLimits {
    fn default() -> Self {
        Self {
            max_upload_bytes: 2 << 30, // an hour of 8 cameras and 4 people, deflated, is some 1.5 GB
            max_json_bytes: 1 << 20,
            header_timeout: Duration::from_secs(5),
            keep_alive: Duration::from_secs(75), // longer than a long poll's 60 s, as proxies and clients expect
            body_idle_timeout: Duration::from_secs(30),
            body_min_bytes: 60 << 10, // 1 KiB/s over the window
            body_window: Duration::from_secs(60),
            write_timeout: Duration::from_secs(60),
            max_connections: 1024,
            max_wait: Duration::from_secs(60),
            max_queued: 20_000,
            min_free_bytes: 256 << 20,
            bad_keys_per_s: 10.0, // a script with an old key; guessing 256 bits needs more
        }
    }
}

impl Default for TenantLimits {
    fn default() -> Self {
        Self {
            max_bytes: 1 << 40,
            max_queued: 20_000,
            max_running: i64::MAX,
            requests_per_s: 500.0, // fifty clients that each ask ten times a second
        }
    }
}

impl Default for JobSettings {
    fn default() -> Self {
        Self {
            concurrent: 1, // one job already uses every core
            threads: 0,
            max_deaths: 3,
            kill_grace: Duration::from_secs(1), // cancel is promised within 2 s
            silence_limit: Duration::from_secs(30),
            stall_limit: Duration::from_secs(3600), // no stage of any known capture is silent for an hour
            memory_bytes: 0,
        }
    }
}

impl Default for WebhookSettings {
    fn default() -> Self {
        Self {
            allowed_networks: Vec::new(),
            timeout: Duration::from_secs(10),
            max_tries: 8, // the last some 80 minutes after the first
            first_wait: Duration::from_secs(15),
        }
    }
}
