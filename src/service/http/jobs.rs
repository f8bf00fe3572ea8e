//! `/v1/jobs`: list, get, wait for, cancel and delete jobs; [`super::submission`] creates them.

use super::access::Caller;
use super::app::App;
use super::conditions::{is_unchanged, require_match};
use super::error::Problem;
use super::extract::{ApiPath, ApiQuery, JobPath};
use super::page::{self, PageQuery};
use crate::pipeline::Options;
use crate::service::failpoint::fault;
use crate::service::metrics::Held;
use crate::service::queue::job::{Job, JobError, JobProgress, JobQuality};
use crate::service::queue::{Cancel, JobFilter, LabelFilter, Phase};
use crate::service::store::Tenant;
use crate::session::Suspicion;
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::time::Instant;
use utoipa::openapi::schema::{Object, ObjectBuilder, Type};
use utoipa::{IntoParams, ToSchema};

/// `?state=&label=&page_size=&page_token=`
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ListQuery {
    /// State of the jobs; empty: any state.
    #[param(schema_with = state_filter, required = false)]
    state: Option<String>,
    /// `key` or `key=value`.
    #[param(nullable = false, pattern = r"^[^\x00]*$")]
    label: Option<String>,
    /// Most jobs per page; values above 500 mean 500. Long labels make a page shorter.
    #[param(nullable = false, minimum = 0, default = 50)]
    page_size: Option<i64>,
    /// `next_page_token` of the page before.
    #[param(nullable = false, pattern = "^(s[0-9a-f]{1,15})?$")]
    page_token: Option<String>,
}

fn state_filter() -> Object {
    let states = [""].into_iter().chain(Phase::ALL.map(Phase::name));
    ObjectBuilder::new().schema_type(Type::String).enum_values(Some(states)).build()
}

/// One page of jobs.
#[derive(Debug, Serialize, ToSchema)]
struct JobPage {
    jobs: Vec<JobDocument>,
    /// Requests the next page; null on the last page.
    #[schema(required)]
    next_page_token: Option<String>,
}

/// List jobs, newest first.
#[utoipa::path(get, path = "/v1/jobs", operation_id = "listJobs", tag = "jobs", params(ListQuery),
    responses((status = 200, description = "One page", body = JobPage), (status = 400)))]
pub(super) async fn list(
    State(app): State<App>,
    Caller { tenant }: Caller,
    ApiQuery(query): ApiQuery<ListQuery>,
) -> Result<Response, Problem> {
    let state = query.state.map(|state| Phase::parse(&state).ok_or(state)).transpose().map_err(|state| {
        let names = Phase::ALL.map(Phase::name).join(", ");
        Problem::malformed(format!("`{state}` is not a state of a job"), format!("use one of {names}"))
    })?;
    let label = query.label.map(|label| match label.split_once('=') {
        Some((key, value)) => LabelFilter { key: key.to_owned(), value: Some(value.to_owned()) },
        None => LabelFilter { key: label, value: None },
    });
    let asked = PageQuery { page_size: query.page_size, page_token: query.page_token };
    let filter = JobFilter { state, label, before: asked.before()? };
    let max_rows = asked.max_rows()?;
    let turn = app.lists.take(&tenant).await?;
    let listed = app.queue.list(&tenant, &filter, max_rows).await?;
    let next_page_token = page::next_page_token(&listed, |job| job.seq);
    let jobs = listed.items.into_iter().map(JobDocument::of).collect();
    page::answer(&JobPage { jobs, next_page_token }, turn)
}

/// `?wait=`
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct WaitQuery {
    /// Longest time, s, until the answer, which comes once the job differs from If-None-Match; at most 60.
    #[param(nullable = false, minimum = 0)]
    wait: Option<f64>,
}

/// Get a job, at once or after a change.
///
/// With `wait`, the answer comes once the job differs from `If-None-Match`, or from its version at the time of the request.
#[utoipa::path(get, path = "/v1/jobs/{id}", operation_id = "getJob", tag = "jobs",
    params(JobPath, WaitQuery, ("If-None-Match" = inline(Option<String>), Header, nullable = false),
        ("If-Match" = inline(Option<String>), Header, nullable = false)),
    responses((status = 200, description = "The job", body = JobDocument, headers(("ETag" = String))),
        (status = 304, description = "Unchanged"), (status = 412)))]
pub(super) async fn get(
    State(app): State<App>,
    Caller { tenant }: Caller,
    ApiPath(JobPath { id }): ApiPath<JobPath>,
    ApiQuery(query): ApiQuery<WaitQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    if fault("answers.slow") {
        tokio::time::sleep(Duration::from_millis(300)).await;
    }
    let wait = match query.wait {
        Some(seconds) if !(seconds.is_finite() && seconds >= 0.0) => {
            return Err(Problem::malformed(format!("wait is {seconds}"), "use a number of seconds, 0 or more"));
        }
        Some(seconds) => Duration::from_secs_f64(seconds.min(app.settings.limits.max_wait.as_secs_f64())),
        None => Duration::ZERO,
    };
    let job = wait_for_change(&app, &tenant, &id, &headers, wait).await?;
    let tag = etag(&job);
    require_match(&headers, &tag)?;
    if is_unchanged(&headers, &tag) {
        return Ok((StatusCode::NOT_MODIFIED, [(header::ETAG, tag)]).into_response());
    }
    Ok(answer(job).into_response())
}

/// Waits until the job is final or has changed, the time is over, or the service stops; returns the job.
async fn wait_for_change(
    app: &App,
    tenant: &Tenant,
    id: &str,
    headers: &HeaderMap,
    wait: Duration,
) -> Result<Job, Problem> {
    let _held = Held::new(&app.metrics);
    let deadline = Instant::now() + wait;
    let mut changes = app.queue.follow(id); // before the first read, so that no change is missed
    let draining = &app.draining;
    let mut first_tag = None;
    loop {
        let job = app.queue.get(tenant, id).await?.ok_or_else(|| Problem::not_found("job"))?;
        let tag = etag(&job);
        let is_known = match headers.contains_key(header::IF_NONE_MATCH) {
            true => is_unchanged(headers, &tag),
            false => *first_tag.get_or_insert_with(|| tag.clone()) == tag,
        };
        if !is_known || job.state.phase().is_final() || Instant::now() >= deadline || draining.is_cancelled() {
            return Ok(job);
        }
        tokio::select! {
            _ = changes.changed() => {}
            () = tokio::time::sleep_until(deadline) => {}
            () = draining.cancelled() => {}
        }
    }
}

/// Cancel a job.
#[utoipa::path(post, path = "/v1/jobs/{id}/cancel", operation_id = "cancelJob", tag = "jobs",
    params(JobPath, ("If-Match" = inline(Option<String>), Header, nullable = false)),
    responses((status = 202, description = "The job stops within 2 s", body = JobDocument), (status = 409),
        (status = 412)))]
pub(super) async fn cancel(
    State(app): State<App>,
    Caller { tenant }: Caller,
    ApiPath(JobPath { id }): ApiPath<JobPath>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    require_version(&app, &tenant, &id, &headers).await?;
    match app.queue.cancel(&tenant, &id).await? {
        Cancel::Accepted(job) => Ok((StatusCode::ACCEPTED, answer(*job)).into_response()),
        Cancel::Missing => Err(Problem::not_found("job")),
        Cancel::AlreadyFinal(phase) => Err(Problem::new(
            StatusCode::CONFLICT,
            "already_final",
            format!("the job has already ended: {}", phase.name()),
            "a final state never changes; use DELETE to remove the job",
        )),
    }
}

/// Delete a job and its files.
#[utoipa::path(delete, path = "/v1/jobs/{id}", operation_id = "deleteJob", tag = "jobs",
    params(JobPath, ("If-Match" = inline(Option<String>), Header, nullable = false)),
    responses((status = 204, description = "Deleted; a running job is stopped"), (status = 412)))]
pub(super) async fn delete(
    State(app): State<App>,
    Caller { tenant }: Caller,
    ApiPath(JobPath { id }): ApiPath<JobPath>,
    headers: HeaderMap,
) -> Result<StatusCode, Problem> {
    require_version(&app, &tenant, &id, &headers).await?;
    if app.queue.delete(&tenant, &id).await? { Ok(StatusCode::NO_CONTENT) } else { Err(Problem::not_found("job")) }
}

/// Checks `If-Match` before a change. Final jobs have one version for ever; a running job can still change in the moment
/// between this check and the change.
async fn require_version(app: &App, tenant: &Tenant, id: &str, headers: &HeaderMap) -> Result<(), Problem> {
    if !headers.contains_key(header::IF_MATCH) {
        return Ok(());
    }
    let job = app.queue.get(tenant, id).await?.ok_or_else(|| Problem::not_found("job"))?;
    require_match(headers, &etag(&job))
}

fn etag(job: &Job) -> String {
    format!("\"{}-{}\"", job.id, job.version)
}

/// The job with its ETag.
pub(super) fn answer(job: Job) -> impl IntoResponse {
    ([(header::ETAG, etag(&job)), (header::CACHE_CONTROL, "no-cache".to_owned())], Json(JobDocument::of(job)))
}

/// One reconstruction of one session.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Job)]
pub(super) struct JobDocument {
    id: String,
    #[schema(inline, value_type = Phase)]
    state: &'static str,
    /// Id of the session.
    session: String,
    #[schema(value_type = Options)]
    options: Value,
    labels: BTreeMap<String, String>,
    priority: i64,
    #[schema(format = DateTime)]
    created_at: String,
    #[schema(required, format = DateTime)]
    started_at: Option<String>,
    #[schema(required, format = DateTime)]
    finished_at: Option<String>,
    #[schema(minimum = 0)]
    attempt: i64,
    progress: JobProgress,
    /// Wall time of each stage, s, in all attempts and before and after restarts of the service.
    stage_seconds: BTreeMap<String, f64>,
    #[schema(required)]
    quality: Option<JobQuality>,
    /// Probable mistakes in the files, as in `report.json`; empty before the job has succeeded.
    #[schema(value_type = Vec<Suspicion>)]
    suspicions: Vec<Value>,
    #[schema(required)]
    error: Option<JobError>,
    #[schema(required)]
    solver_version: Option<String>,
    /// Paths of related resources.
    links: BTreeMap<&'static str, String>,
}

impl JobDocument {
    /// Describes `job` to its client.
    pub(super) fn of(job: Job) -> Self {
        let own = format!("/v1/jobs/{}", job.id);
        let parts = ["archive", "cancel", "cameras", "events", "exports", "people", "report", "result"];
        let mut links: BTreeMap<_, _> = parts.into_iter().map(|part| (part, format!("{own}/{part}"))).collect();
        links.insert("artifacts", format!("{own}/artifacts/"));
        links.insert("session", format!("/v1/sessions/{}", job.session));
        links.insert("self", own);
        Self {
            state: job.state.phase().name(),
            finished_at: job.state.finished_at().map(str::to_owned),
            quality: job.state.quality().cloned(),
            suspicions: job.state.suspicions().to_vec(),
            error: job.state.error().cloned(),
            id: job.id,
            session: job.session,
            options: job.options,
            labels: job.labels,
            priority: job.priority,
            created_at: job.created_at,
            started_at: job.started_at,
            attempt: job.attempt,
            progress: job.progress,
            stage_seconds: job.stage_seconds,
            solver_version: job.solver_version,
            links,
        }
    }
}
