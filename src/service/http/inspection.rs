//! `GET /v1/sessions/{id}/inspection`: problems and expected accuracy of a session, before it is solved.

use super::access::Caller;
use super::app::App;
use super::conditions::{is_unchanged, require_match};
use super::error::Problem;
use super::extract::{ApiPath, SessionPath};
use super::upload::has_its_bytes;
use crate::pipeline::inspection::Inspection;
use crate::service::store::Tenant;
use crate::service::store::sessions::{self, StoredSession};
use crate::service::validation::{self, ValidationError};
use axum::body::Bytes;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};

/// Inspect a session before it is solved.
#[utoipa::path(get, path = "/v1/sessions/{id}/inspection", operation_id = "inspectSession", tag = "sessions",
    params(SessionPath),
    responses((status = 200, description = "The inspection", body = Inspection, headers(("ETag" = String))),
        (status = 304, description = "Unchanged"), (status = 412), (status = 413), (status = 422), (status = 500),
        (status = 503)))]
pub(super) async fn get(
    State(app): State<App>,
    Caller { tenant }: Caller,
    ApiPath(SessionPath { id }): ApiPath<SessionPath>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let session = sessions::get(&app.store, &tenant, &id).await?;
    let session = session.ok_or_else(|| Problem::not_found("session"))?;
    let version = env!("CARGO_PKG_VERSION");
    let tag = format!("\"{}-{version}-{}\"", session.summary.sha256, app.settings.jobs.threads); // the time follows from the threads
    require_match(&headers, &tag)?;
    if is_unchanged(&headers, &tag) {
        return Ok((StatusCode::NOT_MODIFIED, [(header::ETAG, tag)]).into_response());
    }
    let document = match app.inspections.get(&session.summary.sha256) {
        Some(document) => document,
        None => inspected(&app, &tenant, session).await?,
    };
    let headers = [(header::CONTENT_TYPE, "application/json".to_owned()), (header::ETAG, tag)];
    Ok((headers, document).into_response())
}

/// Inspects the session when it is the turn of the tenant, and keeps the inspection.
async fn inspected(app: &App, tenant: &Tenant, session: StoredSession) -> Result<Bytes, Problem> {
    let inspections = &app.inspections;
    let _tenant_turn = inspections.tenants.take(tenant).await?;
    let sha256 = &session.summary.sha256;
    if let Some(document) = inspections.get(sha256) {
        return Ok(document); // a request before this one has inspected the same session
    }
    let _turn = inspections.turn.acquire().await.map_err(Problem::internal)?;
    let _memory = app.validations.acquire().await.map_err(Problem::internal)?; // may take its whole limit, as an upload does
    let file = app.store.blobs.session(&session.id, sha256).await?;
    let document = match validation::inspect(&app.settings, &file.path).await {
        Ok(document) => Bytes::from(document),
        // It was a session when it was accepted: what is wrong now is not the client's fault.
        Err(error) if !has_its_bytes(&app.store, &session).await? => return Err(damaged(&session.id, &error)),
        Err(error) => return Err(error.into()),
    };
    inspections.insert(sha256.clone(), document.clone());
    Ok(document)
}

fn damaged(id: &str, error: &ValidationError) -> Problem {
    tracing::error!(session.id = id, %error, "the stored bytes of a session are damaged");
    let detail = "the upload on the disk of the service is damaged or missing";
    let remedy = "upload the session again and inform the operator";
    Problem::new(StatusCode::INTERNAL_SERVER_ERROR, "corrupt", detail, remedy)
}
