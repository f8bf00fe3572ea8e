//! `/v1/jobs/{id}/result`, `/artifacts/{name}`, `/cameras`, `/people`, `/report`: published files, by their digest.

use super::access::Caller;
use super::error::Problem;
use super::range::{Part, requested_part};
use super::{ApiPath, App};
use crate::service::metrics::Held;
use crate::service::queue::job::JobState;
use crate::service::store::artifacts::{self, Artifact, digest_file};
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodRouter, get};
use futures_util::StreamExt;
use std::path::PathBuf;
use tokio::io::{AsyncReadExt, AsyncSeekExt};
use tokio_util::io::ReaderStream;

/// A route to one file that every result has.
pub(super) fn named(name: &'static str) -> MethodRouter<App> {
    get(move |app: State<App>, caller: Caller, id: ApiPath<String>, headers: HeaderMap| {
        file(app, caller, id, name, headers)
    })
}

/// Any file by its name in the manifest.
pub(super) async fn artifact(
    app: State<App>,
    caller: Caller,
    ApiPath((id, name)): ApiPath<(String, String)>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    file(app, caller, ApiPath(id), &name, headers).await
}

async fn file(
    State(app): State<App>,
    Caller { tenant }: Caller,
    ApiPath(id): ApiPath<String>,
    name: &str,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let job = app.queue.get(&tenant, &id).await?.ok_or_else(|| Problem::not_found("job"))?;
    let JobState::Succeeded { result_fence, .. } = job.state else {
        return Err(not_ready(&id, job.state.phase().name()));
    };
    let artifact = artifacts::get(&app.store, &id, name).await?.ok_or_else(|| no_such_file(&id))?;
    let path = app.store.folders.result(&id, result_fence).join(&artifact.name);
    let tag = format!("\"{}\"", artifact.sha256);
    if matches_any(&headers, &tag) {
        return Ok((StatusCode::NOT_MODIFIED, [(header::ETAG, tag)]).into_response());
    }
    require_undamaged(&artifact, path.clone()).await?;
    let part = requested_part(&headers, &tag, artifact.bytes)?;
    send(&artifact, path, &tag, part, Held::new(&app.metrics)).await
}

fn not_ready(id: &str, state: &str) -> Problem {
    Problem::new(
        StatusCode::CONFLICT,
        "not_ready",
        format!("the job is {state}: there is no result"),
        format!("wait for `succeeded` with GET /v1/jobs/{id}?wait=30"),
    )
}

fn no_such_file(id: &str) -> Problem {
    Problem::new(
        StatusCode::NOT_FOUND,
        "not_found",
        "the result has no such file",
        format!("the manifest at /v1/jobs/{id}/result names them all"),
    )
}

/// `If-None-Match`: a list of tags, weak ones too, or `*`.
fn matches_any(headers: &HeaderMap, tag: &str) -> bool {
    let known = headers.get(header::IF_NONE_MATCH).and_then(|value| value.to_str().ok()).unwrap_or_default();
    known.split(',').map(str::trim).any(|known| known == "*" || known.trim_start_matches("W/") == tag)
}

/// Hashes the file before its first byte is sent: a damaged result is an error, never wrong bytes.
async fn require_undamaged(artifact: &Artifact, path: PathBuf) -> Result<(), Problem> {
    let digest = tokio::task::spawn_blocking(move || digest_file(&path)).await.map_err(Problem::internal)?;
    match digest {
        Ok(digest) if digest.sha256 == artifact.sha256 => Ok(()),
        Ok(_) => Err(corrupt(artifact, "its digest is not the published one")),
        Err(error) => Err(corrupt(artifact, &error.to_string())),
    }
}

fn corrupt(artifact: &Artifact, reason: &str) -> Problem {
    tracing::error!(artifact = artifact.name, reason, "a published file is damaged");
    Problem::new(
        StatusCode::INTERNAL_SERVER_ERROR,
        "corrupt",
        "the file on the service's disk is damaged or gone",
        "run the job again, and tell the operator",
    )
}

async fn send(artifact: &Artifact, path: PathBuf, tag: &str, part: Part, held: Held) -> Result<Response, Problem> {
    let mut file = tokio::fs::File::open(path).await.map_err(|error| corrupt(artifact, &error.to_string()))?;
    file.seek(std::io::SeekFrom::Start(part.start)).await.map_err(|error| Problem::from_io(&error))?;
    let bytes = ReaderStream::with_capacity(file.take(part.length), 64 << 10);
    let body = Body::from_stream(bytes.inspect(move |_| _ = &held)); // counted until the last byte, or the client, is gone
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
    set(header::X_CONTENT_TYPE_OPTIONS, "nosniff");
    set(header::CONTENT_DISPOSITION, &disposition(&artifact.name));
    if part.is_partial {
        let last = part.start + part.length - 1;
        set(header::CONTENT_RANGE, &format!("bytes {}-{last}/{}", part.start, artifact.bytes));
        *response.status_mut() = StatusCode::PARTIAL_CONTENT;
    }
    Ok(response)
}

/// RFC 6266, the name in RFC 8187's form: whatever a camera is called, the header stays one header.
fn disposition(name: &str) -> String {
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
