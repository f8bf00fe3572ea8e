//! `/v1/jobs`: submit, list, look, wait, cancel, delete.

use super::error::Problem;
use super::intake::{MediaType, keep, receive_form, unless_refused};
use super::page::{Page, PageQuery};
use super::upload::GuardedBody;
use super::{ApiPath, ApiQuery, App, options};
use crate::service::queue::job::{Job, Phase};
use crate::service::queue::{Cancel, EnqueueError, IdempotencyKey, JobFilter, LabelFilter, NewJob};
use crate::service::store::artifacts::hex;
use crate::service::store::sessions::{self, StoredSession};
use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::time::Instant;

/// Labels of one job.
const MAX_LABELS: usize = 32;
/// Characters of a label's key or value, and of an Idempotency-Key.
const MAX_LABEL_CHARS: usize = 256;
/// `priority` lies within plus and minus this.
const MAX_PRIORITY: i64 = 1000;

/// The body of `POST /v1/jobs` as JSON.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct NewJobBody {
    session: String,
    options: Option<Value>,
    #[serde(default)]
    labels: BTreeMap<String, String>,
    #[serde(default)]
    priority: i64,
    webhook: Option<Value>,
}

/// `POST /v1/jobs`: 202, `Location` and the job.
pub(super) async fn create(State(app): State<App>, headers: HeaderMap, body: Body) -> Result<Response, Problem> {
    let (asked, session) = match MediaType::of(&headers) {
        Some(MediaType::Json) => of_stored_session(&app, &headers, body).await?,
        Some(MediaType::Multipart) => of_uploaded_session(&app, &headers, body).await?,
        _ => return Err(Problem::unsupported_media_type("application/json or multipart/form-data")),
    };
    let parsed = options::parse(asked.options)?;
    options::check(&parsed, &session.summary)?;
    check_marks(&asked.labels, asked.priority)?;
    let options = serde_json::to_value(&parsed).map_err(Problem::internal)?;
    let new = NewJob { session: session.id, options, labels: asked.labels, priority: asked.priority };
    let key = idempotency_key(&headers, &new, &session.summary.sha256)?;
    let job = app.queue.enqueue(&new, key.as_ref(), app.settings.limits.max_queued).await?;
    let location = [(header::LOCATION, format!("/v1/jobs/{}", job.id))];
    Ok((StatusCode::ACCEPTED, location, answer(&job)).into_response())
}

async fn of_stored_session(app: &App, headers: &HeaderMap, body: Body) -> Result<(NewJobBody, StoredSession), Problem> {
    let limits = &app.settings.limits;
    let body = unless_refused(GuardedBody::new(headers, body, limits, limits.max_json_bytes)).await?;
    let text = unless_refused(body.read_all().await).await?;
    let asked: NewJobBody = serde_json::from_slice(&text).map_err(|error| {
        Problem::malformed(
            format!("the body: {error}"),
            "send {\"session\": \"<id>\", \"options\"?: {…}, \"labels\"?: {…}, \"priority\"?: 0}",
        )
    })?;
    if asked.webhook.is_some() {
        return Err(options::not_supported("webhooks are not called yet").at("/webhook"));
    }
    let session = sessions::get(&app.store, &asked.session).await?;
    let session = session.ok_or_else(|| session_missing().at("/session"))?;
    Ok((asked, session))
}

async fn of_uploaded_session(
    app: &App,
    headers: &HeaderMap,
    body: Body,
) -> Result<(NewJobBody, StoredSession), Problem> {
    let form = receive_form(app, headers, body, &["session", "options"]).await?;
    let received = form.session.ok_or_else(|| {
        Problem::malformed("the form has no part `session`", "send the session as the part `session`")
    })?;
    let text = form.options.filter(|text| !text.is_empty());
    let options = text.map(|text| serde_json::from_slice(&text)).transpose().map_err(|error| {
        Problem::malformed(format!("the part `options`: {error}"), "send one JSON object").at("/options")
    })?;
    options::parse(options.clone())?; // before the upload is validated and kept
    let session = keep(app, received).await?.session;
    let asked =
        NewJobBody { session: session.id.clone(), options, labels: BTreeMap::new(), priority: 0, webhook: None };
    Ok((asked, session))
}

fn session_missing() -> Problem {
    Problem::new(
        StatusCode::NOT_FOUND,
        "session_not_found",
        "there is no such session",
        "upload it with POST /v1/sessions",
    )
}

fn check_marks(labels: &BTreeMap<String, String>, priority: i64) -> Result<(), Problem> {
    let is_long = |text: &String| text.chars().count() > MAX_LABEL_CHARS;
    if labels.len() > MAX_LABELS || labels.iter().any(|(key, value)| key.is_empty() || is_long(key) || is_long(value)) {
        let remedy = format!("give at most {MAX_LABELS} labels of 1 to {MAX_LABEL_CHARS} characters");
        return Err(Problem::malformed("labels are too many, too long or empty", remedy).at("/labels"));
    }
    if priority.abs() > MAX_PRIORITY {
        let remedy = format!("take -{MAX_PRIORITY} to {MAX_PRIORITY}");
        return Err(Problem::malformed("priority is out of range", remedy).at("/priority"));
    }
    Ok(())
}

/// The key, bound to the canonical request: a form's boundary and a document's spaces do not count.
fn idempotency_key(headers: &HeaderMap, new: &NewJob, sha256: &str) -> Result<Option<IdempotencyKey>, Problem> {
    let Some(key) = headers.get("idempotency-key") else { return Ok(None) };
    let key =
        key.to_str().ok().filter(|key| (1..=MAX_LABEL_CHARS).contains(&key.len())).ok_or_else(|| {
            Problem::malformed("the Idempotency-Key is empty, too long or no ASCII", "send a fresh UUID")
        })?;
    let request = json!([sha256, new.options, new.labels, new.priority]).to_string();
    let fingerprint = hex(&Sha256::digest(request.as_bytes()));
    Ok(Some(IdempotencyKey { key: key.to_owned(), fingerprint }))
}

impl From<EnqueueError> for Problem {
    fn from(error: EnqueueError) -> Self {
        match error {
            EnqueueError::SessionMissing => session_missing(),
            EnqueueError::KeyReused => Self::new(
                StatusCode::UNPROCESSABLE_ENTITY,
                "idempotency_key_reused",
                "the Idempotency-Key was used for another request",
                "take a fresh key for each new request",
            ),
            EnqueueError::JobDeleted => Self::new(
                StatusCode::CONFLICT,
                "job_deleted",
                "the job of this Idempotency-Key was deleted",
                "take a fresh key to run it again",
            ),
            EnqueueError::Full { waiting } => Self::new(
                StatusCode::TOO_MANY_REQUESTS,
                "queue_full",
                format!("{waiting} jobs are waiting"),
                "try again later",
            )
            .with_header(header::RETRY_AFTER, HeaderValue::from_static("60")),
            EnqueueError::Store(error) => error.into(),
        }
    }
}

/// `?state=&label=&page_size=&page_token=`
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ListQuery {
    state: Option<String>,
    label: Option<String>,
    page_size: Option<i64>,
    page_token: Option<String>,
}

/// `GET /v1/jobs`, newest first.
pub(super) async fn list(State(app): State<App>, ApiQuery(query): ApiQuery<ListQuery>) -> Result<Response, Problem> {
    let state = query.state.filter(|state| !state.is_empty());
    let state = state.map(|state| Phase::parse(&state).ok_or(state)).transpose().map_err(|state| {
        let names = Phase::ALL.map(Phase::name).join(", ");
        Problem::malformed(format!("`{state}` is no state of a job"), format!("take one of {names}"))
    })?;
    let label = query.label.filter(|label| !label.is_empty()).map(|label| match label.split_once('=') {
        Some((key, value)) => LabelFilter { key: key.to_owned(), value: Some(value.to_owned()) },
        None => LabelFilter { key: label, value: None },
    });
    let page = PageQuery { page_size: query.page_size, page_token: query.page_token };
    let filter = JobFilter { state, label, before: page.before()? };
    let rows = app.queue.list(&filter, page.fetch_size()?).await?;
    let page = Page::cut(rows, &page, |job: &Job| job.seq)?;
    let jobs: Vec<Value> = page.items.iter().map(document).collect();
    Ok(Json(json!({ "jobs": jobs, "next_page_token": page.next_page_token })).into_response())
}

/// `?wait=` in seconds.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WaitQuery {
    wait: Option<f64>,
}

/// `GET /v1/jobs/{id}`: at once, or with `?wait=` once it differs from `If-None-Match` (or from what it was when asked).
pub(super) async fn get(
    State(app): State<App>,
    ApiPath(id): ApiPath<String>,
    ApiQuery(query): ApiQuery<WaitQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let wait = match query.wait {
        Some(seconds) if !(seconds.is_finite() && seconds >= 0.0) => {
            return Err(Problem::malformed(format!("wait is {seconds}"), "give seconds, 0 or more"));
        }
        Some(seconds) => Duration::from_secs_f64(seconds.min(app.settings.limits.max_wait.as_secs_f64())),
        None => Duration::ZERO,
    };
    let known = headers.get(header::IF_NONE_MATCH).and_then(|value| value.to_str().ok()).map(str::to_owned);
    let job = wait_for_change(&app, &id, known.as_deref(), wait).await?;
    let tag = etag(&job);
    if known.is_some_and(|known| known == tag) {
        return Ok((StatusCode::NOT_MODIFIED, [(header::ETAG, tag)]).into_response());
    }
    Ok(answer(&job).into_response())
}

/// The job once it is final, changed, or the time is over, or the service stops.
async fn wait_for_change(app: &App, id: &str, known: Option<&str>, wait: Duration) -> Result<Job, Problem> {
    let deadline = Instant::now() + wait;
    let mut changes = app.queue.listen(); // before the first look: no change slips between
    let draining = &app.draining;
    let mut first_tag = None;
    loop {
        let job = app.queue.get(id).await?.ok_or_else(|| Problem::not_found("job"))?;
        let tag = etag(&job);
        let before = known.unwrap_or_else(|| first_tag.get_or_insert_with(|| tag.clone()));
        if tag != before || job.state.phase().is_final() || Instant::now() >= deadline || draining.is_cancelled() {
            return Ok(job);
        }
        loop {
            tokio::select! {
                changed = changes.recv() => match changed {
                    Ok(changed) if *changed != *id => {}
                    _ => break, // its own, or too many to know
                },
                () = tokio::time::sleep_until(deadline) => break,
                () = draining.cancelled() => break,
            }
        }
    }
}

/// `POST /v1/jobs/{id}/cancel`: 202 and the job; 409 where it has ended otherwise.
pub(super) async fn cancel(State(app): State<App>, ApiPath(id): ApiPath<String>) -> Result<Response, Problem> {
    match app.queue.cancel(&id).await? {
        Cancel::Accepted(job) => Ok((StatusCode::ACCEPTED, answer(&job)).into_response()),
        Cancel::Missing => Err(Problem::not_found("job")),
        Cancel::AlreadyFinal(phase) => Err(Problem::new(
            StatusCode::CONFLICT,
            "already_final",
            format!("the job has ended: {}", phase.name()),
            "a final state never changes; DELETE removes the job",
        )),
    }
}

/// `DELETE /v1/jobs/{id}`: 204; a running one is stopped.
pub(super) async fn delete(State(app): State<App>, ApiPath(id): ApiPath<String>) -> Result<StatusCode, Problem> {
    if app.queue.delete(&id).await? { Ok(StatusCode::NO_CONTENT) } else { Err(Problem::not_found("job")) }
}

fn etag(job: &Job) -> String {
    format!("\"{}-{}\"", job.id, job.version)
}

fn answer(job: &Job) -> impl IntoResponse {
    ([(header::ETAG, etag(job)), (header::CACHE_CONTROL, "no-cache".to_owned())], Json(document(job)))
}

/// The job as clients see it.
fn document(job: &Job) -> Value {
    let own = format!("/v1/jobs/{}", job.id);
    json!({
        "id": job.id,
        "state": job.state.phase().name(),
        "session": job.session,
        "options": job.options,
        "labels": job.labels,
        "priority": job.priority,
        "created_at": job.created_at,
        "started_at": job.started_at,
        "finished_at": job.state.finished_at(),
        "attempt": job.attempt,
        "progress": job.progress,
        "stage_seconds": job.stage_seconds,
        "quality": job.state.quality(),
        "error": job.state.error(),
        "solver_version": job.solver_version,
        "links": {
            "self": own,
            "session": format!("/v1/sessions/{}", job.session),
            "cancel": format!("{own}/cancel"),
            "result": format!("{own}/result"),
            "cameras": format!("{own}/cameras"),
            "people": format!("{own}/people"),
            "report": format!("{own}/report"),
            "artifacts": format!("{own}/artifacts/"),
        },
    })
}
