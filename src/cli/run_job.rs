//! `wandless run-job`: one job, in a child process of the service.
//!
//! The order comes as the first line of stdin, events go out as JSON lines on stdout. A SIGTERM ends the process at once,
//! which is how a job is canceled: nothing of it was published, and the service clears its folder.

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

/// Exit code of an orphan; nobody is left to read it.
const ORPHANED: i32 = 3;

/// Yields to the threads that answer clients, so that they stay prompt while every core solves.
const NICENESS: i32 = 5;

/// Progress is told at most this often.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(100);

/// Runs the child.
pub(super) fn run() -> ExitCode {
    die_with_parent();
    let order = match read_order() {
        Ok(order) => order,
        Err(error) => {
            eprintln!("wandless run-job: {error:#}: this command is the service's own");
            return ExitCode::from(2);
        }
    };
    if getppid().map_or(0, |pid| pid.as_raw_nonzero().get()) != order.parent {
        std::process::exit(ORPHANED); // the service died before we had asked to die with it
    }
    std::thread::spawn(end_with_stdin);
    std::thread::spawn(say_alive);
    if let Err(error) = nice(NICENESS) {
        tracing::debug!(%error, "the niceness stays as it is");
    }
    hold_memory_to(order.memory_bytes);
    use_threads(order.threads);
    let progress = Progress::new(teller(), Arc::default());
    match solved(&order, &progress) {
        Ok(()) => {
            say(&Message::Done);
            ExitCode::SUCCESS
        }
        Err(error) => {
            say(&Message::Failed { error });
            ExitCode::FAILURE
        }
    }
}

fn solved(order: &Order, progress: &Progress) -> Result<(), JobError> {
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
    solved.map(drop).map_err(cause)
}

/// On Linux the kernel ends us with the service; elsewhere the end of stdin does.
fn die_with_parent() {
    #[cfg(target_os = "linux")]
    if let Err(error) = rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::KILL)) {
        tracing::warn!(%error, "the kernel will not end this process with its service");
    }
}

/// What needs more than its share of memory ends itself, not the service or its neighbours.
fn hold_memory_to(bytes: Option<u64>) {
    if let Some(bytes) = bytes {
        let limit = Rlimit { current: Some(bytes), maximum: Some(bytes) };
        if let Err(error) = setrlimit(Resource::As, limit) {
            tracing::warn!(%error, "the process's memory stays unlimited");
        }
    }
    // Where the whole machine runs out, Linux takes this process first.
    #[cfg(target_os = "linux")]
    if let Err(error) = std::fs::write("/proc/self/oom_score_adj", "1000") {
        tracing::debug!(%error, "the kernel will not end this process first");
    }
}

fn read_order() -> anyhow::Result<Order> {
    let mut line = Vec::new();
    std::io::stdin().lock().read_until(b'\n', &mut line)?; // what follows stays for `end_with_stdin`
    Ok(serde_json::from_slice(&line)?)
}

fn end_with_stdin() {
    let mut byte = [0];
    while matches!(std::io::stdin().read(&mut byte), Ok(n) if n > 0) {}
    std::process::exit(ORPHANED);
}

fn say_alive() {
    loop {
        say(&Message::Alive);
        std::thread::sleep(Duration::from_secs(1));
    }
}

fn say(message: &Message) {
    let mut line = serde_json::to_vec(message).expect("a message is strings and numbers, which always serialise");
    line.push(b'\n');
    let mut stdout = std::io::stdout().lock();
    if stdout.write_all(&line).and_then(|()| stdout.flush()).is_err() {
        std::process::exit(ORPHANED);
    }
}

/// Tells progress, but no faster than anybody reads; every first word of a stage is told.
fn teller() -> impl Fn(&ProgressEvent) + Send + Sync {
    let last = Mutex::new(None::<(&'static str, Instant)>);
    move |event| {
        let mut last = last.lock().unwrap_or_else(PoisonError::into_inner);
        let is_new = last.is_none_or(|(stage, _)| stage != event.stage);
        if !is_new && last.is_some_and(|(_, at)| at.elapsed() < PROGRESS_INTERVAL) {
            return;
        }
        *last = Some((event.stage, Instant::now()));
        say(&Message::Progress {
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

fn cause(error: SolveError) -> JobError {
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
        SolveError::Write(error) if error.kind() == std::io::ErrorKind::StorageFull => {
            coded("disk_full", "free disk space, then submit the job again")
        }
        SolveError::Write(_) => coded("result_unwritten", "look into the service's log, then submit the job again"),
    }
}
