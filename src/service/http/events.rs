//! `GET /v1/jobs/{id}/events`: the progress of a job as server-sent events.
//!
//! `state` holds the whole job and is sent first, at every change of state, and last, that of an ended job last alone; `progress`
//! holds the progress, `log` one line of the job's process, `scene` the stage after which there is a new provisional scene. The id
//! of an event is the version of the job: a client that reconnects with `Last-Event-ID` receives the state again only if it has
//! changed.

use super::access::{Caller, Credential};
use super::app::App;
use super::error::Problem;
use super::extract::{ApiPath, JobPath};
use super::jobs::JobDocument;
use crate::service::metrics::Held;
use crate::service::queue::job::{Job, JobProgress};
use crate::service::queue::{Following, LogLine, Phase};
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::sse::{Event, KeepAlive, Sse};
use futures_util::Stream;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::time::Duration;
use tokio::sync::broadcast::Receiver;
use tokio::time::{Interval, MissedTickBehavior};

/// A comment is sent after this time without an event: proxies keep the stream open, and a lost client is noticed.
const KEEP_ALIVE: Duration = Duration::from_secs(10);

/// A stream ends at most this long after its key was revoked.
const KEY_CHECK_INTERVAL: Duration = Duration::from_secs(2);

/// Follow a job.
#[utoipa::path(get, path = "/v1/jobs/{id}/events", operation_id = "followJob", tag = "jobs", params(JobPath),
    responses((status = 200, description = "Events `state`, `progress`, `scene` and `log` until the final state", body = String,
        content_type = "text/event-stream")))]
pub(super) async fn stream(
    State(app): State<App>,
    caller: Caller,
    credential: Credential,
    ApiPath(JobPath { id }): ApiPath<JobPath>,
    headers: HeaderMap,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, Problem> {
    let (changes, log) = (app.queue.follow(&id), app.queue.listen_to_logs()); // before the first read, so that no change is missed
    let job = app.queue.get(&caller.tenant, &id).await?.ok_or_else(|| Problem::not_found("job"))?;
    let mut key_checks = tokio::time::interval(KEY_CHECK_INTERVAL);
    key_checks.set_missed_tick_behavior(MissedTickBehavior::Delay); // a client that reads slowly causes no burst of checks
    let known = headers.get("last-event-id").and_then(|value| value.to_str().ok()?.parse::<i64>().ok());
    let mut follower = Follower {
        held: Held::new(&app.metrics),
        app,
        caller,
        credential,
        key_checks,
        id,
        changes,
        log,
        phase: None,
        progress: JobProgress::default(),
        scene: None,
        waiting: VecDeque::new(),
        is_at_end: false,
    };
    if known == Some(job.version) && !job.state.phase().is_final() {
        (follower.phase, follower.progress) = (Some(job.state.phase()), job.progress);
    } else {
        follower.note(job);
    }
    let events = futures_util::stream::unfold(follower, |mut follower| async move {
        let event = follower.next().await?;
        Some((Ok(event), follower))
    });
    Ok(Sse::new(events).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)))
}

/// State of one event stream: what was sent last, and what waits.
struct Follower {
    app: App,
    caller: Caller,
    credential: Credential,
    key_checks: Interval,
    id: String,
    changes: Following,
    log: Receiver<LogLine>,
    phase: Option<Phase>,
    progress: JobProgress,
    /// Digest of the scene that was announced last.
    scene: Option<String>,
    waiting: VecDeque<Event>,
    is_at_end: bool,
    /// Counts the stream as open while it lives.
    #[allow(dead_code)]
    held: Held,
}

impl Follower {
    /// The next event; `None` after the final state, and when the job was deleted, the key was revoked or the service stops.
    async fn next(&mut self) -> Option<Event> {
        loop {
            if let Some(event) = self.waiting.pop_front() {
                return Some(event);
            }
            if self.is_at_end {
                return None;
            }
            let draining = self.app.draining.clone();
            tokio::select! {
                is_open = self.changes.changed() => match is_open {
                    true => self.read_job().await,
                    false => self.is_at_end = true,
                },
                line = self.log.recv() => {
                    if let Ok(line) = line && *line.job == *self.id {
                        self.waiting.extend(event("log", None, &serde_json::json!({ "line": &*line.line })));
                    }
                },
                _ = self.key_checks.tick() => self.check_key().await,
                () = draining.cancelled() => self.is_at_end = true,
            }
        }
    }

    async fn check_key(&mut self) {
        match self.credential.is_valid(&self.app).await {
            Ok(is_valid) => self.is_at_end = !is_valid,
            Err(error) => tracing::warn!(job.id = self.id, %error, "the key of an event stream could not be checked"),
        }
    }

    async fn read_job(&mut self) {
        match self.app.queue.get(&self.caller.tenant, &self.id).await {
            Ok(Some(job)) => self.note(job),
            Ok(None) => self.is_at_end = true,
            Err(error) => tracing::warn!(job.id = self.id, %error, "the job could not be read for its event streams"),
        }
    }

    /// Queues the events for what differs from the last sent version.
    fn note(&mut self, job: Job) {
        let (phase, version) = (job.state.phase(), Some(job.version));
        let state = (self.phase != Some(phase)).then(|| JobDocument::of(job.clone()));
        self.phase = Some(phase);
        // The state comes first, so that a client knows the job before its progress; the final one ends the stream.
        let (first, last) = if phase.is_final() { (None, state) } else { (state, None) };
        self.waiting.extend(first.and_then(|state| event("state", version, &state)));
        if self.progress != job.progress {
            self.progress = job.progress.clone();
            self.waiting.extend(event("progress", version, &job.progress));
        }
        if let Some(scene) = self.app.queue.scene(&self.id)
            && self.scene.as_ref() != Some(&scene.sha256)
        {
            self.scene = Some(scene.sha256.clone());
            self.waiting.extend(event("scene", None, &serde_json::json!({ "stage": scene.stage })));
        }
        self.waiting.extend(last.and_then(|state| event("state", version, &state)));
        self.is_at_end = phase.is_final();
    }
}

fn event(name: &str, version: Option<i64>, data: &impl serde::Serialize) -> Option<Event> {
    let event = Event::default().event(name).json_data(data).ok()?;
    Some(match version {
        Some(version) => event.id(version.to_string()),
        None => event,
    })
}
