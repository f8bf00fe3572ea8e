//! Every route on one page.

mod access;
mod cors;
mod deliveries;
mod error;
mod events;
mod inspection;
mod intake;
mod jobs;
mod multipart;
pub mod openapi;
mod options;
mod pace;
mod page;
mod range;
mod results;
mod server;
mod sessions;
mod submission;
mod trace;
mod upload;
mod viewer;

pub use multipart::read_form;

use super::Shared;
use super::metrics::{self, Metrics};
use super::queue::Queue;
use super::settings::Settings;
use super::store::Store;
use super::webhooks::Networks;
use axum::extract::rejection::{PathRejection, QueryRejection};
use axum::extract::{FromRequestParts, Path, Query, State};
use axum::http::request::Parts;
use axum::http::{StatusCode, header};
use axum::middleware::{from_fn, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodRouter, get, post};
use axum::{Json, Router};
use error::Problem;
use pace::Pace;
use serde::de::DeserializeOwned;
use serde_json::json;
use std::sync::Arc;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

/// What every handler may use.
#[derive(Clone)]
pub(super) struct App {
    pub(super) store: Store,
    pub(super) queue: Queue,
    pub(super) settings: Arc<Settings>,
    pub(super) metrics: Arc<Metrics>,
    pub(super) draining: CancellationToken,
    /// Private networks that webhooks may call.
    pub(super) allowed_networks: Arc<Networks>,
    /// Uploads read into memory at the same time.
    pub(super) validations: Arc<Semaphore>,
    /// Requests of each tenant.
    tenant_pace: Arc<Pace>,
    /// Requests of each address that came without a valid key.
    bad_key_pace: Arc<Pace>,
}

/// Uploads validated at the same time: each may hold a session of some hundred megabytes.
const VALIDATIONS: usize = 2;

impl App {
    pub(super) fn new(shared: Shared, allowed_networks: Arc<Networks>) -> Self {
        let Shared { store, queue, settings, metrics, draining } = shared;
        let tenant_pace = Arc::new(Pace::new(settings.tenants.requests_per_s));
        let bad_key_pace = Arc::new(Pace::new(settings.limits.bad_keys_per_s));
        let validations = Arc::new(Semaphore::new(VALIDATIONS));
        Self { store, queue, settings, metrics, draining, allowed_networks, validations, tenant_pace, bad_key_pace }
    }

    /// 507 while the disk is nearly full.
    fn require_disk(&self) -> Result<(), Problem> {
        match self.store.folders.free_bytes() {
            Ok(free) if free < self.settings.limits.min_free_bytes => Err(Problem::disk_full()),
            Ok(_) => Ok(()),
            Err(error) => Err(Problem::internal(error)),
        }
    }
}

/// Serves the API until `draining`.
pub(super) async fn serve(app: App, listener: TcpListener) {
    let (settings, metrics, draining) = (app.settings.clone(), app.metrics.clone(), app.draining.clone());
    server::serve(listener, routes(app), &settings.limits, settings.drain_limit, metrics, draining).await;
}

/// Routes that need a key wherever keys are asked for.
fn api() -> Vec<(&'static str, MethodRouter<App>)> {
    vec![
        ("/v1/sessions", post(sessions::create).get(sessions::list)),
        ("/v1/sessions/{id}", get(sessions::get).delete(sessions::delete)),
        ("/v1/sessions/{id}/inspection", get(inspection::get)),
        ("/v1/jobs", post(submission::create).get(jobs::list)),
        ("/v1/jobs/{id}", get(jobs::get).delete(jobs::delete)),
        ("/v1/jobs/{id}/events", get(events::stream)),
        ("/v1/jobs/{id}/cancel", post(jobs::cancel)),
        ("/v1/jobs/{id}/result", results::named("manifest.json")),
        ("/v1/jobs/{id}/artifacts/{*name}", get(results::artifact)),
        ("/v1/jobs/{id}/cameras", results::named("cameras.json")),
        ("/v1/jobs/{id}/people", results::named("people.json")),
        ("/v1/jobs/{id}/report", results::named("report.json")),
        ("/v1/jobs/{id}/deliveries", get(deliveries::list)),
        ("/v1/jobs/{id}/deliveries/{delivery}/redeliver", post(deliveries::redeliver)),
        ("/v1/webhook-secret", get(deliveries::secret)),
    ]
}

/// Routes that anybody may ask.
fn open() -> Vec<(&'static str, MethodRouter<App>)> {
    vec![
        ("/healthz", get(alive)),
        ("/readyz", get(ready)),
        ("/openapi.json", get(openapi::document_route)),
        ("/docs", get(openapi::page)),
    ]
}

fn routes(app: App) -> Router {
    let add = |router: Router<App>, (path, methods)| router.route(path, methods);
    let api = api().into_iter().fold(Router::new(), add).layer(from_fn_with_state(app.clone(), access::to_the_api));
    let metrics = Router::new().route("/metrics", get(metrics));
    let metrics = metrics.layer(from_fn_with_state(app.clone(), access::to_the_metrics));
    open()
        .into_iter()
        .fold(api.merge(metrics), add)
        .merge(viewer::routes())
        .fallback(no_such_route)
        .method_not_allowed_fallback(no_such_method)
        .layer(from_fn(error::write_problems))
        .layer(from_fn_with_state(app.clone(), cors::share))
        .layer(from_fn_with_state(app.clone(), trace::follow))
        .with_state(app)
}

/// The service's figures for Prometheus.
async fn metrics(State(app): State<App>) -> Result<Response, Problem> {
    let queue = app.queue.statistics().await?;
    let page = app.metrics.page(&queue, &app.store.disk_usage());
    Ok(([(header::CONTENT_TYPE, metrics::MEDIA_TYPE)], page).into_response())
}

/// The process answers.
async fn alive() -> Json<serde_json::Value> {
    Json(json!({ "status": "alive" }))
}

/// Work can be accepted: not stopping, disk left, database writable.
async fn ready(State(app): State<App>) -> Result<Json<serde_json::Value>, Problem> {
    if app.draining.is_cancelled() {
        return Err(Problem::unavailable("stopping", "the service is stopping"));
    }
    app.require_disk().map_err(|_| Problem::unavailable("disk_full", "the service's disk is full"))?;
    app.store.check_writable().await.map_err(|error| {
        tracing::error!(%error, "the database takes no writes");
        Problem::unavailable("database", "the database takes no writes")
    })?;
    Ok(Json(json!({ "status": "ready" })))
}

async fn no_such_route() -> Problem {
    Problem::new(StatusCode::NOT_FOUND, "not_found", "there is no such route", "the API lies under /v1")
}

async fn no_such_method() -> Response {
    Problem::new(
        StatusCode::METHOD_NOT_ALLOWED,
        "method_not_allowed",
        "the route does not take this method",
        "see the header Allow",
    )
    .into_response()
}

/// `Path` with a problem document for what it refuses.
struct ApiPath<T>(T);

/// `Query` with a problem document for what it refuses.
struct ApiQuery<T>(T);

impl<T: DeserializeOwned + Send, S: Sync + Send> FromRequestParts<S> for ApiPath<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        Ok(Self(Path::from_request_parts(parts, state).await?.0))
    }
}

impl<T: DeserializeOwned, S: Sync + Send> FromRequestParts<S> for ApiQuery<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        Ok(Self(Query::from_request_parts(parts, state).await?.0))
    }
}

impl From<PathRejection> for Problem {
    fn from(rejection: PathRejection) -> Self {
        Self::malformed(rejection.body_text(), "check the path")
    }
}

impl From<QueryRejection> for Problem {
    fn from(rejection: QueryRejection) -> Self {
        Self::malformed(rejection.body_text(), "check the query")
    }
}
