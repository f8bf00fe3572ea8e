//! `wandless run-job`: solves one job in a child process of the service.
//!
//! The order is the first line of stdin; events are JSON lines on stdout. SIGTERM cancels the job by ending the process
//! immediately: the service publishes results only after success and deletes the folder of a canceled job.

use super::solve::{SolveError, solve, use_threads};
use crate::body::default_body;
use crate::pipeline::PipelineError;
use crate::pipeline::config::DEFAULT_BODY;
use crate::progress::{Progress, ProgressEvent};
use crate::service::bodies;
use crate::service::failpoint::{fault, linger};
use crate::service::protocol::{Message, Order};
use crate::service::queue::job::JobError;
use crate::session::upload::UploadError;
use rustix::process::{Resource, Rlimit, getppid, nice, setrlimit};
use std::io::{BufRead, Read, Write};
use std::process::ExitCode;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Exit code of a child whose service has ended.
const ORPHANED: i32 = 3;

/// Lower priority than the threads that answer clients, which stay responsive while every core solves.
const NICENESS: i32 = 5;

/// Shortest time between two progress messages of one stage.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(100);

/// Runs the child.
pub(super) fn run() -> ExitCode {
    die_with_parent();
    let order = match read_order() {
        Ok(order) => order,
        Err(error) => {
            eprintln!("wandless run-job: {error:#}: only the service runs this command");
            return ExitCode::from(2);
        }
    };
    if getppid().map_or(0, |pid| pid.as_raw_nonzero().get()) != order.parent {
        std::process::exit(ORPHANED); // the service ended before `die_with_parent` took effect
    }
    std::thread::spawn(end_with_stdin);
    std::thread::spawn(send_heartbeats);
    if let Err(error) = nice(NICENESS) {
        tracing::debug!(%error, "the priority of this process was not lowered");
    }
    limit_memory(order.memory_bytes);
    use_threads(order.threads);
    let progress = Progress::new(progress_sender(), Arc::default());
    match run_order(&order, &progress) {
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

fn run_order(order: &Order, progress: &Progress) -> Result<(), JobError> {
    let body = match order.options.body.as_str() {
        DEFAULT_BODY => default_body(),
        name => bodies::load(&order.bodies, name).map_err(|error| JobError {
            code: "body_unreadable".to_owned(),
            detail: error.to_string(),
            pointer: Some("/options/body".to_owned()),
            ..JobError::default()
        })?,
    };
    let checkpoints = (!fault("checkpoint.ignored")).then_some(order.checkpoints.as_path());
    let mut options = order.options.clone();
    if fault("seed.random") {
        options.seed = u64::from(std::process::id());
    }
    let sha256 = Some(order.session_sha256.as_str());
    let solved = solve(&order.session, sha256, &options, &body, checkpoints, &order.out, progress);
    solved.map(drop).map_err(job_error)
}

/// Ends this process together with the service: on Linux by the kernel, elsewhere at the end of stdin.
fn die_with_parent() {
    #[cfg(target_os = "linux")]
    if let Err(error) = rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::KILL)) {
        tracing::warn!(%error, "the kernel will not end this process together with the service");
    }
}

/// Limits the address space, so that a job that needs too much memory ends itself, not the service or other jobs.
fn limit_memory(bytes: Option<u64>) {
    if let Some(bytes) = bytes {
        let limit = Rlimit { current: Some(bytes), maximum: Some(bytes) };
        if let Err(error) = setrlimit(Resource::As, limit) {
            tracing::warn!(%error, "the memory of this process is not limited");
        }
    }
    // When the machine runs out of memory, Linux ends this process first.
    #[cfg(target_os = "linux")]
    if let Err(error) = std::fs::write("/proc/self/oom_score_adj", "1000") {
        tracing::debug!(%error, "the out-of-memory priority was not changed");
    }
}

fn read_order() -> anyhow::Result<Order> {
    let mut line = Vec::new();
    std::io::stdin().lock().read_until(b'\n', &mut line)?; // the rest of stdin is read by `end_with_stdin`
    Ok(serde_json::from_slice(&line)?)
}

fn end_with_stdin() {
    let mut byte = [0];
    while matches!(std::io::stdin().read(&mut byte), Ok(n) if n > 0) {}
    std::process::exit(ORPHANED);
}

fn send_heartbeats() {
    loop {
        send(&Message::Alive);
        std::thread::sleep(Duration::from_secs(1));
    }
}

fn send(message: &Message) {
    let mut line = serde_json::to_vec(message).expect("a message is strings and numbers, which always serialise");
    line.push(b'\n');
    let mut stdout = std::io::stdout().lock();
    if stdout.write_all(&line).and_then(|()| stdout.flush()).is_err() {
        std::process::exit(ORPHANED);
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
            ..JobError::default()
        },
        SolveError::Pipeline(PipelineError::Unsolvable { code, reason }) => {
            JobError { code: code.to_owned(), detail: reason, ..JobError::default() }
        }
        SolveError::Write(error) => JobError::of_machine(&error, &detail)
            .unwrap_or_else(|| coded("result_unwritten", "check the log of the service, then submit the job again")),
    }
}
