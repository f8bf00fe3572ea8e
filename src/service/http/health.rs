//! `/healthz`, `/readyz` and `/metrics`.

use super::app::App;
use super::error::Problem;
use crate::service::metrics::MEDIA_TYPE;
use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde_json::{Value, json};

/// Report that the process is alive.
#[utoipa::path(get, path = "/healthz", operation_id = "isAlive", tag = "service",
    responses((status = 200, description = "The process is alive", body = Value)))]
pub(super) async fn alive() -> Json<Value> {
    Json(json!({ "status": "alive" }))
}

/// Report whether the service accepts work: it is not stopping, disk space is left, the database is writable.
#[utoipa::path(get, path = "/readyz", operation_id = "isReady", tag = "service",
    responses((status = 200, description = "The service accepts work", body = Value), (status = 503)))]
pub(super) async fn ready(State(app): State<App>) -> Result<Json<Value>, Problem> {
    if app.draining.is_cancelled() {
        return Err(Problem::unavailable("stopping", "the service is stopping"));
    }
    app.require_disk().map_err(|_| Problem::unavailable("disk_full", "the disk of the service is full"))?;
    app.store.check_writable().await.map_err(|error| {
        tracing::error!(%error, "the database is not writable");
        Problem::unavailable("database", "the database is not writable")
    })?;
    Ok(Json(json!({ "status": "ready" })))
}

/// Get the metrics for Prometheus (OpenMetrics text).
#[utoipa::path(get, path = "/metrics", operation_id = "getMetrics", tag = "service",
    responses((status = 200, description = "The metrics", body = String, content_type = "application/openmetrics-text")))]
pub(super) async fn metrics(State(app): State<App>) -> Result<Response, Problem> {
    let queue = app.queue.statistics().await?;
    let page = app.metrics.page(&queue, &app.store.disk_usage(), app.leadership.is_held());
    Ok(([(header::CONTENT_TYPE, MEDIA_TYPE)], page).into_response())
}
