//! Every route on one page.

mod error;
mod intake;
mod jobs;
mod multipart;
mod options;
mod page;
mod range;
mod results;
mod server;
mod sessions;
mod submission;
mod upload;
mod viewer;

use super::queue::Queue;
use super::settings::Settings;
use super::store::Store;
use axum::extract::rejection::{PathRejection, QueryRejection};
use axum::extract::{FromRequestParts, Path, Query, State};
use axum::http::StatusCode;
use axum::http::request::Parts;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router};
use error::Problem;
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
    pub(super) draining: CancellationToken,
    /// Uploads read into memory at the same time.
    pub(super) validations: Arc<Semaphore>,
}

/// Uploads validated at the same time: each may hold a session of some hundred megabytes.
const VALIDATIONS: usize = 2;

impl App {
    pub(super) fn new(store: Store, queue: Queue, settings: Arc<Settings>, draining: CancellationToken) -> Self {
        Self { store, queue, settings, draining, validations: Arc::new(Semaphore::new(VALIDATIONS)) }
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
    let settings = app.settings.clone();
    let draining = app.draining.clone();
    server::serve(listener, routes(app), &settings.limits, settings.drain_limit, draining).await;
}

fn routes(app: App) -> Router {
    Router::new()
        .route("/v1/sessions", post(sessions::create).get(sessions::list))
        .route("/v1/sessions/{id}", get(sessions::get).delete(sessions::delete))
        .route("/v1/jobs", post(submission::create).get(jobs::list))
        .route("/v1/jobs/{id}", get(jobs::get).delete(jobs::delete))
        .route("/v1/jobs/{id}/cancel", post(jobs::cancel))
        .route("/v1/jobs/{id}/result", get(results::manifest))
        .route("/v1/jobs/{id}/artifacts/{*name}", get(results::artifact))
        .route("/v1/jobs/{id}/cameras", get(results::cameras))
        .route("/v1/jobs/{id}/people", get(results::people))
        .route("/v1/jobs/{id}/report", get(results::report))
        .route("/healthz", get(alive))
        .route("/readyz", get(ready))
        .merge(viewer::routes())
        .fallback(no_such_route)
        .method_not_allowed_fallback(no_such_method)
        .layer(axum::middleware::from_fn(error::write_problems))
        .with_state(app)
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
