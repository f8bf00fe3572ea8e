//! `POST /v1/jobs/{id}/exports`: adds formats to the result of a finished job.

use super::access::Caller;
use super::app::App;
use super::body::GuardedBody;
use super::error::Problem;
use super::extract::{ApiPath, JobPath};
use super::results::{FileRequest, JsonFile, published_fence};
use super::upload::unless_refused;
use crate::service::exports::{ExtensionError, extend};
use crate::service::store::Tenant;
use crate::service::store::artifacts;
use crate::session::reconstruction::ExportFormat;
use axum::body::Body;
use axum::http::{HeaderMap, StatusCode};
use axum::response::Response;
use serde::Deserialize;
use utoipa::ToSchema;

/// Formats to add to a result.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct NewExports {
    /// Formats; those that the result has already change nothing.
    #[schema(min_items = 1)]
    exports: Vec<ExportFormat>,
}

/// Add formats to the result of a finished job.
///
/// The answer, the manifest with all formats, comes when the files are published. Repetitions change nothing.
#[utoipa::path(post, path = "/v1/jobs/{id}/exports", operation_id = "addExports", tag = "results", params(JobPath),
    request_body(content = NewExports, example = json!({ "exports": ["glb", "bvh"] })),
    responses((status = 200, description = "The manifest with all formats", body = JsonFile,
            headers(("ETag" = String))),
        (status = 400), (status = 408), (status = 409), (status = 413), (status = 415), (status = 500), (status = 507)))]
pub(super) async fn add(
    ApiPath(JobPath { id }): ApiPath<JobPath>,
    request: FileRequest,
    body: Body,
) -> Result<Response, Problem> {
    let FileRequest { app, caller: Caller { tenant }, headers } = request;
    published_fence(&app, &tenant, &id).await?; // a job of another tenant is unknown, whatever the body
    let formats = read_formats(&app, &headers, body).await?;
    // The work outlives its request: a client that leaves must not leave a half-written folder behind.
    let (worker, owner, job) = (app.clone(), tenant.clone(), id.clone());
    let added = tokio::spawn(async move { add_formats(&worker, &owner, &job, formats).await });
    added.await.map_err(Problem::internal)??;
    FileRequest { app, caller: Caller { tenant }, headers: HeaderMap::new() }.answer(&id, "manifest.json").await
}

async fn read_formats(app: &App, headers: &HeaderMap, body: Body) -> Result<Vec<ExportFormat>, Problem> {
    let limits = &app.settings.limits;
    let body = unless_refused(GuardedBody::new(headers, body, limits, limits.max_json_bytes)).await?;
    let text = unless_refused(body.read_all().await).await?;
    let remedy = "send {\"exports\": [\"<format>\"]} with at least one format of the option `exports`";
    let asked: NewExports =
        serde_json::from_slice(&text).map_err(|error| Problem::malformed(format!("the body: {error}"), remedy))?;
    if asked.exports.is_empty() {
        return Err(Problem::malformed("`exports` is empty", remedy).at("/exports"));
    }
    Ok(asked.exports)
}

async fn add_formats(app: &App, tenant: &Tenant, id: &str, formats: Vec<ExportFormat>) -> Result<(), Problem> {
    let _turn = app.exporting.acquire().await.map_err(Problem::internal)?;
    let fence = published_fence(app, tenant, id).await?;
    let _space = app.store.reserve(tenant, app.settings.tenants.max_bytes, 0, false).await?;
    let known = artifacts::list(&app.store, id).await?;
    let folders = &app.store.folders;
    let result = app.store.blobs.result(id, fence, &known).await?;
    let (staging, extended) = (folders.staging(id, fence + 1), folders.result(id, fence + 1));
    let made = tokio::task::spawn_blocking(move || {
        let result = result; // the whole value: the folder exists as long as it does
        extend(&result.path, &known, &formats, &staging, &extended)
    });
    let files = match made.await.map_err(Problem::internal)? {
        Ok(Some(files)) => files,
        Ok(None) => return Ok(()),
        Err(_) if app.queue.get(tenant, id).await?.is_none() => return Err(Problem::not_found("job")), // deleted meanwhile
        Err(ExtensionError::Write(error)) => return Err(Problem::from_io(&error)),
        Err(error) => {
            tracing::error!(job.id = id, %error, "formats cannot be added to a published result");
            let remedy = "run the job again and inform the operator";
            let status = StatusCode::INTERNAL_SERVER_ERROR;
            return Err(Problem::new(status, "corrupt", "the published result is damaged or cannot be read", remedy));
        }
    };
    app.store.blobs.take_result(id, fence + 1, &files).await?;
    // An error leaves open whether the rows were written: the folder stays, and the next start removes it if no row refers to it.
    if app.queue.replace_result(tenant, id, fence, &files).await? {
        return Ok(());
    }
    app.store.remove_claim(id, fence + 1).await;
    Err(Problem::not_found("job"))
}
