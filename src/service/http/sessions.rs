//! `/v1/sessions`: upload, list, get and delete sessions.

use super::access::Caller;
use super::app::App;
use super::error::Problem;
use super::extract::{ApiPath, ApiQuery, SessionPath};
use super::page::{self, PageQuery};
use super::upload::{MediaType, keep, receive, receive_form, unsupported};
use crate::service::store::sessions::{self, RemoveError, StoredSession};
use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use serde_json::{Value, json};
use utoipa::{IntoParams, ToSchema};

/// One page of sessions.
#[derive(Debug, Serialize, ToSchema)]
struct SessionPage {
    sessions: Vec<StoredSession>,
    /// Requests the next page; null on the last page.
    #[schema(required)]
    next_page_token: Option<String>,
}

/// A session as one JSON document; the README describes the layout.
#[derive(ToSchema)]
#[allow(dead_code)] // describes what `session::upload` reads
struct SessionDocument {
    #[schema(required = false)]
    name: Value,
    fps: f64,
    n_frames: Option<u64>,
    /// Name of a keypoint convention, or a table of landmarks `{"name", "landmarks": [{"name", "terms": [{"joint", "weight", "offset"}]}]}`.
    keypoint_convention: Value,
    #[schema(value_type = Vec<Object>)]
    cameras: Value,
    #[schema(value_type = Object)]
    poses: Value,
}

/// A session as a form.
#[derive(ToSchema)]
#[allow(dead_code)] // describes what `receive_form` reads
struct SessionForm {
    #[schema(format = Binary, content_media_type = "application/octet-stream")]
    session: String,
}

/// A session of two cameras, one frame and one person.
fn example_session() -> Value {
    let keypoints: Vec<Value> =
        (0..17).map(|i| json!([600.0 + f64::from(i % 2) * 40.0, 100.0 + 30.0 * f64::from(i), 0.9])).collect();
    let camera = |id: &str| {
        let k = json!([[900.0, 0.0, 640.0], [0.0, 900.0, 360.0], [0.0, 0.0, 1.0]]);
        json!({ "id": id, "width": 1280, "height": 720, "K": k, "dist": [0.0, 0.0, 0.0, 0.0, 0.0] })
    };
    let poses = json!({ "frames": [{ "frame": 0, "people": [{ "track_id": null, "keypoints": keypoints }] }] });
    json!({
        "name": "example", "fps": 25.0, "n_frames": 1, "keypoint_convention": "coco17",
        "cameras": [camera("left"), camera("right")], "poses": { "left": poses, "right": poses },
    })
}

/// Headers of an upload.
#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code)] // describes what `trace` reads
struct UploadHeaders {
    /// Id of the request in the log of the service and in the answer; without it a new one.
    #[param(rename = "X-Request-Id", nullable = false)]
    x_request_id: Option<String>,
}

/// Upload a session.
#[utoipa::path(post, path = "/v1/sessions", operation_id = "createSession", tag = "sessions", params(UploadHeaders),
    request_body(content((SessionDocument = "application/json", example = json!(example_session())),
        (inline(SessionForm) = "multipart/form-data"), ("application/zip"), ("application/x-ndjson"))),
    responses(
        (status = 201, description = "A new session", body = StoredSession,
            headers(("Location" = String, description = "Path of the session"))),
        (status = 200, description = "The same bytes were uploaded before", body = StoredSession,
            headers(("Location" = String, description = "Path of the session"))),
        (status = 400), (status = 408), (status = 413), (status = 415), (status = 422), (status = 507)))]
pub(super) async fn create(
    State(app): State<App>,
    Caller { tenant }: Caller,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let media_type = MediaType::of(&headers).ok_or_else(|| {
        unsupported(&headers, "application/zip, multipart/form-data, application/json or application/x-ndjson")
    })?;
    let received = match media_type {
        MediaType::Multipart => {
            receive_form(&app, &tenant, &headers, body, &["session"]).await?.session.ok_or_else(|| {
                Problem::malformed("the form has no part `session`", "add the session as the part `session`")
            })?
        }
        _ => receive(&app, &tenant, &headers, body).await?,
    };
    let added = keep(&app, &tenant, received).await?;
    let status = if added.is_new { StatusCode::CREATED } else { StatusCode::OK };
    let location = [(header::LOCATION, format!("/v1/sessions/{}", added.session.id))];
    Ok((status, location, Json(added.session)).into_response())
}

/// List sessions, newest first.
#[utoipa::path(get, path = "/v1/sessions", operation_id = "listSessions", tag = "sessions", params(PageQuery),
    responses((status = 200, description = "One page", body = SessionPage), (status = 400)))]
pub(super) async fn list(
    State(app): State<App>,
    Caller { tenant }: Caller,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Response, Problem> {
    let (before, max_rows) = (query.before()?.unwrap_or(i64::MAX), query.max_rows()?);
    let turn = app.lists.take(&tenant).await?;
    let listed = sessions::list(&app.store, &tenant, before, max_rows).await?;
    let next_page_token = page::next_page_token(&listed, |session| session.seq);
    page::answer(&SessionPage { sessions: listed.items, next_page_token }, turn)
}

/// Get a session.
#[utoipa::path(get, path = "/v1/sessions/{id}", operation_id = "getSession", tag = "sessions", params(SessionPath),
    responses((status = 200, description = "The session", body = StoredSession)))]
pub(super) async fn get(
    State(app): State<App>,
    Caller { tenant }: Caller,
    ApiPath(SessionPath { id }): ApiPath<SessionPath>,
) -> Result<Json<StoredSession>, Problem> {
    sessions::get(&app.store, &tenant, &id).await?.map(Json).ok_or_else(|| Problem::not_found("session"))
}

/// Delete a session that no job needs.
#[utoipa::path(delete, path = "/v1/sessions/{id}", operation_id = "deleteSession", tag = "sessions", params(SessionPath),
    responses((status = 204, description = "Deleted"), (status = 409)))]
pub(super) async fn delete(
    State(app): State<App>,
    Caller { tenant }: Caller,
    ApiPath(SessionPath { id }): ApiPath<SessionPath>,
) -> Result<StatusCode, Problem> {
    match sessions::remove(&app.store, &tenant, &id).await {
        Ok(()) => Ok(StatusCode::NO_CONTENT),
        Err(RemoveError::Missing) => Err(Problem::not_found("session")),
        Err(RemoveError::InUse { job }) => Err(Problem::new(
            StatusCode::CONFLICT,
            "session_in_use",
            format!("job {job} uses the session"),
            format!("wait for the job, or cancel it with POST /v1/jobs/{job}/cancel"),
        )),
        Err(RemoveError::Store(error)) => Err(error.into()),
    }
}
