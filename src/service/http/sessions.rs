//! `/v1/sessions`.

use super::access::Caller;
use super::error::Problem;
use super::intake::{MediaType, keep, receive, receive_form};
use super::page::{Page, PageQuery};
use super::{ApiPath, ApiQuery, App};
use crate::service::store::sessions::{self, RemoveError, StoredSession};
use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};

/// `POST /v1/sessions`: 201 for a new session, 200 where the same bytes were known.
pub(super) async fn create(
    State(app): State<App>,
    Caller { tenant }: Caller,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let media_type = MediaType::of(&headers).ok_or_else(|| {
        Problem::unsupported_media_type(
            "application/zip, multipart/form-data, application/json or application/x-ndjson",
        )
    })?;
    let received = match media_type {
        MediaType::Multipart => {
            receive_form(&app, &tenant, &headers, body, &["session"]).await?.session.ok_or_else(|| {
                Problem::malformed("the form has no part `session`", "send the session as the part `session`")
            })?
        }
        _ => receive(&app, &tenant, &headers, body).await?,
    };
    let added = keep(&app, &tenant, received).await?;
    let status = if added.is_new { StatusCode::CREATED } else { StatusCode::OK };
    let location = [(header::LOCATION, format!("/v1/sessions/{}", added.session.id))];
    Ok((status, location, Json(added.session)).into_response())
}

/// `GET /v1/sessions`, newest first.
pub(super) async fn list(
    State(app): State<App>,
    Caller { tenant }: Caller,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Response, Problem> {
    let before = query.before()?.unwrap_or(i64::MAX);
    let rows = sessions::list(&app.store, &tenant, before, query.fetch_size()?).await?;
    let page = Page::cut(rows, &query, |session: &StoredSession| session.seq)?;
    Ok(Json(serde_json::json!({ "sessions": page.items, "next_page_token": page.next_page_token })).into_response())
}

/// `GET /v1/sessions/{id}`.
pub(super) async fn get(
    State(app): State<App>,
    Caller { tenant }: Caller,
    ApiPath(id): ApiPath<String>,
) -> Result<Json<StoredSession>, Problem> {
    sessions::get(&app.store, &tenant, &id).await?.map(Json).ok_or_else(|| Problem::not_found("session"))
}

/// `DELETE /v1/sessions/{id}`: 204, or 409 while a job needs it.
pub(super) async fn delete(
    State(app): State<App>,
    Caller { tenant }: Caller,
    ApiPath(id): ApiPath<String>,
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
