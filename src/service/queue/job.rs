//! A job and its states; no SQL.

use super::phase::Phase as P;
use crate::service::failpoint::fault;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// State of a job with the data of that state, so that an inconsistent combination cannot be constructed.
#[derive(Debug, Clone, PartialEq)]
pub enum JobState {
    /// The job waits for a worker.
    Queued,
    /// A child process works on the job.
    Running {
        /// Number of the current claim.
        fence: i64,
    },
    /// A cancel was requested; the child process has not ended yet.
    Canceling {
        /// Number of the current claim.
        fence: i64,
    },
    /// The result is published.
    Succeeded {
        /// Time of the final state; UTC, RFC 3339.
        finished_at: String,
        /// Number of the claim that published the result.
        result_fence: i64,
        /// Verdict on the result.
        quality: JobQuality,
        /// Probable mistakes in the files, as in `report.json`.
        suspicions: Vec<serde_json::Value>,
    },
    /// The job cannot be solved.
    Failed {
        /// Time of the final state; UTC, RFC 3339.
        finished_at: String,
        /// Why it failed.
        error: JobError,
    },
    /// The job was canceled on request.
    Canceled {
        /// Time of the final state; UTC, RFC 3339.
        finished_at: String,
    },
    /// The child process crashed too often.
    Dead {
        /// Time of the final state; UTC, RFC 3339.
        finished_at: String,
        /// How it crashed the last time.
        error: JobError,
    },
}

impl JobState {
    /// Name of the state.
    pub fn phase(&self) -> P {
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

    /// Time of the final state, if it was reached; UTC, RFC 3339.
    pub fn finished_at(&self) -> Option<&str> {
        match self {
            Self::Queued | Self::Running { .. } | Self::Canceling { .. } => None,
            Self::Succeeded { finished_at, .. }
            | Self::Failed { finished_at, .. }
            | Self::Canceled { finished_at }
            | Self::Dead { finished_at, .. } => Some(finished_at),
        }
    }

    /// Why the result is missing, for failed and dead jobs.
    pub fn error(&self) -> Option<&JobError> {
        match self {
            Self::Failed { error, .. } | Self::Dead { error, .. } => Some(error),
            _ => None,
        }
    }

    /// Verdict on the result, for succeeded jobs.
    pub fn quality(&self) -> Option<&JobQuality> {
        match self {
            Self::Succeeded { quality, .. } => Some(quality),
            _ => None,
        }
    }

    /// Probable mistakes in the files, which are known once the job has succeeded.
    pub fn suspicions(&self) -> &[serde_json::Value] {
        match self {
            Self::Succeeded { suspicions, .. } => suspicions,
            _ => &[],
        }
    }
}

/// Verdict on a result.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[schema(as = Quality)]
pub struct JobQuality {
    /// `pass`, `warn` or `reject`.
    #[schema(pattern = "^(pass|warn|reject)$")]
    pub verdict: String,
    /// Reasons of the verdict, one sentence each.
    pub reasons: Vec<String>,
}

/// Why a job has no result: what is wrong, where, and what to do.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct JobError {
    /// Machine-readable code.
    pub code: String,
    /// Human-readable description.
    pub detail: String,
    /// Camera id.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub camera: Option<String>,
    /// Frame number of the session.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub frame: Option<i64>,
    /// Index of the person within the frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub person: Option<usize>,
    /// JSON pointer to the offending value.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub pointer: Option<String>,
    /// What to do.
    #[serde(skip_serializing_if = "String::is_empty", default)]
    pub remedy: String,
}

/// Faults of the machine: code, errors of the operating system, and remedy.
const MACHINE_FAULTS: [(&str, &[rustix::io::Errno], &str); 4] = [
    (
        "disk_full",
        &[rustix::io::Errno::NOSPC, rustix::io::Errno::DQUOT],
        "free disk space or raise the disk quota of the service",
    ),
    (
        "too_many_open_files",
        &[rustix::io::Errno::MFILE, rustix::io::Errno::NFILE],
        "raise the limit of open files of the service (ulimit -n)",
    ),
    ("disk_failed", &[rustix::io::Errno::IO], "check the disk and the log of the operating system"),
    (OBJECT_STORE_FAILED, &[], "check the object store that blobs.url names, and the variables AWS_*"),
];

/// Code of a failing object store.
const OBJECT_STORE_FAILED: &str = "object_store_failed";

impl JobError {
    /// Describes a failed file operation that is the fault of the machine: a full disk or disk quota, too many open files,
    /// a failing disk. `None` for other errors.
    pub fn of_machine(error: &std::io::Error, detail: &str) -> Option<Self> {
        let errno = rustix::io::Errno::from_io_error(error)?;
        let (code, _, remedy) = MACHINE_FAULTS.iter().find(|(_, errors, _)| errors.contains(&errno))?;
        let (code, remedy) = ((*code).to_owned(), (*remedy).to_owned());
        Some(Self { code, detail: detail.to_owned(), remedy, ..Self::default() })
    }

    /// Describes a failing object store, which is not the fault of the job either.
    pub fn of_object_store(detail: &str) -> Self {
        let fault = MACHINE_FAULTS.iter().find(|(code, _, _)| *code == OBJECT_STORE_FAILED);
        let remedy = fault.map_or("", |(_, _, remedy)| remedy).to_owned();
        Self { code: OBJECT_STORE_FAILED.to_owned(), detail: detail.to_owned(), remedy, ..Self::default() }
    }

    /// Whether the machine is at fault: the same job can succeed later.
    pub fn is_of_machine(&self) -> bool {
        MACHINE_FAULTS.iter().any(|(code, _, _)| *code == self.code) && !fault("disk.unwatched")
    }
}

/// Progress of a job.
#[derive(Debug, Clone, Default, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = Progress)]
pub struct JobProgress {
    /// Name of the stage.
    pub stage: String,
    /// Index of the stage.
    #[schema(minimum = 0)]
    pub stage_index: i64,
    /// Number of stages.
    #[schema(minimum = 0)]
    pub stage_count: i64,
    /// Completed share of the whole job, 0 to 1; never decreases.
    #[schema(minimum = 0, maximum = 1)]
    pub fraction: f64,
    /// Description of the current step, one sentence.
    pub message: String,
    /// Estimated seconds to the end; `None` while there is too little progress for an estimate.
    #[schema(required)]
    pub eta_s: Option<f64>,
}

/// The request that submitted a job, for the log.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Submitter {
    /// `X-Request-Id` of the request.
    pub request: Option<String>,
    /// Public part of its API key; `None` where no key is required.
    pub key: Option<String>,
}

/// A job as stored in the database.
#[derive(Debug, Clone, PartialEq)]
pub struct Job {
    /// Job id: `job_` and random bits.
    pub id: String,
    /// Position in the list of all jobs.
    pub seq: i64,
    /// Incremented with every change.
    pub version: i64,
    /// Id of the session to solve.
    pub session: String,
    /// All options with their values, defaults included.
    pub options: serde_json::Value,
    /// Labels set by the client.
    pub labels: BTreeMap<String, String>,
    /// Jobs of higher priority run first.
    pub priority: i64,
    /// Current state.
    pub state: JobState,
    /// Number of the attempt: 0 before the first claim, then 1 plus the crash count.
    pub attempt: i64,
    /// Progress of the current or last attempt.
    pub progress: JobProgress,
    /// Wall time of each stage, s.
    pub stage_seconds: BTreeMap<String, f64>,
    /// Version of the program that ran the job.
    pub solver_version: Option<String>,
    /// Time of acceptance; UTC, RFC 3339.
    pub created_at: String,
    /// Time of the first claim; UTC, RFC 3339.
    pub started_at: Option<String>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Error, ErrorKind};

    #[test]
    fn distinguishes_faults_of_the_machine() {
        let code = |error: &Error| JobError::of_machine(error, "x").map(|error| error.code);
        for (errno, expected) in [
            (rustix::io::Errno::NOSPC, "disk_full"),
            (rustix::io::Errno::DQUOT, "disk_full"),
            (rustix::io::Errno::MFILE, "too_many_open_files"),
            (rustix::io::Errno::IO, "disk_failed"),
        ] {
            assert_eq!(code(&errno.into()).as_deref(), Some(expected));
        }
        assert!(JobError::of_machine(&rustix::io::Errno::NOSPC.into(), "x").is_some_and(|error| error.is_of_machine()));
        assert_eq!(code(&rustix::io::Errno::NOENT.into()), None);
        assert_eq!(code(&Error::from(ErrorKind::InvalidData)), None);
        assert!(!JobError { code: "result_unwritten".to_owned(), ..JobError::default() }.is_of_machine());
    }
}
