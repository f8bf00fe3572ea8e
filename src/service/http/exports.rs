//! `POST /v1/jobs/{id}/exports`: adds formats to the result of a finished job.

use super::access::Caller;
use super::app::App;
use super::body::{GuardedBody, object};
use super::error::Problem;
use super::extract::{ApiPath, JobPath};
use super::results::{FileRequest, JsonFile, published_fence, replaced};
use super::upload::unless_refused;
use crate::service::exports::{ExtensionError, extend};
use crate::service::queue::Extension;
use crate::service::store::Tenant;
use crate::service::store::artifacts::Artifact;
use crate::session::reconstruction::ExportFormat;
use axum::body::Body;
use axum::http::{HeaderMap, StatusCode};
use axum::response::Response;
use serde::Deserialize;
use utoipa::ToSchema;

/// Tries to add formats to a result that other processes extend at the same time; each lost try means that another request was served.
const MAX_TRIES: usize = 4;

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
    let asked: NewExports = object(&text, remedy)?;
    if asked.exports.is_empty() {
        return Err(Problem::malformed("`exports` is empty", remedy).at("/exports"));
    }
    Ok(asked.exports)
}

async fn add_formats(app: &App, tenant: &Tenant, id: &str, formats: Vec<ExportFormat>) -> Result<(), Problem> {
    let _turn = app.exporting.acquire().await.map_err(Problem::internal)?; // of this process; others are met by the fence
    let _space = app.store.reserve(tenant, app.settings.tenants.max_bytes, 0, false).await?;
    for _ in 0..MAX_TRIES {
        let extension = app.queue.begin_extension(tenant, id).await?.ok_or_else(|| Problem::not_found("job"))?;
        let files = match build(app, id, &extension, &formats).await {
            Ok(None) => return Ok(()),
            Ok(Some(files)) => files,
            Err(problem) => {
                app.store.remove_claim(id, extension.fence).await; // no row names it
                if published_fence(app, tenant, id).await? == extension.published {
                    return Err(problem);
                }
                continue; // the files were those of a result that another process has replaced
            }
        };
        // An error leaves open whether the rows were written: the files stay, and the next start or the sweep of the object store
        // removes them if no row refers to them.
        if app.queue.replace_result(tenant, id, &extension, &files).await? {
            return Ok(());
        }
        app.store.remove_claim(id, extension.fence).await;
    }
    Err(replaced())
}

/// Builds the result with further formats in the folder of its own fence, and hands it over; `None`, without files, if the published
/// result has all formats already.
async fn build(
    app: &App,
    id: &str,
    extension: &Extension,
    formats: &[ExportFormat],
) -> Result<Option<Vec<Artifact>>, Problem> {
    let Extension { published, files: known, fence } = extension;
    let folders = &app.store.folders;
    let result = app.store.blobs.result(id, *published, known).await?;
    let (staging, extended) = (folders.staging(id, *fence), folders.result(id, *fence));
    let (known, formats) = (known.clone(), formats.to_vec());
    let made = tokio::task::spawn_blocking(move || {
        let result = result; // the whole value: the folder exists as long as it does
        extend(&result.path, &known, &formats, &staging, &extended)
    });
    match made.await.map_err(Problem::internal)? {
        Ok(None) => Ok(None),
        Ok(Some(files)) => {
            app.store.blobs.take_result(id, *fence, &files).await?;
            Ok(Some(files))
        }
        Err(ExtensionError::Write(error)) => Err(Problem::from_io(&error)),
        Err(error) => {
            tracing::error!(job.id = id, %error, "formats cannot be added to a published result");
            let remedy = "run the job again and inform the operator";
            let status = StatusCode::INTERNAL_SERVER_ERROR;
            Err(Problem::new(status, "corrupt", "the published result is damaged or cannot be read", remedy))
        }
    }
}
