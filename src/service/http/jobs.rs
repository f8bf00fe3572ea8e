//! `/v1/jobs`: list, look, wait, cancel, delete; [`super::submission`] accepts them.

use super::access::Caller;
use super::error::Problem;
use super::page::{Page, PageQuery};
use super::{ApiPath, ApiQuery, App};
use crate::service::failpoint::fault;
use crate::service::metrics::Held;
use crate::service::queue::Phase;
use crate::service::queue::job::Job;
use crate::service::queue::{Cancel, JobFilter, LabelFilter};
use crate::service::store::Tenant;
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use serde_json::{Value, json};
use std::time::Duration;
use tokio::time::Instant;

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
pub(super) async fn list(
    State(app): State<App>,
    Caller { tenant }: Caller,
    ApiQuery(query): ApiQuery<ListQuery>,
) -> Result<Response, Problem> {
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
    let rows = app.queue.list(&tenant, &filter, page.fetch_size()?).await?;
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
    Caller { tenant }: Caller,
    ApiPath(id): ApiPath<String>,
    ApiQuery(query): ApiQuery<WaitQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    if fault("answers.slow") {
        tokio::time::sleep(Duration::from_millis(300)).await;
    }
    let wait = match query.wait {
        Some(seconds) if !(seconds.is_finite() && seconds >= 0.0) => {
            return Err(Problem::malformed(format!("wait is {seconds}"), "give seconds, 0 or more"));
        }
        Some(seconds) => Duration::from_secs_f64(seconds.min(app.settings.limits.max_wait.as_secs_f64())),
        None => Duration::ZERO,
    };
    let known = headers.get(header::IF_NONE_MATCH).and_then(|value| value.to_str().ok()).map(str::to_owned);
    let job = wait_for_change(&app, &tenant, &id, known.as_deref(), wait).await?;
    let tag = etag(&job);
    if known.is_some_and(|known| known == tag) {
        return Ok((StatusCode::NOT_MODIFIED, [(header::ETAG, tag)]).into_response());
    }
    Ok(answer(&job).into_response())
}

/// The job once it is final, changed, or the time is over, or the service stops.
async fn wait_for_change(
    app: &App,
    tenant: &Tenant,
    id: &str,
    known: Option<&str>,
    wait: Duration,
) -> Result<Job, Problem> {
    let _held = Held::new(&app.metrics);
    let deadline = Instant::now() + wait;
    let mut changes = app.queue.listen(); // before the first look: no change slips between
    let draining = &app.draining;
    let mut first_tag = None;
    loop {
        let job = app.queue.get(tenant, id).await?.ok_or_else(|| Problem::not_found("job"))?;
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
pub(super) async fn cancel(
    State(app): State<App>,
    Caller { tenant }: Caller,
    ApiPath(id): ApiPath<String>,
) -> Result<Response, Problem> {
    match app.queue.cancel(&tenant, &id).await? {
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
pub(super) async fn delete(
    State(app): State<App>,
    Caller { tenant }: Caller,
    ApiPath(id): ApiPath<String>,
) -> Result<StatusCode, Problem> {
    if app.queue.delete(&tenant, &id).await? { Ok(StatusCode::NO_CONTENT) } else { Err(Problem::not_found("job")) }
}

fn etag(job: &Job) -> String {
    format!("\"{}-{}\"", job.id, job.version)
}

/// The job with its ETag.
pub(super) fn answer(job: &Job) -> impl IntoResponse {
    ([(header::ETAG, etag(job)), (header::CACHE_CONTROL, "no-cache".to_owned())], Json(document(job)))
}

/// The job as clients see it.
pub(super) fn document(job: &Job) -> Value {
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
            "events": format!("{own}/events"),
            "result": format!("{own}/result"),
            "cameras": format!("{own}/cameras"),
            "people": format!("{own}/people"),
            "report": format!("{own}/report"),
            "artifacts": format!("{own}/artifacts/"),
        },
    })
}
