//! Uploads of sessions: received into a temporary file, recognised, validated, stored.

use super::app::App;
use super::body::{GuardedBody, Refused, Spool, Spooled, refuse};
use super::error::Problem;
use super::multipart::Multipart;
use crate::service::failpoint::failpoint;
use crate::service::store::artifacts::digest_file;
use crate::service::store::reservation::Reservation;
use crate::service::store::sessions::{self, Added, SessionSummary, StoredSession};
use crate::service::store::{Store, StoreError, Tenant, new_id};
use crate::service::validation::{self, ValidationError};
use crate::session::upload::{Fault, UploadError, UploadErrorKind};
use axum::body::Body;
use axum::http::{HeaderMap, StatusCode, header};
use std::path::PathBuf;
use tracing::Instrument;

/// Media type of a request body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MediaType {
    Zip,
    Json,
    Ndjson,
    Multipart,
}

impl MediaType {
    /// Reads `Content-Type`.
    pub(super) fn of(headers: &HeaderMap) -> Option<Self> {
        let value = headers.get(header::CONTENT_TYPE)?.to_str().ok()?;
        Self::parse(value.split(';').next().unwrap_or(value).trim())
    }

    fn parse(value: &str) -> Option<Self> {
        Some(match value.to_ascii_lowercase().as_str() {
            "application/zip" | "application/x-zip-compressed" => Self::Zip,
            "application/json" => Self::Json,
            "application/x-ndjson" | "application/ndjson" => Self::Ndjson,
            "multipart/form-data" => Self::Multipart,
            _ => return None,
        })
    }
}

/// 415; videos and images are answered with what to run first.
pub(super) fn unsupported(headers: &HeaderMap, accepted: &str) -> Problem {
    let media_type = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    if media_type.starts_with("video/") || media_type.starts_with("image/") {
        return upload_problem(Fault::PosesNotDetected.with("a video or an image holds no 2D poses"));
    }
    Problem::unsupported_media_type(accepted)
}

/// A complete upload and the space that it occupies until its row exists.
pub(super) struct Received {
    spooled: Spooled,
    reservation: Reservation,
}

/// Parts of a form: the upload and, where allowed, the options.
#[derive(Default)]
pub(super) struct Form {
    pub(super) session: Option<Received>,
    pub(super) options: Option<Vec<u8>>,
}

/// Reserves the bytes that `Content-Length` announces. Those of a form include its options and boundaries, so only the
/// session in it counts towards the quota, while it arrives.
async fn reserve(app: &App, tenant: &Tenant, headers: &HeaderMap, is_form: bool) -> Result<Reservation, Problem> {
    let length = headers.get(header::CONTENT_LENGTH).and_then(|value| value.to_str().ok()?.parse().ok());
    let max_bytes = app.settings.tenants.max_bytes;
    Ok(app.store.reserve(tenant, max_bytes, length.unwrap_or(0), !is_form).await?)
}

/// Streams a whole body to disk.
pub(super) async fn receive(app: &App, tenant: &Tenant, headers: &HeaderMap, body: Body) -> Result<Received, Problem> {
    let limits = &app.settings.limits;
    let body = GuardedBody::new(headers, body, limits, limits.max_upload_bytes);
    let mut body = unless_refused(body).await?;
    match spool(app, tenant, headers, &mut body).await {
        Ok(received) => Ok(received),
        Err(problem) => Err(refuse(body, problem).await),
    }
}

async fn spool(
    app: &App,
    tenant: &Tenant,
    headers: &HeaderMap,
    body: &mut GuardedBody<'_>,
) -> Result<Received, Problem> {
    let mut reservation = reserve(app, tenant, headers, false).await?;
    let mut spool = Spool::create(app.store.folders.temporary()).await?;
    while let Some(bytes) = body.chunk().await? {
        reservation.note(bytes.len() as u64)?;
        spool.write(&bytes).await?;
    }
    Ok(Received { spooled: spool.finish().await?, reservation })
}

/// Streams the part `session` of a form to disk and reads the part `options`, where it is `allowed`.
pub(super) async fn receive_form(
    app: &App,
    tenant: &Tenant,
    headers: &HeaderMap,
    body: Body,
    allowed: &[&str],
) -> Result<Form, Problem> {
    let limits = &app.settings.limits;
    let body = GuardedBody::new(headers, body, limits, limits.max_upload_bytes);
    let mut body = unless_refused(body).await?;
    match read_form(app, tenant, headers, &mut body, allowed).await {
        Ok(form) => Ok(form),
        Err(problem) => Err(refuse(body, problem).await),
    }
}

async fn read_form(
    app: &App,
    tenant: &Tenant,
    headers: &HeaderMap,
    body: &mut GuardedBody<'_>,
    allowed: &[&str],
) -> Result<Form, Problem> {
    let mut reservation = Some(reserve(app, tenant, headers, true).await?);
    let mut multipart = Multipart::new(headers, body)?;
    let mut form = Form::default();
    while let Some(part) = multipart.next_part().await? {
        let is_twice = match part.name.as_str() {
            "session" => form.session.is_some(),
            _ => form.options.is_some(),
        };
        if !allowed.contains(&part.name.as_str()) || is_twice {
            let detail =
                format!("the form has {} part `{}`", if is_twice { "a second" } else { "an unknown" }, part.name);
            return Err(Problem::malformed(detail, format!("send each of these parts once: {}", allowed.join(", "))));
        }
        if part.name == "options" {
            form.options = Some(multipart.text(app.settings.limits.max_json_bytes as usize).await?);
            continue;
        }
        let Some(mut reservation) = reservation.take() else { continue }; // taken by the only part `session`
        let mut spool = Spool::create(app.store.folders.temporary()).await?;
        while let Some(bytes) = multipart.data().await? {
            reservation.note(bytes.len() as u64)?;
            spool.write(&bytes).await?;
        }
        form.session = Some(Received { spooled: spool.finish().await?, reservation });
    }
    Ok(form)
}

pub(super) async fn unless_refused<T>(body: Result<T, Refused<'_>>) -> Result<T, Problem> {
    match body {
        Ok(body) => Ok(body),
        Err(refused) => Err(refused.problem().await),
    }
}

/// Validates and stores an upload; bytes that the tenant uploaded before give the stored session, and take the place of its bytes
/// where the disk has lost or changed those.
pub(super) async fn keep(app: &App, tenant: &Tenant, received: Received) -> Result<Added, Problem> {
    let spooled = &received.spooled;
    if let Some(session) = sessions::get_by_sha256(&app.store, tenant, &spooled.sha256).await? {
        if !has_its_bytes(&app.store, &session).await? {
            tracing::warn!(session.id, "the stored bytes of a session were damaged; the same upload has replaced them");
            name(received.spooled, app.store.folders.session(&session.id)).await?;
            app.store.blobs.take_session(&session.id, &session.summary.sha256).await?;
        }
        return Ok(Added { session, is_new: false });
    }
    failpoint("upload.spooled");
    let _turn = app.validations.acquire().await.map_err(Problem::internal)?; // each may take its whole memory limit
    let read = validation::validate(&app.settings, &spooled.file.path).await?;
    let summary = SessionSummary { sha256: spooled.sha256.clone(), bytes: spooled.bytes, ..read };
    record_unattended(&app.store, tenant, received, summary, app.settings.tenants.max_bytes).await
}

/// [`record`] in a task that outlives its request: a client that leaves must not leave bytes without a row behind.
async fn record_unattended(
    store: &Store,
    tenant: &Tenant,
    received: Received,
    summary: SessionSummary,
    max_bytes: i64,
) -> Result<Added, Problem> {
    let (store, tenant) = (store.clone(), tenant.clone());
    let recorded = async move { record(&store, &tenant, received, &summary, max_bytes).await };
    tokio::spawn(recorded.in_current_span()).await.map_err(Problem::internal)?
}

/// Gives a validated upload its name and its row.
async fn record(
    store: &Store,
    tenant: &Tenant,
    received: Received,
    summary: &SessionSummary,
    max_bytes: i64,
) -> Result<Added, Problem> {
    let Received { spooled, reservation: _until_the_row_exists } = received;
    let id = new_id("session");
    name(spooled, store.folders.session(&id)).await?;
    store.blobs.take_session(&id, &summary.sha256).await?;
    let added = sessions::add(store, tenant, &id, summary, max_bytes).await;
    failpoint("upload.recorded");
    if added.as_ref().is_ok_and(|added| added.is_new) {
        return Ok(added?);
    }
    // The same bytes arrived twice at the same time, or the row was refused. An error can also mean that the answer to the
    // COMMIT was lost: then the row is there, and the bytes belong to it.
    match sessions::get(store, tenant, &id).await {
        Ok(Some(session)) => return Ok(Added { session, is_new: true }),
        Ok(None) => store.remove_files("sessions", &id).await,
        Err(error) => {
            tracing::warn!(%error, session.id = id, "an upload may have no row; the next start removes it then")
        }
    }
    Ok(added?)
}

/// Makes an upload durable under its final name.
async fn name(spooled: Spooled, path: PathBuf) -> Result<(), Problem> {
    let kept = tokio::task::spawn_blocking(move || spooled.file.keep_as(&path));
    kept.await.map_err(Problem::internal)?.map_err(|error| Problem::from_io(&error))
}

/// Whether the stored bytes of a session are those of its upload.
pub(super) async fn has_its_bytes(store: &Store, session: &StoredSession) -> Result<bool, Problem> {
    let sha256 = session.summary.sha256.clone();
    let file = match store.blobs.session(&session.id, &sha256).await {
        Err(StoreError::BlobDamaged { .. }) => return Ok(false),
        file => file?,
    };
    let compared = tokio::task::spawn_blocking(move || {
        let file = file; // the whole value: the file exists as long as it does
        digest_file(&file.path).is_ok_and(|digest| digest.sha256 == sha256)
    });
    compared.await.map_err(Problem::internal)
}

/// Describes a rejected upload to the client.
fn upload_problem(error: UploadError) -> Problem {
    let status = match error.kind {
        UploadErrorKind::Malformed => StatusCode::BAD_REQUEST,
        UploadErrorKind::TooLarge => StatusCode::PAYLOAD_TOO_LARGE,
        UploadErrorKind::Unsupported => StatusCode::UNSUPPORTED_MEDIA_TYPE,
        UploadErrorKind::Impossible => StatusCode::UNPROCESSABLE_ENTITY,
    };
    Problem::of_upload(status, error)
}

impl From<ValidationError> for Problem {
    fn from(error: ValidationError) -> Self {
        let detail = error.to_string();
        match error {
            ValidationError::Refused(error) => upload_problem(error),
            ValidationError::TooLarge { setting, .. } => Self::new(
                StatusCode::PAYLOAD_TOO_LARGE,
                "too_large",
                detail,
                format!("send fewer frames or fewer cameras, or ask the operator to raise limits.{setting}"),
            ),
            ValidationError::MemoryShort => Self::unavailable("memory_short", detail),
            ValidationError::Failed(error) => Self::internal(format!("{error:#}")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::store::test_support;
    use std::time::{Duration, Instant};

    #[tokio::test(flavor = "multi_thread")]
    async fn an_upload_whose_client_leaves_gets_its_row() {
        let folder = tempfile::tempdir().unwrap();
        let (store, tenant) = (test_support::open(folder.path()).await, Tenant::default_tenant());
        let summary = test_support::summary();
        let mut spool = Spool::create(store.folders.temporary()).await.unwrap();
        spool.write(b"bytes").await.unwrap();
        let reservation = store.reserve(&tenant, i64::MAX, 0, true).await.unwrap();
        let received = Received { spooled: spool.finish().await.unwrap(), reservation };
        let sha256 = summary.sha256.clone();
        let request = record_unattended(&store, &tenant, received, summary, i64::MAX);
        // The first poll starts the work, and the request is dropped before its end.
        let answered = tokio::time::timeout(Duration::ZERO, request).await;
        let deadline = Instant::now() + Duration::from_secs(20);
        while sessions::get_by_sha256(&store, &tenant, &sha256).await.unwrap().is_none() {
            assert!(Instant::now() < deadline, "bytes without a row: {:?}", store.folders.names("sessions"));
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        assert!(answered.is_err() || answered.is_ok_and(|added| added.is_ok()));
        assert_eq!(store.folders.names("sessions").unwrap().len(), 1);
    }
}
