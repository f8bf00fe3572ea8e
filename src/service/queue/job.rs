//! A job and its states; no SQL.

pub use super::phase::{Ending, Phase, next_phase};

use Phase as P;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A state with what belongs to it, so that an illegal mix cannot be written down.
#[derive(Debug, Clone, PartialEq)]
pub enum JobState {
    /// Waits for a worker.
    Queued,
    /// A child works on it.
    Running {
        /// Which claim.
        fence: i64,
    },
    /// Asked to stop; the child has not ended yet.
    Canceling {
        /// Which claim.
        fence: i64,
    },
    /// The result is published.
    Succeeded {
        /// UTC, RFC 3339.
        finished_at: String,
        /// Claim whose result it is.
        result_fence: i64,
        /// Verdict over the result.
        quality: JobQuality,
    },
    /// It cannot be solved, and this is why.
    Failed {
        /// UTC, RFC 3339.
        finished_at: String,
        /// The typed cause.
        error: JobError,
    },
    /// Stopped on request.
    Canceled {
        /// UTC, RFC 3339.
        finished_at: String,
    },
    /// Its child died too often.
    Dead {
        /// UTC, RFC 3339.
        finished_at: String,
        /// How it died the last time.
        error: JobError,
    },
}

impl JobState {
    /// The state's name.
    pub fn phase(&self) -> Phase {
        match self {
            Self::Queued => P::Queued,
            Self::Running { .. } => P::Running,
            Self::Canceling { .. } => P::Canceling,
            Self::Succeeded { .. } => P::Succeeded,
            Self::Failed { .. } => P::Failed,
            Self::Canceled { .. } => P::Canceled,
            Self::Dead { .. } => P::Dead,
        }
    }

    /// When it ended.
    pub fn finished_at(&self) -> Option<&str> {
        match self {
            Self::Queued | Self::Running { .. } | Self::Canceling { .. } => None,
            Self::Succeeded { finished_at, .. }
            | Self::Failed { finished_at, .. }
            | Self::Canceled { finished_at }
            | Self::Dead { finished_at, .. } => Some(finished_at),
        }
    }

    /// Why there is no result.
    pub fn error(&self) -> Option<&JobError> {
        match self {
            Self::Failed { error, .. } | Self::Dead { error, .. } => Some(error),
            _ => None,
        }
    }

    /// What the result is worth.
    pub fn quality(&self) -> Option<&JobQuality> {
        match self {
            Self::Succeeded { quality, .. } => Some(quality),
            _ => None,
        }
    }
}

/// The verdict over a result.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct JobQuality {
    /// `pass`, `warn` or `reject`.
    pub verdict: String,
    /// One sentence each.
    pub reasons: Vec<String>,
}

/// Why a job has no result: what, where, and what to do.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobError {
    /// For machines.
    pub code: String,
    /// For people.
    pub detail: String,
    /// Camera id.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera: Option<String>,
    /// Frame, in the session's numbers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame: Option<i64>,
    /// Position of the person in the frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub person: Option<usize>,
    /// JSON pointer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pointer: Option<String>,
    /// What to do.
    #[serde(skip_serializing_if = "String::is_empty", default)]
    pub remedy: String,
}

/// How far a job is.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct JobProgress {
    /// Name of the stage.
    pub stage: String,
    /// Its position.
    pub stage_index: i64,
    /// How many there are.
    pub stage_count: i64,
    /// Share of the whole work; never falls.
    pub fraction: f64,
    /// One sentence.
    pub message: String,
    /// Seconds to go, where it can be guessed.
    pub eta_s: Option<f64>,
}

/// A job as the database knows it.
#[derive(Debug, Clone, PartialEq)]
pub struct Job {
    /// `job_` and random bits.
    pub id: String,
    /// Position in the list of all jobs.
    pub seq: i64,
    /// Grows with every change.
    pub version: i64,
    /// What it works on.
    pub session: String,
    /// Every option with its value.
    pub options: serde_json::Value,
    /// The client's own marks.
    pub labels: BTreeMap<String, String>,
    /// Higher runs first.
    pub priority: i64,
    /// Where it stands.
    pub state: JobState,
    /// 0 before the first claim; grows with each death of its own child.
    pub attempt: i64,
    /// How far it is.
    pub progress: JobProgress,
    /// Wall seconds by stage.
    pub stage_seconds: BTreeMap<String, f64>,
    /// Release that ran it.
    pub solver_version: Option<String>,
    /// UTC, RFC 3339.
    pub created_at: String,
    /// UTC, RFC 3339: the first claim.
    pub started_at: Option<String>,
}
