//! Messages between the service and its child processes: one order on the child's stdin, JSON lines on its stdout.
//!
//! A child solves one job or reads one upload. The service keeps the child's stdin open; end of file on it means that
//! the service has ended.

use super::queue::job::JobError;
use super::store::sessions::SessionSummary;
use crate::pipeline::Options;
use crate::session::upload::{Fault, UploadError};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The first line of a child's stdin.
#[derive(Debug, Serialize, Deserialize)]
pub struct Order<T> {
    /// The work of the child.
    pub task: T,
    /// Limit of the child's address space, bytes.
    pub memory_bytes: Option<u64>,
    /// Process id of the service; a child with another parent process was orphaned at its start.
    pub parent: i32,
}

impl<T> Order<T> {
    /// An order of this process.
    pub(super) fn new(task: T, memory_bytes: Option<u64>) -> Self {
        Self { task, memory_bytes, parent: rustix::process::getpid().as_raw_nonzero().get() }
    }
}

/// Command of the child that solves a job.
pub const RUN_JOB: &str = "run-job";

/// Command of the child that reads an upload.
pub const READ_UPLOAD: &str = "read-upload";

/// One job to solve.
#[derive(Debug, Serialize, Deserialize)]
pub struct JobTask {
    /// Path of the stored upload.
    pub session: PathBuf,
    /// SHA-256 of the upload when it was accepted, hex.
    pub session_sha256: String,
    /// Options of the job.
    pub options: Options,
    /// Results of the same session, from which a job with corrections continues.
    #[serde(default)]
    pub earlier: Vec<PathBuf>,
    /// Folder of the registered body models.
    pub bodies: PathBuf,
    /// An empty folder for the result.
    pub out: PathBuf,
    /// A folder for the checkpoints of finished stages; it outlives the process.
    pub checkpoints: PathBuf,
    /// Number of solver threads.
    pub threads: usize,
}

/// One line of the stdout of a child that solves a job.
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
    /// Cameras and people as they are known after a stage.
    Scene {
        /// Name of the stage.
        stage: String,
        /// A [`ProvisionalScene`](crate::pipeline::provisional::ProvisionalScene) as a JSON document.
        document: String,
    },
    /// The result folder is complete; the child then exits with code 0.
    Done,
    /// The job has failed; the child then exits with code 1.
    Failed {
        /// The typed cause.
        error: JobError,
    },
}

/// One upload to read.
#[derive(Debug, Serialize, Deserialize)]
pub struct UploadTask {
    /// Path of the received bytes.
    pub upload: PathBuf,
    /// What is asked about it.
    pub question: Question,
}

/// Why an upload is read.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Question {
    /// Whether it is a session.
    Validation,
    /// Which problems the session has, before it is solved.
    Inspection {
        /// Number of solver threads; 0 uses all cores.
        threads: usize,
    },
}

/// The only line of the stdout of a child that reads an upload.
#[derive(Debug, Serialize, Deserialize)]
#[serde(tag = "verdict", rename_all = "snake_case")]
pub enum UploadVerdict {
    /// The upload is a session.
    Accepted {
        /// Figures of the session.
        summary: SessionSummary,
    },
    /// The session is inspected.
    Inspected {
        /// The inspection as a JSON document.
        document: String,
    },
    /// The upload is refused.
    Refused {
        /// The reason.
        refusal: Refusal,
    },
}

/// A refused upload; an [`UploadError`] in a form that can be sent.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct Refusal {
    code: String,
    file: Option<String>,
    camera: Option<String>,
    frame: Option<i64>,
    person: Option<usize>,
    pointer: Option<String>,
    detail: String,
    remedy: String,
}

impl From<UploadError> for Refusal {
    fn from(error: UploadError) -> Self {
        let UploadError { code, file, camera, frame, person, pointer, detail, remedy, kind: _ } = error;
        Self { code: code.to_owned(), file, camera, frame, person, pointer, detail, remedy }
    }
}

impl Refusal {
    /// The error; `None` if no fault has the code.
    pub(super) fn into_error(self) -> Option<UploadError> {
        let Self { code, file, camera, frame, person, pointer, detail, remedy } = self;
        let fault = Fault::ALL.iter().find(|fault| fault.code() == code)?;
        let (kind, code) = (fault.kind(), fault.code());
        Some(UploadError { kind, code, file, camera, frame, person, pointer, detail, remedy })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refused_upload_survives_the_way_to_the_service() {
        for fault in Fault::ALL {
            let error = UploadError {
                kind: fault.kind(),
                code: fault.code(),
                file: Some("poses/cam0.json".to_owned()),
                camera: Some("cam0".to_owned()),
                frame: Some(-3),
                person: Some(2),
                pointer: Some("/frames/7".to_owned()),
                detail: "line\nbreak and \u{202e}".to_owned(),
                remedy: "send it again".to_owned(),
            };
            let line = serde_json::to_string(&UploadVerdict::Refused { refusal: error.clone().into() }).unwrap();
            let UploadVerdict::Refused { refusal } = serde_json::from_str(&line).unwrap() else { panic!("{line}") };
            assert_eq!(refusal.into_error(), Some(error.clone()));
            assert_eq!(Refusal { code: "unknown".to_owned(), ..error.into() }.into_error(), None);
        }
    }
}
