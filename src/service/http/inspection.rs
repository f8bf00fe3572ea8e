//! `GET /v1/sessions/{id}/inspection`: problems and expected accuracy of a session, before it is solved.

use super::access::Caller;
use super::app::App;
use super::error::Problem;
use super::extract::{ApiPath, SessionPath};
use super::upload::upload_problem;
use crate::pipeline::inspection::{Inspection, inspect};
use crate::service::store::sessions;
use crate::session::upload::{self, UploadLimits};
use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};

/// Inspect a session before it is solved.
#[utoipa::path(get, path = "/v1/sessions/{id}/inspection", operation_id = "inspectSession", tag = "sessions",
    params(SessionPath), responses((status = 200, description = "The inspection", body = Inspection), (status = 422)))]
pub(super) async fn get(
    State(app): State<App>,
    caller: Caller,
    ApiPath(SessionPath { id }): ApiPath<SessionPath>,
) -> Result<Response, Problem> {
    let session = sessions::get(&app.store, &caller.tenant, &id).await?;
    let session = session.ok_or_else(|| Problem::not_found("session"))?;
    let _turn = app.validations.acquire().await.map_err(Problem::internal)?; // the inspection holds a session in memory
    let (path, threads) = (app.store.folders.session(&id), app.settings.jobs.threads);
    let inspected = tokio::task::spawn_blocking(move || -> Result<Inspection, Problem> {
        let loaded = upload::read_path(&path, &UploadLimits::default()).map_err(upload_problem)?;
        let threads = if threads == 0 { std::thread::available_parallelism().map_or(1, usize::from) } else { threads };
        Ok(inspect(&loaded.session, threads))
    });
    let inspection = inspected.await.map_err(Problem::internal)??;
    let tag = [(header::ETAG, format!("\"{}-{}\"", session.summary.sha256, env!("CARGO_PKG_VERSION")))];
    Ok((tag, Json(inspection)).into_response())
}
