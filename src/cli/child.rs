//! Start of every child process of the service: it reads its order, limits itself, and ends together with the service.

use super::confinement::{Access, confine};
use crate::service::protocol::Order;
use rustix::process::{Resource, Rlimit, getppid, nice, setrlimit};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io::{BufRead, Read, Write};
use std::process::ExitCode;

/// Exit code of a child whose service has ended.
const ORPHANED: i32 = 3;

/// Lower priority than the threads that answer clients, which stay responsive while every core solves.
const NICENESS: i32 = 5;

/// What distinguishes the children of one command.
pub(super) struct Kind {
    /// Name of the command.
    pub(super) command: &'static str,
    /// Bias of the kernel's choice when memory runs out (`oom_score_adj`), thousandths of the memory: the process with
    /// the largest sum of memory and bias is ended. Uploads have 1000. Jobs have 250, so that even a job with three
    /// quarters of the memory stays behind an upload, and any job before the service, which has 0.
    pub(super) oom_score: u16,
}

/// Reads the order, applies its limits, and starts to watch the service. `access` names the files that the work needs;
/// from then on nothing else can be opened.
///
/// # Errors
/// The exit code, if the order cannot be read.
pub(super) fn begin<T: DeserializeOwned>(
    kind: &Kind,
    access: impl FnOnce(&T) -> Access<'_>,
) -> Result<Order<T>, ExitCode> {
    die_with_parent();
    let order: Order<T> = read_order().map_err(|error| {
        eprintln!("wandless {}: {error:#}: only the service runs this command", kind.command);
        ExitCode::from(2)
    })?;
    if getppid().map_or(0, |pid| pid.as_raw_nonzero().get()) != order.parent {
        std::process::exit(ORPHANED); // the service ended before `die_with_parent` took effect
    }
    if let Err(error) = nice(NICENESS) {
        tracing::debug!(%error, "the priority of this process was not lowered");
    }
    limit_memory(order.memory_bytes, kind.oom_score);
    confine(&access(&order.task)); // before the first thread: each thread has its own confinement
    std::thread::spawn(end_with_stdin);
    Ok(order)
}

/// Ends this process together with the service: on Linux by the kernel, elsewhere at the end of stdin.
fn die_with_parent() {
    #[cfg(target_os = "linux")]
    if let Err(error) = rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::KILL)) {
        tracing::warn!(%error, "the kernel will not end this process together with the service");
    }
}

/// Limits the address space, so that work that needs too much memory ends itself, not the service or other work.
fn limit_memory(bytes: Option<u64>, oom_score: u16) {
    if let Some(bytes) = bytes {
        let limit = Rlimit { current: Some(bytes), maximum: Some(bytes) };
        if let Err(error) = setrlimit(Resource::As, limit) {
            tracing::warn!(%error, "the memory of this process is not limited");
        }
    }
    // When the machine runs out of memory, Linux ends this process first.
    if cfg!(target_os = "linux")
        && let Err(error) = std::fs::write("/proc/self/oom_score_adj", oom_score.to_string())
    {
        tracing::debug!(%error, "the out-of-memory priority was not changed");
    }
}

fn read_order<T: DeserializeOwned>() -> anyhow::Result<Order<T>> {
    let mut line = Vec::new();
    std::io::stdin().lock().read_until(b'\n', &mut line)?; // the rest of stdin is read by `end_with_stdin`
    Ok(serde_json::from_slice(&line)?)
}

fn end_with_stdin() {
    let mut byte = [0];
    while matches!(std::io::stdin().read(&mut byte), Ok(n) if n > 0) {}
    std::process::exit(ORPHANED);
}

/// Sends one message to the service.
pub(super) fn send(message: &impl Serialize) {
    let mut line = serde_json::to_vec(message).expect("a message is strings and numbers, which always serialise");
    line.push(b'\n');
    let mut stdout = std::io::stdout().lock();
    if stdout.write_all(&line).and_then(|()| stdout.flush()).is_err() {
        std::process::exit(ORPHANED);
    }
}
