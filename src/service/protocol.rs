//! What the service and a job's child process say to each other: one order on the child's stdin, JSON lines on its stdout.
//!
//! The service keeps the stdin open: its end tells the child that the service is gone.

use super::queue::job::JobError;
use crate::pipeline::Options;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The first line of the child's stdin.
#[derive(Debug, Serialize, Deserialize)]
pub struct Order {
    /// The stored upload.
    pub session: PathBuf,
    /// Its digest when it was accepted.
    pub session_sha256: String,
    /// What was asked for.
    pub options: Options,
    /// Where the registered bodies lie.
    pub bodies: PathBuf,
    /// An empty folder for the result.
    pub out: PathBuf,
    /// A folder for finished stages, which outlives the process.
    pub checkpoints: PathBuf,
    /// Solver threads.
    pub threads: usize,
    /// Address space that the child may take, bytes.
    pub memory_bytes: Option<u64>,
    /// Process id of the service; a child whose parent is another one was orphaned before it could say so.
    pub parent: i32,
}

/// One line of the child's stdout.
#[derive(Debug, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Message {
    /// Once a second: the process lives.
    Alive,
    /// How far the work is.
    Progress {
        /// Name of the stage.
        stage: String,
        /// Its position.
        stage_index: usize,
        /// How many there are.
        stage_count: usize,
        /// Share of the whole.
        fraction: f64,
        /// One sentence.
        message: String,
    },
    /// The result lies in the folder; exit code 0 follows.
    Done,
    /// There will be no result; exit code 1 follows.
    Failed {
        /// The typed cause.
        error: JobError,
    },
}
