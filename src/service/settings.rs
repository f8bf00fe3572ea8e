//! What an operator may set; every default is visible here, with its reason.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

/// Where the service listens unless told otherwise: the loopback only, since nobody is asked for a key yet.
pub const DEFAULT_LISTEN: &str = "127.0.0.1:8700";

/// Where the service keeps its data unless told otherwise.
pub const DEFAULT_DATA: &str = "./wandless-data";

/// Everything the service is told at its start.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Folder of the database, the uploads and the results; one service at a time owns it.
    pub data: PathBuf,
    /// Address to listen on; port 0 takes a free one.
    pub listen: SocketAddr,
    /// The binary started as `run-job` for each job.
    pub program: PathBuf,
    /// What uploads and requests may cost.
    pub limits: RequestLimits,
    /// How jobs are run.
    pub jobs: JobSettings,
    /// How long a stop waits for open downloads before it cuts them.
    pub drain_limit: Duration,
}

/// Bounds on what one client can hold or fill.
#[derive(Debug, Clone)]
pub struct RequestLimits {
    /// Largest upload, bytes as sent.
    pub max_upload_bytes: u64,
    /// Largest JSON request that is no upload, bytes.
    pub max_json_bytes: u64,
    /// A request's head must have come within this time; idle connections end after it too.
    pub header_timeout: Duration,
    /// An upload that sends nothing for so long is cut.
    pub body_idle_timeout: Duration,
    /// An upload must send at least this much in each `body_window`.
    pub body_min_bytes: u64,
    /// See `body_min_bytes`.
    pub body_window: Duration,
    /// A client that takes nothing of an answer for so long is cut.
    pub write_timeout: Duration,
    /// Open connections; more wait in the kernel's queue.
    pub max_connections: usize,
    /// Longest `?wait=`.
    pub max_wait: Duration,
    /// Jobs that may wait; more are answered 429.
    pub max_queued: i64,
    /// Uploads are refused with 507 while the disk has less than this left.
    pub min_free_bytes: u64,
}

/// How jobs are run.
#[derive(Debug, Clone)]
pub struct JobSettings {
    /// Jobs at the same time.
    pub concurrent: usize,
    /// Solver threads of one job.
    pub threads: usize,
    /// Deaths of its own child after which a job is `dead`.
    pub max_deaths: u32,
    /// Between the polite and the forced end of a child.
    pub kill_grace: Duration,
    /// A child says at least once a second that it lives; one silent for so long is killed.
    pub silence_limit: Duration,
    /// A child that makes no progress for so long is killed.
    pub stall_limit: Duration,
}

impl Settings {
    /// The defaults for a data folder and an address.
    ///
    /// # Errors
    /// When the path of the running binary cannot be found out.
    pub fn new(data: PathBuf, listen: SocketAddr) -> std::io::Result<Self> {
        let program = std::env::current_exe()?;
        let drain_limit = Duration::from_secs(8); // with the child's end well inside the 10 s of a supervisor
        Ok(Self { data, listen, program, limits: RequestLimits::default(), jobs: JobSettings::default(), drain_limit })
    }
}

impl Default for RequestLimits {
    fn default() -> Self {
        Self {
            max_upload_bytes: 2 << 30, // an hour of 8 cameras and 4 people, deflated, is some 1.5 GB
            max_json_bytes: 1 << 20,
            header_timeout: Duration::from_secs(5),
            body_idle_timeout: Duration::from_secs(30),
            body_min_bytes: 60 << 10, // 1 KiB/s over the window
            body_window: Duration::from_secs(60),
            write_timeout: Duration::from_secs(60),
            max_connections: 1024,
            max_wait: Duration::from_secs(60),
            max_queued: 20_000,
            min_free_bytes: 256 << 20,
        }
    }
}

impl Default for JobSettings {
    fn default() -> Self {
        Self {
            concurrent: 1, // one job already uses every core
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            max_deaths: 3,
            kill_grace: Duration::from_secs(1), // cancel is promised within 2 s
            silence_limit: Duration::from_secs(60),
            stall_limit: Duration::from_secs(3600), // no stage of any known capture is silent for an hour
        }
    }
}
