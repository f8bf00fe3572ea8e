//! `GET /v1/sessions/{id}/inspection`: problems and expected accuracy of a session, before it is solved.

use super::access::Caller;
use super::app::App;
use super::error::Problem;
use super::extract::{ApiPath, SessionPath};
use crate::pipeline::inspection::Inspection;
use crate::service::store::sessions;
use crate::service::validation;
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
    let _turn = app.validations.acquire().await.map_err(Problem::internal)?; // each may take its whole memory limit
    let document = validation::inspect(&app.settings, &app.store.folders.session(&id)).await?;
    let tag = format!("\"{}-{}\"", session.summary.sha256, env!("CARGO_PKG_VERSION"));
    let headers = [(header::CONTENT_TYPE, "application/json".to_owned()), (header::ETAG, tag)];
    Ok((headers, document).into_response())
}
