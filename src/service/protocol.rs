//! Messages between the service and the child process of a job: one order on the child's stdin, JSON lines on its stdout.
//!
//! The service keeps the child's stdin open; end of file on it means that the service has ended.

use super::queue::job::JobError;
use crate::pipeline::Options;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The first line of the child's stdin.
#[derive(Debug, Serialize, Deserialize)]
pub struct Order {
    /// Path of the stored upload.
    pub session: PathBuf,
    /// SHA-256 of the upload when it was accepted, hex.
    pub session_sha256: String,
    /// Options of the job.
    pub options: Options,
    /// Folder of the registered body models.
    pub bodies: PathBuf,
    /// An empty folder for the result.
    pub out: PathBuf,
    /// A folder for the checkpoints of finished stages; it outlives the process.
    pub checkpoints: PathBuf,
    /// Number of solver threads.
    pub threads: usize,
    /// Limit of the child's address space, bytes.
    pub memory_bytes: Option<u64>,
    /// Process id of the service; a child with another parent process was orphaned at its start.
    pub parent: i32,
}

/// One line of the child's stdout.
#[derive(Debug, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Message {
    /// Sent once a second while the process runs.
    Alive,
    /// Progress of the work.
    Progress {
        /// Name of the stage.
        stage: String,
        /// Index of the stage.
        stage_index: usize,
        /// Number of stages.
        stage_count: usize,
        /// Completed share of the whole work, 0 to 1.
        fraction: f64,
        /// What the stage is doing, one sentence.
        message: String,
    },
    /// The result folder is complete; the child then exits with code 0.
    Done,
    /// The job has failed; the child then exits with code 1.
    Failed {
        /// The typed cause.
        error: JobError,
    },
}
