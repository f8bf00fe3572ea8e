//! A child process of the service, which solves one job or validates one upload.
//!
//! Why a process of its own: an abort, a memory limit or a hang ends one piece of work and nothing else.

use super::protocol::{Order, READ_UPLOAD};
use anyhow::Context;
use rustix::process::{Pid, Signal, kill_process};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::Path;
use std::process::{ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncRead, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::process::{ChildStdin, ChildStdout, Command};
use tokio::task::JoinHandle;
use tracing::{Instrument, Level};

/// A running child process.
pub(super) struct Child {
    process: tokio::process::Child,
    stdout: BufReader<ChildStdout>,
    /// Beginning of the line that is being read.
    line: Vec<u8>,
    /// Kept open without writing; when it closes, the child notices that the service is gone.
    _stdin: ChildStdin,
    /// Set when stderr reports a failed allocation.
    ran_out_of_memory: Arc<AtomicBool>,
    /// Task that reads the child's stderr to its end.
    listener: JoinHandle<()>,
}

/// Messages of a failed allocation: of the standard library on abort, and of an error value.
const OUT_OF_MEMORY: [&str; 2] = ["memory allocation of ", "OutOfMemory"];

/// Maximal length of a message, bytes; a longer one counts as the end of the output. The longest is the summary of an
/// upload with 64 long camera names and many warnings.
const MAX_MESSAGE: usize = 8 << 20;

/// Maximal length of a log line, characters; the rest is cut.
const MAX_LINE: usize = 2000;

/// Bytes of stderr that are held until a line ends; what is longer counts as several lines.
const MAX_LINE_BYTES: u64 = 64 << 10;

impl Child {
    /// Starts the program with a command of a child and sends the order; `log` receives every line of its stderr.
    ///
    /// Must be called on a thread that lives as long as the service: the kernel kills the child with the *thread* that
    /// started it.
    pub(super) async fn start(
        program: &Path,
        command: &str,
        order: &Order<impl Serialize>,
        log: impl Fn(&str) + Send + 'static,
    ) -> anyhow::Result<Self> {
        let mut process = Command::new(program)
            .arg(command)
            .envs(allocator_settings(command))
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
        let listener = tokio::spawn(listen(stderr, ran_out_of_memory.clone(), log).in_current_span());
        let mut line = serde_json::to_vec(order)?;
        line.push(b'\n');
        // `wait` reports a child that crashed before reading its order, with its exit status.
        if let Err(error) = stdin.write_all(&line).await {
            tracing::warn!(%error, "cannot send the order to the child process");
        }
        Ok(Self {
            process,
            stdout: BufReader::new(stdout),
            line: Vec::new(),
            _stdin: stdin,
            ran_out_of_memory,
            listener,
        })
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
    pub(super) async fn message<M: DeserializeOwned>(&mut self) -> Option<M> {
        loop {
            // Canceled and called again, it continues the line.
            let room = MAX_MESSAGE.saturating_sub(self.line.len()) as u64;
            let read = (&mut self.stdout).take(room).read_until(b'\n', &mut self.line).await;
            if read.is_err() || self.line.last() != Some(&b'\n') {
                return None;
            }
            match serde_json::from_slice(&std::mem::take(&mut self.line)) {
                Ok(message) => return Some(message),
                Err(error) => tracing::warn!(%error, "the child process wrote a line that is not a message"),
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
            tracing::error!(%error, "cannot kill the child process");
        }
    }
}

/// Variables for the allocator of a child. glibc reserves up to 64 MiB of address space, which the limit of memory counts, for every
/// thread that allocates: a read of an upload, whose limit may be 256 MiB, has them share one region. A job would take 20 % longer.
fn allocator_settings(command: &str) -> Option<(&'static str, &'static str)> {
    (command == READ_UPLOAD).then_some(("MALLOC_ARENA_MAX", "1"))
}

/// Reads stderr to its end, whatever its bytes are: a child whose stderr is not read stands still once the pipe is full.
async fn listen(stderr: impl AsyncRead + Unpin, ran_out_of_memory: Arc<AtomicBool>, log: impl Fn(&str)) {
    let (mut stderr, mut bytes) = (BufReader::new(stderr), Vec::new());
    while let Ok(1..) = (&mut stderr).take(MAX_LINE_BYTES).read_until(b'\n', &mut bytes).await {
        let line = String::from_utf8_lossy(&bytes);
        let line = line.trim_end_matches(['\n', '\r']);
        if OUT_OF_MEMORY.iter().any(|message| line.contains(message)) {
            ran_out_of_memory.store(true, Ordering::Relaxed);
        }
        let line = line.char_indices().nth(MAX_LINE).map_or(line, |(end, _)| &line[..end]);
        repeat(line);
        log(line);
        bytes.clear();
    }
}

/// Logs a line of the child at the level that it starts with; other lines, such as a panic's, are warnings.
fn repeat(line: &str) {
    let (level, text) = level_of(line);
    match level {
        Level::ERROR => tracing::error!("{text}"),
        Level::WARN => tracing::warn!("{text}"),
        Level::INFO => tracing::info!("{text}"),
        Level::DEBUG => tracing::debug!("{text}"),
        Level::TRACE => tracing::trace!("{text}"),
    }
}

/// Splits `INFO target: text` into the level and the rest.
fn level_of(line: &str) -> (Level, &str) {
    let trimmed = line.trim_start();
    let (word, rest) = trimmed.split_once(' ').unwrap_or((trimmed, ""));
    match word.parse() {
        Ok(level) if word.len() > 1 => (level, rest),
        _ => (Level::WARN, line),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;

    #[tokio::test]
    async fn stderr_is_read_to_its_end_whatever_its_bytes() {
        let mut stderr = b"a \xff b\r\n".to_vec();
        stderr.extend(vec![b'x'; 3 * MAX_LINE_BYTES as usize]); // no line may fill the memory
        stderr.extend(b"\nmemory allocation of 80 bytes failed\nlast");
        let (lines, is_out) = (Mutex::new(Vec::new()), Arc::new(AtomicBool::new(false)));
        listen(&*stderr, is_out.clone(), |line| lines.lock().unwrap().push(line.to_owned())).await;
        let lines = lines.into_inner().unwrap();
        assert_eq!((lines[0].as_str(), lines.last().unwrap().as_str()), ("a \u{fffd} b", "last"));
        assert!(lines.iter().all(|line| line.len() <= MAX_LINE) && is_out.load(Ordering::Relaxed));
    }

    #[test]
    fn reads_the_level_of_a_log_line() {
        assert_eq!(level_of(" INFO wandless::pipeline: resumed"), (Level::INFO, "wandless::pipeline: resumed"));
        assert_eq!(level_of("ERROR wandless: x"), (Level::ERROR, "wandless: x"));
        for line in ["memory allocation of 80 bytes failed", "thread 'main' panicked at x.rs:1:2:", "", "3 cameras"] {
            assert_eq!(level_of(line), (Level::WARN, line));
        }
    }
}
