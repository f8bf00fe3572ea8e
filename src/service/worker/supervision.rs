//! Supervision of one child process: progress, provisional scenes, cancellation, silence, exit.

use crate::service::child::Child;
use crate::service::failpoint::fault;
use crate::service::metrics::Metrics;
use crate::service::protocol::Message;
use crate::service::queue::job::{JobError, JobProgress};
use crate::service::queue::{Claim, ClaimStatus, Queue};
use crate::service::settings::JobSettings;
use std::collections::BTreeMap;
use std::os::unix::process::ExitStatusExt;
use std::pin::pin;
use std::process::ExitStatus;
use std::time::{Duration, Instant};
use tokio::sync::watch;
use tokio::time::{Interval, MissedTickBehavior};
use tokio_util::sync::CancellationToken;

/// How a child process ended.
#[derive(Debug)]
pub(super) enum ChildExit {
    /// It wrote a result.
    Done,
    /// It reported a typed error.
    Failed(JobError),
    /// It crashed, or was killed because it hung.
    Crashed(Crash),
    /// The service stopped it: the job was canceled or deleted, or the service ends.
    Stopped,
}

/// End of a child process without a report.
#[derive(Debug)]
pub(super) struct Crash {
    /// How it ended.
    pub(super) how: String,
    /// Signal that ended it, unless the service sent it.
    pub(super) signal: Option<i32>,
}

impl From<ExitStatus> for Crash {
    fn from(status: ExitStatus) -> Self {
        Self { how: status.to_string(), signal: status.signal() }
    }
}

impl From<String> for Crash {
    fn from(how: String) -> Self {
        Self { how, signal: None }
    }
}

/// Time between two writes of progress, and between two looks for a hang.
const WRITE_INTERVAL: Duration = Duration::from_secs(1);

/// Smallest completed share from which the remaining time is estimated.
const MIN_FRACTION_FOR_ETA: f64 = 0.02;

/// Supervises the child process until it has ended. Its messages are read beside every use of the database: while that is away, no
/// child counts as silent.
pub(super) async fn supervise(
    child: &mut Child,
    queue: &Queue,
    settings: &JobSettings,
    metrics: &Metrics,
    claim: &Claim,
    draining: CancellationToken,
) -> ChildExit {
    let mut tracker = ProgressTracker::new();
    let mut unwritten = tracker.notes.subscribe();
    let mut last_message = None;
    let exit = {
        let mut end_of_claim = pin!(end_of_claim(queue, claim, &mut unwritten));
        let mut tick = ticks();
        loop {
            tokio::select! {
                message = child.message() => match message {
                    Some(Message::Alive) => {
                        tracker.last_message_at = Instant::now();
                        metrics.note_heartbeat(&claim.job);
                    }
                    Some(progress @ Message::Progress { .. }) => tracker.note(progress),
                    Some(Message::Scene { stage, document }) => {
                        tracker.last_message_at = Instant::now();
                        queue.show_scene(&claim.job, stage, document);
                    }
                    Some(message) => last_message = Some(message),
                    None => break None,
                },
                () = &mut end_of_claim => break Some(ChildExit::Stopped),
                () = draining.cancelled() => break Some(ChildExit::Stopped),
                _ = tick.tick() => {
                    if let Some(how) = tracker.hang(settings) {
                        break Some(ChildExit::Crashed(how.into()));
                    }
                }
            }
        }
    };
    let exit = match exit {
        Some(exit) => {
            child.stop(settings.kill_grace).await;
            exit
        }
        None => wait_for_exit(child, settings, last_message).await,
    };
    queue.remove_scene(&claim.job);
    if let ChildExit::Crashed(Crash { how, signal }) = &exit {
        metrics.child_crashes.inc();
        tracing::warn!(signal, how, "the job's process crashed");
    }
    tracker.close_stage();
    metrics.note_stages(&tracker.notes.borrow().stage_seconds);
    write_notes(queue, claim, &mut unwritten).await;
    exit
}

/// Writes progress once a second until the claim ends.
async fn end_of_claim(queue: &Queue, claim: &Claim, unwritten: &mut watch::Receiver<Notes>) {
    let mut changes = queue.follow(&claim.job);
    let mut tick = ticks();
    loop {
        tokio::select! {
            true = changes.changed() => {}
            _ = tick.tick() => write_notes(queue, claim, unwritten).await,
        }
        if !is_active(queue, claim).await {
            return;
        }
    }
}

/// Ticks of [`WRITE_INTERVAL`].
fn ticks() -> Interval {
    let mut tick = tokio::time::interval(WRITE_INTERVAL);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    tick
}

async fn write_notes(queue: &Queue, claim: &Claim, unwritten: &mut watch::Receiver<Notes>) {
    if !unwritten.has_changed().unwrap_or(true) {
        return;
    }
    let Notes { progress, stage_seconds } = unwritten.borrow_and_update().clone();
    if let Err(error) = queue.heartbeat(claim, &progress, &stage_seconds).await {
        tracing::warn!(%error, "cannot write progress");
    }
}

/// Waits for a child that has closed its stdout; its last message counts only if the exit status agrees with it.
async fn wait_for_exit(child: &mut Child, settings: &JobSettings, last_message: Option<Message>) -> ChildExit {
    let status = tokio::time::timeout(settings.silence_limit, child.wait()).await;
    match (status, last_message) {
        (Ok(Ok(status)), Some(Message::Done)) if status.success() => ChildExit::Done,
        (Ok(Ok(status)), Some(Message::Failed { error })) if status.code().is_some() => ChildExit::Failed(error),
        (Ok(Ok(status)), _) => ChildExit::Crashed(status.into()),
        (Ok(Err(error)), _) => ChildExit::Crashed(error.to_string().into()),
        (Err(_), _) => {
            child.stop(settings.kill_grace).await;
            ChildExit::Crashed("it closed its output but did not exit".to_owned().into())
        }
    }
}

/// Whether the claim is still valid. If the database fails, the work continues; recording the outcome checks again.
async fn is_active(queue: &Queue, claim: &Claim) -> bool {
    match queue.claim_status(claim).await {
        Ok(status) => status == ClaimStatus::Active || fault("cancel.deaf"),
        Err(error) => {
            tracing::warn!(%error, "cannot read the status of the claim");
            true
        }
    }
}

/// What the row of the job shows of the child process.
#[derive(Debug, Clone, Default)]
struct Notes {
    progress: JobProgress,
    stage_seconds: BTreeMap<String, f64>,
}

/// Progress of the child process and when it last reported.
struct ProgressTracker {
    started: Instant,
    last_message_at: Instant,
    last_progress_at: Instant,
    stage_started: Instant,
    notes: watch::Sender<Notes>,
}

impl ProgressTracker {
    fn new() -> Self {
        let now = Instant::now();
        Self {
            started: now,
            last_message_at: now,
            last_progress_at: now,
            stage_started: now,
            notes: watch::Sender::default(),
        }
    }

    fn note(&mut self, message: Message) {
        let Message::Progress { stage, stage_index, stage_count, fraction, message } = message else { return };
        let now = Instant::now();
        (self.last_message_at, self.last_progress_at) = (now, now);
        if stage != self.notes.borrow().progress.stage {
            self.close_stage();
        }
        let elapsed_s = now.duration_since(self.started).as_secs_f64();
        self.notes.send_modify(|Notes { progress, .. }| {
            let fraction = fraction.clamp(progress.fraction, 1.0);
            let eta_s = (fraction > MIN_FRACTION_FOR_ETA).then(|| (elapsed_s * (1.0 - fraction) / fraction).round());
            let (stage_index, stage_count) = (stage_index as i64, stage_count as i64);
            *progress = JobProgress { stage, stage_index, stage_count, fraction, message, eta_s };
        });
    }

    /// Adds the elapsed time to the current stage; a stage can run again in a later round.
    fn close_stage(&mut self) {
        let now = Instant::now();
        let seconds = now.duration_since(self.stage_started).as_secs_f64();
        self.stage_started = now;
        self.notes.send_if_modified(|Notes { progress, stage_seconds }| {
            let is_open = !progress.stage.is_empty();
            if is_open {
                *stage_seconds.entry(progress.stage.clone()).or_default() += seconds;
            }
            is_open
        });
    }

    /// Returns a description if the child process is silent or stalled.
    fn hang(&self, settings: &JobSettings) -> Option<String> {
        if fault("silence.tolerated") {
            return None;
        }
        if self.last_message_at.elapsed() > settings.silence_limit {
            return Some(format!("it sent no message for {} s and was killed", settings.silence_limit.as_secs()));
        }
        let stalled = self.last_progress_at.elapsed() > settings.stall_limit;
        stalled.then(|| format!("it made no progress for {} s and was killed", settings.stall_limit.as_secs()))
    }
}
