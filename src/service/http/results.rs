//! `/v1/jobs/{id}/result`, `/artifacts/{name}`, `/cameras`, `/people`, `/report`: the published files of a job.

use super::access::Caller;
use super::app::App;
use super::conditions::{is_unchanged, require_match};
use super::error::Problem;
use super::extract::{ApiPath, JobPath};
use super::range::{Part, requested_part};
use crate::service::metrics::Held;
use crate::service::queue::Phase;
use crate::service::queue::job::JobState;
use crate::service::store::artifacts::{self, Artifact, digest_of};
use crate::service::store::{StoreError, Tenant};
use axum::body::Body;
use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures_util::StreamExt;
use serde::Deserialize;
use serde_json::Value;
use std::fs::File;
use std::path::PathBuf;
use tokio::io::{AsyncReadExt, AsyncSeekExt};
use tokio_util::io::ReaderStream;
use utoipa::{IntoParams, IntoResponses, ToSchema};

/// Everything of a request for a file but its path.
pub(super) struct FileRequest {
    pub(super) app: App,
    pub(super) caller: Caller,
    pub(super) headers: HeaderMap,
}

impl FromRequestParts<App> for FileRequest {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, app: &App) -> Result<Self, Problem> {
        let caller = Caller::from_request_parts(parts, app).await?;
        Ok(Self { app: app.clone(), caller, headers: parts.headers.clone() })
    }
}

/// A JSON document; the README describes each file.
#[derive(ToSchema)]
#[schema(value_type = Object)]
#[allow(dead_code)]
pub(super) struct JsonFile(Value);

/// Answers of the routes to JSON files.
#[derive(IntoResponses)]
#[allow(dead_code)] // describes what `FileRequest::answer` sends
enum FileAnswer {
    /// The file.
    #[response(status = 200, content_type = "application/json", headers(("ETag" = String)))]
    Whole(#[to_schema] JsonFile),
    /// The requested range.
    #[response(status = 206)]
    Range,
    /// Unchanged.
    #[response(status = 304)]
    Unchanged,
    #[response(status = 409)]
    NotReady,
    #[response(status = 412)]
    OtherVersion,
    #[response(status = 416)]
    RangeNotSatisfiable,
    #[response(status = 500)]
    Corrupt,
}

/// `{id}` of a job and `{name}` of a file.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct ArtifactPath {
    /// Id of the job.
    #[param(pattern = "^job_[0-9a-f]{32}$")]
    id: String,
    /// Name of the file in the manifest; may contain slashes.
    name: String,
}

/// Get the manifest: every file of the result with its digest.
#[utoipa::path(
    get,
    path = "/v1/jobs/{id}/result",
    operation_id = "getResult",
    tag = "results",
    params(JobPath),
    responses(FileAnswer)
)]
pub(super) async fn manifest(job: ApiPath<JobPath>, request: FileRequest) -> Result<Response, Problem> {
    request.answer(&job.0.id, "manifest.json").await
}

/// Get `cameras.json`.
#[utoipa::path(
    get,
    path = "/v1/jobs/{id}/cameras",
    operation_id = "getCameras",
    tag = "results",
    params(JobPath),
    responses(FileAnswer)
)]
pub(super) async fn cameras(job: ApiPath<JobPath>, request: FileRequest) -> Result<Response, Problem> {
    request.answer(&job.0.id, "cameras.json").await
}

/// Get `people.json`.
#[utoipa::path(
    get,
    path = "/v1/jobs/{id}/people",
    operation_id = "getPeople",
    tag = "results",
    params(JobPath),
    responses(FileAnswer)
)]
pub(super) async fn people(job: ApiPath<JobPath>, request: FileRequest) -> Result<Response, Problem> {
    request.answer(&job.0.id, "people.json").await
}

/// Get `report.json`.
#[utoipa::path(
    get,
    path = "/v1/jobs/{id}/report",
    operation_id = "getReport",
    tag = "results",
    params(JobPath),
    responses(FileAnswer)
)]
pub(super) async fn report(job: ApiPath<JobPath>, request: FileRequest) -> Result<Response, Problem> {
    request.answer(&job.0.id, "report.json").await
}

/// Get one file of the result.
#[utoipa::path(get, path = "/v1/jobs/{id}/artifacts/{*name}", operation_id = "getArtifact", tag = "results",
    params(ArtifactPath),
    responses((status = 200, description = "The file", body = Value, content_type = "*/*", headers(("ETag" = String))),
        (status = 206, description = "The requested range"), (status = 304, description = "Unchanged"),
        (status = 409), (status = 412), (status = 416), (status = 500)))]
pub(super) async fn artifact(path: ApiPath<ArtifactPath>, request: FileRequest) -> Result<Response, Problem> {
    request.answer(&path.0.id, &path.0.name).await
}

impl FileRequest {
    /// Sends the file `name` of the job `id`, or the requested part of it.
    pub(super) async fn answer(self, id: &str, name: &str) -> Result<Response, Problem> {
        let Self { app, caller: Caller { tenant }, headers } = self;
        let result_fence = published_fence(&app, &tenant, id).await?;
        let artifact = artifacts::get(&app.store, id, name).await?.ok_or_else(|| no_such_file(id))?;
        let tag = format!("\"{}\"", artifact.sha256);
        require_match(&headers, &tag)?;
        if is_unchanged(&headers, &tag) {
            return Ok((StatusCode::NOT_MODIFIED, [(header::ETAG, tag)]).into_response());
        }
        let part = requested_part(&headers, &tag, artifact.bytes)?;
        match readable(&app, id, result_fence, &artifact, part).await? {
            Ok(file) => send(&artifact, file, &tag, part, Held::new(&app.metrics)).await,
            // Deleted meanwhile, or replaced by a result with further formats.
            Err(_) if published_fence(&app, &tenant, id).await? != result_fence => Err(replaced()),
            Err(damage) => Err(corrupt(&artifact, &damage)),
        }
    }
}

/// The fence of the published result of a job.
pub(super) async fn published_fence(app: &App, tenant: &Tenant, id: &str) -> Result<i64, Problem> {
    let job = app.queue.get(tenant, id).await?.ok_or_else(|| Problem::not_found("job"))?;
    match job.state {
        JobState::Succeeded { result_fence, .. } => Ok(result_fence),
        other => Err(not_ready(id, other.phase())),
    }
}

/// Says that a request has met a change of the result.
pub(super) fn replaced() -> Problem {
    Problem::unavailable("busy", "formats were added to the result in this moment")
}

fn not_ready(id: &str, phase: Phase) -> Problem {
    let remedy = match phase.is_final() {
        true => format!("it will have none: GET /v1/jobs/{id} states the reason; submit another job"),
        false => format!("wait for `succeeded` with GET /v1/jobs/{id}?wait=30"),
    };
    let detail = format!("the job is {} and has no result", phase.name());
    Problem::new(StatusCode::CONFLICT, "not_ready", detail, remedy)
}

pub(super) fn no_such_file(id: &str) -> Problem {
    Problem::new(
        StatusCode::NOT_FOUND,
        "not_found",
        "the result does not contain this file",
        format!("GET /v1/jobs/{id}/result lists all files"),
    )
}

/// Opens a published file whose digest was compared; a damaged local copy of an object is fetched again.
async fn readable(
    app: &App,
    id: &str,
    result_fence: i64,
    artifact: &Artifact,
    part: Part,
) -> Result<Result<File, String>, Problem> {
    loop {
        let local = match app.store.blobs.artifact(id, result_fence, artifact).await {
            Err(damage @ StoreError::BlobDamaged { .. }) => return Ok(Err(damage.to_string())),
            local => local?,
        };
        let opened = undamaged(app, artifact, local.path.clone(), part).await?;
        if opened.is_ok() || !app.store.blobs.forget(&artifact.sha256) {
            return Ok(opened);
        }
    }
}

/// Opens the file and compares its digest before its first byte is sent: a damaged file gives an error, never wrong bytes.
/// A part of a file is sent without that if the file was compared a short time ago and was not written since.
async fn undamaged(app: &App, artifact: &Artifact, path: PathBuf, part: Part) -> Result<Result<File, String>, Problem> {
    let (sha256, verified) = (artifact.sha256.clone(), app.verified.clone());
    let opened = tokio::task::spawn_blocking(move || -> std::io::Result<Option<File>> {
        let mut file = File::open(path)?;
        let state = file.metadata()?;
        if part.is_partial && verified.contain(&state, &sha256) {
            return Ok(Some(file));
        }
        if digest_of(&mut file)?.sha256 != sha256 {
            return Ok(None);
        }
        verified.insert(&state, sha256);
        Ok(Some(file))
    });
    let opened = opened.await.map_err(Problem::internal)?;
    Ok(match opened {
        Ok(file) => file.ok_or_else(|| "the digest differs from the published one".to_owned()),
        Err(error) => Err(error.to_string()),
    })
}

fn corrupt(artifact: &Artifact, reason: &str) -> Problem {
    tracing::error!(artifact = artifact.name, reason, "a published file is damaged");
    Problem::new(
        StatusCode::INTERNAL_SERVER_ERROR,
        "corrupt",
        "the file on the disk of the service is damaged or missing",
        "run the job again and inform the operator",
    )
}

async fn send(artifact: &Artifact, file: File, tag: &str, part: Part, held: Held) -> Result<Response, Problem> {
    let mut file = tokio::fs::File::from_std(file);
    file.seek(std::io::SeekFrom::Start(part.start)).await.map_err(|error| Problem::from_io(&error))?;
    let bytes = ReaderStream::with_capacity(file.take(part.length), 64 << 10);
    let body = Body::from_stream(bytes.inspect(move |_| _ = &held)); // counted until the last byte is sent or the client disconnects
    let mut response = Response::new(body);
    let mut set = |name, value: &str| {
        if let Ok(value) = HeaderValue::from_str(value) {
            response.headers_mut().insert(name, value);
        }
    };
    set(header::CONTENT_TYPE, &artifact.media_type);
    set(header::CONTENT_LENGTH, &part.length.to_string());
    set(header::ACCEPT_RANGES, "bytes");
    set(header::ETAG, tag);
    set(header::CONTENT_DISPOSITION, &disposition(&artifact.name));
    if part.is_partial {
        let last = part.start + part.length - 1;
        set(header::CONTENT_RANGE, &format!("bytes {}-{last}/{}", part.start, artifact.bytes));
        *response.status_mut() = StatusCode::PARTIAL_CONTENT;
    }
    Ok(response)
}

/// `Content-Disposition` (RFC 6266) with the file name encoded by RFC 8187, so that no name can break the header.
pub(super) fn disposition(name: &str) -> String {
    let last = name.rsplit('/').next().unwrap_or(name);
    let encoded: String = last
        .bytes()
        .map(|byte| match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'.' | b'-' | b'_' => char::from(byte).to_string(),
            _ => format!("%{byte:02X}"),
        })
        .collect();
    format!("attachment; filename*=UTF-8''{encoded}")
}
