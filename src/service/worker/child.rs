//! The child process of one job.

use crate::service::protocol::{Message, Order};
use anyhow::Context;
use rustix::process::{Pid, Signal, kill_process};
use std::path::Path;
use std::process::{ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader, Lines};
use tokio::process::{ChildStderr, ChildStdin, ChildStdout, Command};
use tokio::task::JoinHandle;

/// A running `wandless run-job`.
pub(super) struct Child {
    process: tokio::process::Child,
    lines: Lines<BufReader<ChildStdout>>,
    /// Kept open without writing; when it closes, the child notices that the service is gone.
    _stdin: ChildStdin,
    /// Set when stderr reports a failed allocation.
    ran_out_of_memory: Arc<AtomicBool>,
    /// Task that reads the child's stderr to its end.
    listener: JoinHandle<()>,
}

/// Messages of a failed allocation: of the standard library on abort, and of an error value.
const OUT_OF_MEMORY: [&str; 2] = ["memory allocation of ", "OutOfMemory"];

/// Maximal length of a log line, characters; the rest is cut.
const MAX_LINE: usize = 2000;

impl Child {
    /// Starts the child process and sends its order; `log` receives every line of its stderr.
    ///
    /// Must be called on a thread that lives as long as the service: the kernel kills the child with the *thread* that
    /// started it.
    pub(super) async fn start(
        program: &Path,
        order: &Order,
        log: impl Fn(&str) + Send + 'static,
    ) -> anyhow::Result<Self> {
        let mut process = Command::new(program)
            .arg("run-job")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .process_group(0) // Ctrl-C at the terminal must reach the service only
            .kill_on_drop(true)
            .spawn()
            .with_context(|| format!("{}", program.display()))?;
        let mut stdin = process.stdin.take().context("the child has no stdin")?;
        let stdout = process.stdout.take().context("the child has no stdout")?;
        let stderr = process.stderr.take().context("the child has no stderr")?;
        let ran_out_of_memory = Arc::new(AtomicBool::new(false));
        let listener = tokio::spawn(listen(stderr, ran_out_of_memory.clone(), log));
        let mut line = serde_json::to_vec(order)?;
        line.push(b'\n');
        // `wait` reports a child that crashed before reading its order, with its exit status.
        if let Err(error) = stdin.write_all(&line).await {
            tracing::warn!(%error, "cannot send the order to the job's process");
        }
        Ok(Self { process, lines: BufReader::new(stdout).lines(), _stdin: stdin, ran_out_of_memory, listener })
    }

    /// Whether a memory allocation failed.
    pub(super) fn ran_out_of_memory(&self) -> bool {
        self.ran_out_of_memory.load(Ordering::Relaxed)
    }

    /// Process id while the process is running.
    pub(super) fn pid(&self) -> Option<u32> {
        self.process.id()
    }

    /// Waits for the next message; `None` once the child has closed its stdout. Other lines are skipped.
    pub(super) async fn message(&mut self) -> Option<Message> {
        loop {
            match self.lines.next_line().await {
                Ok(Some(line)) => match serde_json::from_str(&line) {
                    Ok(message) => return Some(message),
                    Err(error) => tracing::warn!(%error, "the job's process wrote a line that is not a message"),
                },
                Ok(None) | Err(_) => return None,
            }
        }
    }

    /// Waits until the process has ended and its stderr is read.
    pub(super) async fn wait(&mut self) -> std::io::Result<ExitStatus> {
        let status = self.process.wait().await?;
        if !self.listener.is_finished() {
            // A process started by the child may keep the pipe open, so the wait is limited.
            let _ = tokio::time::timeout(Duration::from_secs(1), &mut self.listener).await;
        }
        Ok(status)
    }

    /// Ends the process: SIGTERM first, SIGKILL after `grace`. Returns when the process has ended.
    pub(super) async fn stop(&mut self, grace: Duration) {
        let pid = self.process.id().and_then(|id| Pid::from_raw(i32::try_from(id).ok()?));
        if let Some(pid) = pid
            && kill_process(pid, Signal::TERM).is_ok()
            && tokio::time::timeout(grace, self.process.wait()).await.is_ok()
        {
            return;
        }
        if let Err(error) = self.process.kill().await {
            tracing::error!(%error, "cannot kill the job's process");
        }
    }
}

async fn listen(stderr: ChildStderr, ran_out_of_memory: Arc<AtomicBool>, log: impl Fn(&str)) {
    let mut lines = BufReader::new(stderr).lines();
    while let Ok(Some(line)) = lines.next_line().await {
        if OUT_OF_MEMORY.iter().any(|message| line.contains(message)) {
            ran_out_of_memory.store(true, Ordering::Relaxed);
        }
        log(line.char_indices().nth(MAX_LINE).map_or(&line, |(end, _)| &line[..end]));
    }
}
