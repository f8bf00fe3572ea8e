//! `wandless run-job`: solves one job in a child process of the service.
//!
//! The order is the first line of stdin; events are JSON lines on stdout. SIGTERM cancels the job by ending the process
//! immediately: the service publishes results only after success and deletes the folder of a canceled job.

use super::child::{Kind, begin, send};
use super::confinement::Access;
use super::solve::{SolveError, SolveFiles, solve, use_threads};
use crate::body::default_body;
use crate::pipeline::PipelineError;
use crate::pipeline::config::DEFAULT_BODY;
use crate::pipeline::provisional::{ProvisionalScene, Watcher};
use crate::progress::{Progress, ProgressEvent};
use crate::service::bodies;
use crate::service::failpoint::{fault, linger, simulated_job};
use crate::service::protocol::{JobTask, Message, RUN_JOB};
use crate::service::queue::job::JobError;
use crate::service::store::artifacts::digest_file;
use crate::session::upload::UploadError;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

const KIND: Kind = Kind { command: RUN_JOB, oom_score: 250 };

/// Shortest time between two progress messages of one stage.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(100);

/// Runs the child.
pub(super) fn run() -> ExitCode {
    // The number of cores depends on files of the system, which the child cannot read later.
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let task = match begin(&KIND, access) {
        Ok(order) => order.task,
        Err(code) => return code,
    };
    std::thread::spawn(send_heartbeats);
    use_threads(if task.threads == 0 { cores } else { task.threads });
    let progress = Progress::new(progress_sender(), Arc::default());
    match run_task(&task, &progress) {
        Ok(()) => {
            send(&Message::Done);
            ExitCode::SUCCESS
        }
        Err(error) => {
            send(&Message::Failed { error });
            ExitCode::FAILURE
        }
    }
}

fn access(task: &JobTask) -> Access<'_> {
    let simulated = simulated_job().map(|(_, result)| &*Box::leak(result.into_boxed_path())); // once in a process
    let reads = [task.session.as_path(), &task.bodies].into_iter().chain(task.earlier.iter().map(PathBuf::as_path));
    Access { reads: reads.chain(simulated).collect(), writes: vec![&task.out, &task.checkpoints] }
}

fn run_task(task: &JobTask, progress: &Progress) -> Result<(), JobError> {
    if let Some((duration, result)) = simulated_job() {
        std::thread::sleep(duration);
        let copied = copy_files(&result, &task.out);
        return copied.map_err(|error| JobError { detail: error.to_string(), ..JobError::default() });
    }
    let body = match task.options.body.as_str() {
        DEFAULT_BODY => default_body(),
        name => bodies::load(&task.bodies, name).map_err(|error| JobError {
            code: "body_unreadable".to_owned(),
            detail: error.to_string(),
            pointer: Some("/options/body".to_owned()),
            remedy: "ask the operator to register the body again, or choose another one".to_owned(),
            ..JobError::default()
        })?,
    };
    let checkpoints = (!fault("checkpoint.ignored")).then_some(task.checkpoints.as_path());
    let mut options = task.options.clone();
    if fault("seed.random") {
        options.seed = u64::from(std::process::id());
    }
    let files = SolveFiles {
        session: &task.session,
        sha256: Some(task.session_sha256.as_str()),
        checkpoints,
        earlier: &task.earlier,
        out: &task.out,
    };
    let solved = solve(&files, &options, &body, &Watcher::new(&send_scene), progress);
    solved.map(drop).map_err(|error| match error {
        // It was readable when it was accepted: what is wrong now is not the client's fault.
        SolveError::Upload(_) if has_changed(task) => job_error(SolveError::Changed),
        error => job_error(error),
    })
}

/// Whether the stored upload is missing or has other bytes than those that were accepted.
fn has_changed(task: &JobTask) -> bool {
    match digest_file(&task.session) {
        Ok(digest) => digest.sha256 != task.session_sha256,
        Err(error) => error.kind() == std::io::ErrorKind::NotFound,
    }
}

fn send_scene(scene: ProvisionalScene) {
    let document = serde_json::to_string(&scene).expect("a scene is strings and numbers, which always serialise");
    send(&Message::Scene { stage: scene.stage.to_owned(), document });
}

/// Copies a result for [`simulated_job`].
fn copy_files(from: &Path, to: &Path) -> std::io::Result<()> {
    for entry in std::fs::read_dir(from)? {
        let entry = entry?;
        let target = to.join(entry.file_name());
        if entry.file_type()?.is_dir() {
            std::fs::create_dir_all(&target)?;
            copy_files(&entry.path(), &target)?;
        } else {
            std::fs::copy(entry.path(), target)?;
        }
    }
    Ok(())
}

fn send_heartbeats() {
    loop {
        send(&Message::Alive);
        std::thread::sleep(Duration::from_secs(1));
    }
}

/// Sends progress at most every [`PROGRESS_INTERVAL`], and always at the start of a stage.
fn progress_sender() -> impl Fn(&ProgressEvent) + Send + Sync {
    let last = Mutex::new(None::<(&'static str, Instant)>);
    move |event| {
        let mut last = last.lock().unwrap_or_else(PoisonError::into_inner);
        let is_new = last.is_none_or(|(stage, _)| stage != event.stage);
        if !is_new && last.is_some_and(|(_, at)| at.elapsed() < PROGRESS_INTERVAL) {
            return;
        }
        *last = Some((event.stage, Instant::now()));
        send(&Message::Progress {
            stage: event.stage.to_owned(),
            stage_index: event.stage_index,
            stage_count: event.stage_count,
            fraction: event.fraction,
            message: event.message.clone(),
        });
        if is_new {
            linger();
        }
    }
}

/// Maps an error to its code in the HTTP API.
fn job_error(error: SolveError) -> JobError {
    let detail = error.to_string();
    let coded = |code: &str, remedy: &str| JobError {
        code: code.to_owned(),
        detail: detail.clone(),
        remedy: remedy.to_owned(),
        ..JobError::default()
    };
    match error {
        SolveError::Upload(UploadError { code, camera, frame, person, pointer, detail, remedy, .. }) => {
            JobError { code: code.to_owned(), detail, camera, frame, person, pointer, remedy }
        }
        SolveError::Changed => coded("session_changed", "upload the session again"),
        SolveError::Pipeline(PipelineError::Canceled(_)) => coded("canceled", ""),
        SolveError::Pipeline(PipelineError::Option { option, reason }) => JobError {
            code: "option_impossible".to_owned(),
            detail: reason,
            pointer: Some(format!("/options{option}")),
            remedy: "change the option, then submit the job again".to_owned(),
            ..JobError::default()
        },
        SolveError::Pipeline(PipelineError::Unsolvable { code, reason, .. }) => {
            JobError { code: code.to_owned(), detail: reason, ..JobError::default() }
        }
        SolveError::Write(error) => JobError::of_machine(&error, &detail)
            .unwrap_or_else(|| coded("result_unwritten", "check the log of the service, then submit the job again")),
    }
}
