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
    /// Never written to again; its end tells the child that we are gone.
    _stdin: ChildStdin,
    /// Set once the child has said so.
    ran_out_of_memory: Arc<AtomicBool>,
    /// Reads the child's stderr to its end.
    listener: JoinHandle<()>,
}

/// Last words for want of memory: the standard library's where an allocation fails, and an error's where one was refused.
const OUT_OF_MEMORY: [&str; 2] = ["memory allocation of ", "OutOfMemory"];

/// Characters of a line of the child's log that are kept.
const MAX_LINE: usize = 2000;

impl Child {
    /// Starts the child and gives it its order; `log` is told every line of its stderr.
    ///
    /// Must be called on a thread that lives as long as the service: the child asks the kernel to die with the *thread*
    /// that made it.
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
            .process_group(0) // a Ctrl-C at the terminal is the service's to handle
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
        // A child that died before it read its order is seen by `wait`, with its exit status.
        if let Err(error) = stdin.write_all(&line).await {
            tracing::warn!(%error, "the job's process did not take its order");
        }
        Ok(Self { process, lines: BufReader::new(stdout).lines(), _stdin: stdin, ran_out_of_memory, listener })
    }

    /// Whether it ended for want of memory.
    pub(super) fn ran_out_of_memory(&self) -> bool {
        self.ran_out_of_memory.load(Ordering::Relaxed)
    }

    /// Its process id, while it lives.
    pub(super) fn pid(&self) -> Option<u32> {
        self.process.id()
    }

    /// The next message; `None` once the child has closed its stdout. What is no message is passed over.
    pub(super) async fn message(&mut self) -> Option<Message> {
        loop {
            match self.lines.next_line().await {
                Ok(Some(line)) => match serde_json::from_str(&line) {
                    Ok(message) => return Some(message),
                    Err(error) => tracing::warn!(%error, "the job's process said something else"),
                },
                Ok(None) | Err(_) => return None,
            }
        }
    }

    /// Waits for its end, and for its last words.
    pub(super) async fn wait(&mut self) -> std::io::Result<ExitStatus> {
        let status = self.process.wait().await?;
        if !self.listener.is_finished() {
            // A process that it has started may hold the pipe open; nobody waits for that one.
            let _ = tokio::time::timeout(Duration::from_secs(1), &mut self.listener).await;
        }
        Ok(status)
    }

    /// Ends it: a request first, force after `grace`. Returns when it is gone.
    pub(super) async fn stop(&mut self, grace: Duration) {
        let pid = self.process.id().and_then(|id| Pid::from_raw(i32::try_from(id).ok()?));
        if let Some(pid) = pid
            && kill_process(pid, Signal::TERM).is_ok()
            && tokio::time::timeout(grace, self.process.wait()).await.is_ok()
        {
            return;
        }
        if let Err(error) = self.process.kill().await {
            tracing::error!(%error, "the job's process could not be killed");
        }
    }
}

async fn listen(stderr: ChildStderr, ran_out_of_memory: Arc<AtomicBool>, log: impl Fn(&str)) {
    let mut lines = BufReader::new(stderr).lines();
    while let Ok(Some(line)) = lines.next_line().await {
        if OUT_OF_MEMORY.iter().any(|words| line.contains(words)) {
            ran_out_of_memory.store(true, Ordering::Relaxed);
        }
        log(line.char_indices().nth(MAX_LINE).map_or(&line, |(end, _)| &line[..end]));
    }
}
