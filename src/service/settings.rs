//! Settings of the service, with all defaults and their reasons.
//!
//! The settings file (TOML), the environment (`WANDLESS_LIMITS__MAX_UPLOAD_BYTES`) and `--set limits.max_upload_bytes=…`
//! use the same names; [`layers`] merges them. Durations there are in seconds.

pub mod layers;
mod ranges;
mod seconds;

use serde::{Deserialize, Serialize};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

/// Default address: the loopback, where requests need no API key until one is created.
pub const DEFAULT_LISTEN: &str = "127.0.0.1:8700";

/// Default data folder.
pub const DEFAULT_DATA: &str = "./wandless-data";

/// All settings of the service.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Folder of the database, the uploads and the results; only one service can use it at a time.
    pub data: PathBuf,
    /// Address to listen on; port 0 chooses a free port.
    pub listen: SocketAddr,
    /// Program that is started for each job and each upload; by default the running program.
    #[serde(skip)]
    pub program: PathBuf,
    /// The database.
    pub store: StoreSettings,
    /// Where uploads and results are kept.
    pub blobs: BlobSettings,
    /// What this process does.
    pub role: Role,
    /// How processes that share a database notice each other.
    pub worker: WorkerSettings,
    /// Limits of uploads and requests.
    pub limits: RequestLimits,
    /// Limits of one tenant.
    pub tenants: TenantLimits,
    /// Execution of jobs.
    pub jobs: JobSettings,
    /// Delivery of webhooks.
    pub webhooks: WebhookSettings,
    /// Automatic removal of old data.
    pub retention: Retention,
    /// Origins of other sites whose pages may call the API (`https://studio.example`); none by default.
    pub cors_origins: Vec<String>,
    /// Hosts besides the loopback names (`studio.example`) that requests may be sent to while no API key is required; none by
    /// default. A page whose name resolves to the loopback must not act with the rights of the operator.
    pub allowed_hosts: Vec<String>,
    /// How long a stop waits for open downloads before closing them.
    #[serde(rename = "drain_limit_s", with = "seconds")]
    pub drain_limit: Duration,
}

/// What a service process does. Several processes share a PostgreSQL server.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Serve the API and run jobs
    #[default]
    All,
    /// Serve the API
    Api,
    /// Run jobs; serves /healthz, /readyz and /metrics only
    Worker,
}

impl Role {
    /// Whether the process serves the API.
    pub fn serves(self) -> bool {
        self != Self::Worker
    }

    /// Whether the process runs jobs.
    pub fn works(self) -> bool {
        self != Self::Api
    }
}

/// How processes that share a database notice each other.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WorkerSettings {
    /// Interval in which a worker shows that the claim of its job is alive.
    #[serde(rename = "beat_s", with = "seconds")]
    pub beat: Duration,
    /// A claim without a beat for this time is lost: its job is put back. No clock but the leader's own monotonic one counts.
    #[serde(rename = "lease_s", with = "seconds")]
    pub lease: Duration,
    /// The largest class of jobs that this worker claims, 0 to 3 for machines that give a job 2, 8, 32 or 128 GiB; without it, every
    /// job. A job that runs out of memory is run again in the next class.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub class: Option<i64>,
}

/// The database.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StoreSettings {
    /// `sqlite:` for a file in the data folder, or `postgres://user:password@host/database?sslmode=verify-full` for a PostgreSQL server
    /// (15 or newer) that several services share; it is never printed.
    #[serde(serialize_with = "without_secret")]
    pub url: String,
    /// Maximal number of connections of this process to a PostgreSQL server.
    pub connections: u32,
}

/// Where uploads and results are kept.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BlobSettings {
    /// `file:` for the data folder; `s3://bucket/prefix` for an S3-compatible store, whose keys, region and endpoint come from the
    /// variables `AWS_*`; or `file:///folder` for a folder that several machines share.
    pub url: String,
    /// Maximal size of the local copies of objects, bytes.
    pub cache_bytes: u64,
}

/// Limits of uploads, requests and connections.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RequestLimits {
    /// Maximal size of an upload as sent, bytes.
    pub max_upload_bytes: u64,
    /// Maximal address space of the child process that validates or inspects an upload, bytes: an upload that needs more is answered
    /// 413. 0 means an eighth of the memory of the machine (or of the control group), at least 256 MiB.
    pub validation_memory_bytes: u64,
    /// Timeout for validating or inspecting an upload; one that takes longer is answered 413.
    #[serde(rename = "validation_timeout_s", with = "seconds")]
    pub validation_timeout: Duration,
    /// Maximal size of a JSON request that is not an upload, bytes.
    pub max_json_bytes: u64,
    /// Timeout for receiving a request's head.
    #[serde(rename = "header_timeout_s", with = "seconds")]
    pub header_timeout: Duration,
    /// An upload that sends nothing for this time is aborted.
    #[serde(rename = "body_idle_timeout_s", with = "seconds")]
    pub body_idle_timeout: Duration,
    /// An idle connection is kept open for this time.
    #[serde(rename = "keep_alive_s", with = "seconds")]
    pub keep_alive: Duration,
    /// An idle connection on which no request was admitted yet (without a valid key) is kept open for this time.
    #[serde(rename = "keep_alive_without_key_s", with = "seconds")]
    pub keep_alive_without_key: Duration,
    /// Minimal number of bytes that an upload must send in each `body_window`.
    pub body_min_bytes: u64,
    /// Time window of `body_min_bytes`.
    #[serde(rename = "body_window_s", with = "seconds")]
    pub body_window: Duration,
    /// A connection whose client receives nothing for this time is closed.
    #[serde(rename = "write_timeout_s", with = "seconds")]
    pub write_timeout: Duration,
    /// Maximal number of open connections; lower where the limit of file descriptors requires it. A further connection takes
    /// the place of the one that was idle the longest, or waits in the kernel's queue.
    pub max_connections: usize,
    /// Maximal number of open connections of one address (of an IPv6 /64) on which no request was admitted yet.
    pub max_connections_per_address: usize,
    /// Maximal value of `?wait=`.
    #[serde(rename = "max_wait_s", with = "seconds")]
    pub max_wait: Duration,
    /// Maximal number of queued jobs of all tenants; further ones are answered 429.
    pub max_queued: i64,
    /// While the disk has fewer free bytes than this, no job is claimed, and uploads and submissions are answered 507.
    pub min_free_bytes: u64,
    /// Wrong keys per second that one address can try before it is answered 429.
    pub bad_keys_per_s: f64,
    /// Proxies in front of the service, as `10.1.0.0/16` or one address. The limits of an address then count the clients that their
    /// header `X-Forwarded-For` names, which is believed of no other sender.
    pub trusted_proxies: Vec<String>,
}

/// Limits of one tenant.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TenantLimits {
    /// Quota of uploads and results together, bytes; unfinished uploads count. At the quota, submissions are refused, too.
    pub max_bytes: i64,
    /// Maximal number of queued jobs.
    pub max_queued: i64,
    /// Maximal number of running jobs.
    pub max_running: i64,
    /// Maximal request rate, 1/s; a burst can be twice as large. Applies only if API keys are required.
    pub requests_per_s: f64,
}

/// Execution of jobs.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct JobSettings {
    /// Number of jobs that run at the same time.
    pub concurrent: usize,
    /// Solver threads of one job; 0 uses all cores.
    pub threads: usize,
    /// Crashes of a job's process after which the job is `dead`.
    #[serde(alias = "max_deaths")]
    pub max_crashes: u32,
    /// Workers that a job may lose, one after the other, before it finishes a further stage; then it is `failed` with `worker_lost`.
    /// Counted where several processes share the database: the machine of a worker can be what the job takes down.
    pub max_losses: u32,
    /// Time between the termination request (SIGTERM) to a child process and killing it.
    #[serde(rename = "kill_grace_s", with = "seconds")]
    pub kill_grace: Duration,
    /// Child processes send a message at least once a second; one that is silent for this time is killed.
    #[serde(rename = "silence_limit_s", with = "seconds")]
    pub silence_limit: Duration,
    /// A child process without progress for this time is killed.
    #[serde(rename = "stall_limit_s", with = "seconds")]
    pub stall_limit: Duration,
    /// Maximal address space of one child process, bytes: a job that needs more fails with `out_of_memory`. 0 means three
    /// quarters of the memory of the machine (or of the control group), divided by the number of concurrent jobs.
    pub memory_bytes: u64,
}

/// Delivery of webhooks.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WebhookSettings {
    /// Private networks that webhooks may call, as `10.1.0.0/16` or one address.
    pub allowed_networks: Vec<String>,
    /// Timeout of one call.
    #[serde(rename = "timeout_s", with = "seconds")]
    pub timeout: Duration,
    /// Maximal number of tries of one delivery.
    pub max_tries: i64,
    /// Wait before the second try; the wait before try n + 2 is this plus n^4 seconds.
    #[serde(rename = "first_wait_s", with = "seconds")]
    pub first_wait: Duration,
}

/// Automatic removal of old data; nothing by default.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Retention {
    /// Ended jobs older than this many days are deleted with their results.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub jobs_days: Option<f64>,
    /// Sessions without jobs older than this many days are deleted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sessions_days: Option<f64>,
}

impl Settings {
    /// Returns the default settings for a data folder and an address.
    ///
    /// # Errors
    /// When the path of the running program is unknown.
    pub fn new(data: PathBuf, listen: SocketAddr) -> std::io::Result<Self> {
        Ok(Self { data, listen, program: std::env::current_exe()?, ..Self::default() })
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            data: PathBuf::from(DEFAULT_DATA),
            listen: DEFAULT_LISTEN.parse().expect("the default address is valid"),
            program: PathBuf::new(),
            store: StoreSettings::default(),
            blobs: BlobSettings::default(),
            role: Role::All,
            worker: WorkerSettings::default(),
            limits: RequestLimits::default(),
            tenants: TenantLimits::default(),
            jobs: JobSettings::default(),
            webhooks: WebhookSettings::default(),
            retention: Retention::default(),
            cors_origins: Vec::new(),
            allowed_hosts: Vec::new(),
            drain_limit: Duration::from_secs(8), // together with ending the child well below the 10 s of a process supervisor
        }
    }
}

impl Default for StoreSettings {
    fn default() -> Self {
        Self { url: "sqlite:".to_owned(), connections: 16 } // a server has a hundred by default: room for six processes
    }
}

impl Default for WorkerSettings {
    fn default() -> Self {
        Self {
            beat: Duration::from_secs(5),
            lease: Duration::from_secs(30), // six beats: an upload of checkpoints delays one or two
            class: None,
        }
    }
}

impl Default for BlobSettings {
    fn default() -> Self {
        Self { url: "file:".to_owned(), cache_bytes: 20_000_000_000 } // some hundred sessions with their results
    }
}

/// Serialises the URL of a database without its password.
fn without_secret<S: serde::Serializer>(url: &str, serializer: S) -> Result<S::Ok, S::Error> {
    let is_secret = url.contains('@') || url.contains("password=");
    serializer.serialize_str(if is_secret { "postgres://…" } else { url })
}

impl Default for RequestLimits {
    fn default() -> Self {
        Self {
            max_upload_bytes: 2 << 30, // one hour of 8 cameras and 4 people, deflated, is about 1.5 GB
            validation_memory_bytes: 0,
            validation_timeout: Duration::from_secs(300), // 8 GiB of text, the largest content, take about 100 s
            max_json_bytes: 1 << 20,
            header_timeout: Duration::from_secs(5),
            keep_alive: Duration::from_secs(75), // longer than a long poll's 60 s, as proxies and clients expect
            keep_alive_without_key: Duration::from_secs(5), // the viewer loads its files at once
            body_idle_timeout: Duration::from_secs(30),
            body_min_bytes: 60 << 10, // 1 KiB/s over the window
            body_window: Duration::from_secs(60),
            write_timeout: Duration::from_secs(60),
            max_connections: 1024,
            max_connections_per_address: 128, // browsers open 6 each: twenty of them behind one router
            max_wait: Duration::from_secs(60),
            max_queued: 20_000,
            min_free_bytes: 256 << 20,
            bad_keys_per_s: 10.0, // enough for a script with an old key, far too few to guess 256 bits
            trusted_proxies: Vec::new(),
        }
    }
}

impl Default for TenantLimits {
    fn default() -> Self {
        Self {
            max_bytes: 1 << 40,
            max_queued: 20_000,
            max_running: i64::MAX,
            requests_per_s: 500.0, // fifty clients with ten requests per second each
        }
    }
}

impl Default for JobSettings {
    fn default() -> Self {
        Self {
            concurrent: 1, // one job already uses all cores
            threads: 0,
            max_crashes: 3,
            max_losses: 10, // machines that are taken away at any time lose a job of an hour a few times
            kill_grace: Duration::from_secs(1), // a cancel must take effect within 2 s
            silence_limit: Duration::from_secs(30),
            stall_limit: Duration::from_secs(3600), // no stage of any known capture runs an hour without progress
            memory_bytes: 0,
        }
    }
}

impl Default for WebhookSettings {
    fn default() -> Self {
        Self {
            allowed_networks: Vec::new(),
            timeout: Duration::from_secs(10),
            max_tries: 8, // the last about 80 minutes after the first
            first_wait: Duration::from_secs(15),
        }
    }
}
