//! Watching one child: progress, cancel, silence, end.

use super::child::Child;
use crate::service::failpoint::fault;
use crate::service::metrics::Metrics;
use crate::service::protocol::Message;
use crate::service::queue::job::{JobError, JobProgress};
use crate::service::queue::{Claim, Queue, Standing};
use crate::service::settings::JobSettings;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};
use tokio::sync::broadcast;
use tokio::sync::broadcast::error::RecvError;
use tokio_util::sync::CancellationToken;

/// How the child's life ended.
#[derive(Debug)]
pub(super) enum Outcome {
    /// It wrote a result.
    Done,
    /// It gave a typed cause.
    Failed(JobError),
    /// It died, or was killed because it hung.
    Died(String),
    /// We stopped it: canceled, deleted, or the service ends.
    Stopped,
}

/// Progress is written at most this often.
const WRITE_INTERVAL: Duration = Duration::from_secs(1);

/// A share too small to guess the rest from.
const MIN_FRACTION_FOR_ETA: f64 = 0.02;

/// Follows the child to its end; on return it is gone.
pub(super) async fn supervise(
    child: &mut Child,
    queue: &Queue,
    settings: &JobSettings,
    metrics: &Metrics,
    claim: &Claim,
    draining: CancellationToken,
) -> Outcome {
    let mut changes = queue.listen();
    let mut account = Account::new();
    let mut tick = tokio::time::interval(WRITE_INTERVAL);
    tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut last_word = None;
    let outcome = loop {
        tokio::select! {
            message = child.message() => match message {
                Some(Message::Alive) => {
                    account.heard = Instant::now();
                    metrics.note_pulse(&claim.job);
                }
                Some(progress @ Message::Progress { .. }) => account.note(progress),
                Some(word) => last_word = Some(word),
                None => break None,
            },
            () = own_change(&mut changes, &claim.job) => {
                if !is_wanted(queue, claim).await {
                    break Some(Outcome::Stopped);
                }
            }
            () = draining.cancelled() => break Some(Outcome::Stopped),
            _ = tick.tick() => {
                account.write(queue, claim).await;
                if !is_wanted(queue, claim).await {
                    break Some(Outcome::Stopped);
                }
                if let Some(how) = account.hangs(settings) {
                    break Some(Outcome::Died(how));
                }
            }
        }
    };
    let outcome = match outcome {
        Some(outcome) => {
            child.stop(settings.kill_grace).await;
            outcome
        }
        None => end(child, settings, last_word).await,
    };
    if matches!(outcome, Outcome::Died(_)) {
        metrics.child_deaths.fetch_add(1, Ordering::Relaxed);
    }
    account.close_stage();
    metrics.note_stages(&account.stage_seconds);
    account.write(queue, claim).await;
    outcome
}

/// The end of a child that has closed its stdout: its exit status, and its last word where the two agree.
async fn end(child: &mut Child, settings: &JobSettings, last_word: Option<Message>) -> Outcome {
    let status = tokio::time::timeout(settings.silence_limit, child.wait()).await;
    match (status, last_word) {
        (Ok(Ok(status)), Some(Message::Done)) if status.success() => Outcome::Done,
        (Ok(Ok(status)), Some(Message::Failed { error })) if status.code().is_some() => Outcome::Failed(error),
        (Ok(Ok(status)), _) => Outcome::Died(status.to_string()),
        (Ok(Err(error)), _) => Outcome::Died(error.to_string()),
        (Err(_), _) => {
            child.stop(settings.kill_grace).await;
            Outcome::Died("it closed its output and did not end".to_owned())
        }
    }
}

/// Returns when the job's row may have changed.
async fn own_change(changes: &mut broadcast::Receiver<Arc<str>>, job: &str) {
    loop {
        match changes.recv().await {
            Ok(changed) if *changed != *job => {}
            Ok(_) | Err(RecvError::Lagged(_)) => return,
            Err(RecvError::Closed) => std::future::pending().await,
        }
    }
}

/// A database that does not answer stops no work: the end of the job will find out.
async fn is_wanted(queue: &Queue, claim: &Claim) -> bool {
    match queue.standing(claim).await {
        Ok(standing) => standing == Standing::Wanted || fault("cancel.deaf"),
        Err(error) => {
            tracing::warn!(job.id = %claim.job, %error, "the job's standing could not be read");
            true
        }
    }
}

/// What is known of the child's progress and not yet written.
struct Account {
    started: Instant,
    heard: Instant,
    advanced: Instant,
    progress: JobProgress,
    stage_started: Instant,
    stage_seconds: BTreeMap<String, f64>,
    is_dirty: bool,
}

impl Account {
    fn new() -> Self {
        let now = Instant::now();
        Self {
            started: now,
            heard: now,
            advanced: now,
            progress: JobProgress::default(),
            stage_started: now,
            stage_seconds: BTreeMap::new(),
            is_dirty: false,
        }
    }

    fn note(&mut self, message: Message) {
        let Message::Progress { stage, stage_index, stage_count, fraction, message } = message else { return };
        let now = Instant::now();
        (self.heard, self.advanced, self.is_dirty) = (now, now, true);
        if stage != self.progress.stage {
            self.close_stage();
        }
        let fraction = fraction.clamp(self.progress.fraction, 1.0);
        let elapsed_s = now.duration_since(self.started).as_secs_f64();
        let eta_s = (fraction > MIN_FRACTION_FOR_ETA).then(|| (elapsed_s * (1.0 - fraction) / fraction).round());
        self.progress = JobProgress {
            stage,
            stage_index: stage_index as i64,
            stage_count: stage_count as i64,
            fraction,
            message,
            eta_s,
        };
    }

    /// Adds the time since its start to the stage at work; a stage may come again in a later round.
    fn close_stage(&mut self) {
        let now = Instant::now();
        if !self.progress.stage.is_empty() {
            let seconds = now.duration_since(self.stage_started).as_secs_f64();
            *self.stage_seconds.entry(self.progress.stage.clone()).or_default() += seconds;
            self.is_dirty = true;
        }
        self.stage_started = now;
    }

    async fn write(&mut self, queue: &Queue, claim: &Claim) {
        if !std::mem::take(&mut self.is_dirty) {
            return;
        }
        if let Err(error) = queue.heartbeat(claim, &self.progress, &self.stage_seconds).await {
            tracing::warn!(job.id = %claim.job, %error, "progress could not be written");
        }
    }

    fn hangs(&self, settings: &JobSettings) -> Option<String> {
        if fault("silence.tolerated") {
            return None;
        }
        if self.heard.elapsed() > settings.silence_limit {
            return Some(format!("it was silent for {} s and was killed", settings.silence_limit.as_secs()));
        }
        let stalled = self.advanced.elapsed() > settings.stall_limit;
        stalled.then(|| format!("it made no progress for {} s and was killed", settings.stall_limit.as_secs()))
    }
}
