//! Validation and inspection of an upload in a short-lived child process, which alone holds the session in memory.
//!
//! Nine megabytes of zip can describe a session of more than a gigabyte. The child has a memory limit and a timeout; the
//! service receives the verdict and the figures.

use super::child::Child;
use super::failpoint::fault;
use super::memory::upload_limit;
use super::protocol::{Order, Question, READ_UPLOAD, UploadTask, UploadVerdict};
use super::settings::Settings;
use super::store::sessions::SessionSummary;
use crate::pipeline::{CameraFacts, inspection};
use crate::session::upload::{self, LoadedSession, UploadError, UploadLimits};
use rustix::process::Signal;
use std::fs::File;
use std::io;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::ExitStatus;

/// Why an upload was not read.
#[derive(Debug, thiserror::Error)]
pub(super) enum ValidationError {
    /// The upload is not a session.
    #[error(transparent)]
    Refused(UploadError),
    /// Reading the upload exceeds a limit of the child.
    #[error("reading the upload takes more than {limit}")]
    TooLarge {
        /// The limit with its unit.
        limit: String,
        /// Setting of the limit, in the section `limits`.
        setting: &'static str,
    },
    /// The system ended the child, which was within its limit.
    #[error("the memory of the service ran out while it read the upload")]
    MemoryShort,
    /// The child did not start, or ended without a verdict.
    #[error(transparent)]
    Failed(#[from] anyhow::Error),
}

/// Validates the upload in a child process and returns its summary.
pub(super) async fn validate(settings: &Settings, upload: &Path) -> Result<SessionSummary, ValidationError> {
    match ask(settings, upload, Question::Validation).await? {
        UploadVerdict::Accepted { summary } => Ok(summary),
        other => Err(unexpected(&other)),
    }
}

/// Inspects a stored session in a child process and returns the inspection as a JSON document.
pub(super) async fn inspect(settings: &Settings, session: &Path) -> Result<String, ValidationError> {
    match ask(settings, session, Question::Inspection { threads: settings.jobs.threads }).await? {
        UploadVerdict::Inspected { document } => Ok(document),
        other => Err(unexpected(&other)),
    }
}

fn unexpected(verdict: &UploadVerdict) -> ValidationError {
    anyhow::anyhow!("the process that reads an upload sent an unexpected answer: {verdict:?}").into()
}

async fn ask(settings: &Settings, upload: &Path, question: Question) -> Result<UploadVerdict, ValidationError> {
    let limits = &settings.limits;
    if fault("uploads.spilled")
        && let Some(outside) = settings.data.parent()
    {
        std::fs::write(outside.join("spilled"), "").map_err(anyhow::Error::from)?;
    }
    let memory = upload_limit(limits).filter(|_| !fault("uploads.unlimited"));
    let order = Order::new(UploadTask { upload: upload.to_owned(), question }, memory);
    let mut child = Child::start(&settings.program, READ_UPLOAD, &order, |_| {}).await?;
    let ended = async { (child.message::<UploadVerdict>().await, child.wait().await) };
    let Ok((verdict, status)) = tokio::time::timeout(limits.validation_timeout, ended).await else {
        child.stop(settings.jobs.kill_grace).await;
        let limit = format!("{} s", limits.validation_timeout.as_secs_f64());
        return Err(ValidationError::TooLarge { limit, setting: "validation_timeout_s" });
    };
    let status = status.map_err(anyhow::Error::from)?;
    match verdict {
        Some(UploadVerdict::Refused { refusal }) if status.success() => match refusal.into_error() {
            Some(error) => Err(ValidationError::Refused(error)),
            None => Err(anyhow::anyhow!("the refusal of an upload has an unknown code").into()),
        },
        Some(verdict) if status.success() => Ok(verdict),
        _ if child.ran_out_of_memory() => {
            let limit = memory.map_or("the memory of the machine".to_owned(), |bytes| format!("{} MiB", bytes >> 20));
            Err(ValidationError::TooLarge { limit, setting: "validation_memory_bytes" })
        }
        _ if was_killed(status) => Err(ValidationError::MemoryShort),
        _ => Err(anyhow::anyhow!("the process that reads an upload ended with {status}").into()),
    }
}

/// Whether the process got SIGKILL, which only the system sends to it: when memory runs out.
fn was_killed(status: ExitStatus) -> bool {
    status.signal() == Some(Signal::KILL.as_raw())
}

/// Reads the upload as a job does; runs in the child. The content determines the format. `cores`: of the machine.
///
/// # Errors
/// When the file cannot be opened.
pub fn read(task: &UploadTask, cores: usize) -> io::Result<UploadVerdict> {
    let file = File::open(&task.upload)?;
    let bytes = file.metadata()?.len();
    let limits = match fault("limits.none") {
        true => UploadLimits { max_unpacked_bytes: u64::MAX, max_ratio: u64::MAX, ..UploadLimits::default() },
        false => UploadLimits::default(),
    };
    Ok(match (upload::read_upload(file, "upload", &limits), task.question) {
        (Ok(loaded), Question::Validation) => UploadVerdict::Accepted { summary: summarise(loaded, bytes) },
        (Ok(loaded), Question::Inspection { threads }) => {
            let threads = if threads == 0 { cores } else { threads };
            UploadVerdict::Inspected {
                document: serde_json::to_string(&inspection::inspect(&loaded.session, threads))?,
            }
        }
        (Err(error), _) => UploadVerdict::Refused { refusal: error.into() },
    })
}

fn summarise(loaded: LoadedSession, bytes: u64) -> SessionSummary {
    let LoadedSession { session, format, warnings, sha256 } = loaded;
    SessionSummary {
        sha256,
        bytes,
        cameras: session.views.len(),
        frames: session.n_frames,
        people_max: session.views.iter().flat_map(|view| &view.frames).map(Vec::len).max().unwrap_or(0),
        keypoint_convention: session.convention.name().to_owned(),
        format,
        warnings,
        camera_facts: CameraFacts::of(&session),
        name: session.name,
    }
}
