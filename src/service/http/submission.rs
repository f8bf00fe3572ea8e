//! `POST /v1/jobs`: a job on a stored session, or session and job in one form.

use super::access::Caller;
use super::error::Problem;
use super::intake::{MediaType, keep, receive_form, unless_refused};
use super::jobs::answer;
use super::upload::GuardedBody;
use super::{App, options};
use crate::service::queue::{EnqueueError, IdempotencyKey, NewJob, QueueLimits};
use crate::service::store::Tenant;
use crate::service::store::sessions::{self, StoredSession};
use crate::service::webhooks;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;

/// Labels of one job.
const MAX_LABELS: usize = 32;
/// Characters of a label's key or value, and of an Idempotency-Key.
const MAX_LABEL_CHARS: usize = 256;
/// `priority` lies within plus and minus this.
const MAX_PRIORITY: i64 = 1000;

/// The body of `POST /v1/jobs` as JSON.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct NewJobBody {
    session: String,
    options: Option<Value>,
    #[serde(default)]
    labels: BTreeMap<String, String>,
    #[serde(default)]
    priority: i64,
    webhook: Option<Webhook>,
}

/// Who is to be told of the job's end.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Webhook {
    url: String,
}

/// `POST /v1/jobs`: 202, `Location` and the job.
pub(super) async fn create(
    State(app): State<App>,
    Caller { tenant }: Caller,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let (asked, session) = match MediaType::of(&headers) {
        Some(MediaType::Json) => of_stored_session(&app, &tenant, &headers, body).await?,
        Some(MediaType::Multipart) => of_uploaded_session(&app, &tenant, &headers, body).await?,
        _ => return Err(Problem::unsupported_media_type("application/json or multipart/form-data")),
    };
    let parsed = options::parse(asked.options)?;
    options::check(&parsed, &session.summary.camera_facts, &app.store.folders.bodies())?;
    check_marks(&asked.labels, asked.priority)?;
    let webhook = asked.webhook.map(|webhook| webhook_url(&app, webhook)).transpose()?;
    let options = serde_json::to_value(&parsed).map_err(Problem::internal)?;
    let new = NewJob { tenant, session: session.id, options, labels: asked.labels, priority: asked.priority, webhook };
    let key = idempotency_key(&headers, &new, &session.summary.sha256)?;
    let job =
        app.queue.enqueue(&new, key.as_ref(), QueueLimits::of(&app.settings.limits, &app.settings.tenants)).await?;
    let location = [(header::LOCATION, format!("/v1/jobs/{}", job.id))];
    Ok((StatusCode::ACCEPTED, location, answer(&job)).into_response())
}

async fn of_stored_session(
    app: &App,
    tenant: &Tenant,
    headers: &HeaderMap,
    body: Body,
) -> Result<(NewJobBody, StoredSession), Problem> {
    let limits = &app.settings.limits;
    let body = unless_refused(GuardedBody::new(headers, body, limits, limits.max_json_bytes)).await?;
    let text = unless_refused(body.read_all().await).await?;
    let asked: NewJobBody = serde_json::from_slice(&text).map_err(|error| {
        Problem::malformed(
            format!("the body: {error}"),
            "send {\"session\": \"<id>\", \"options\"?: {…}, \"labels\"?: {…}, \"priority\"?: 0}",
        )
    })?;
    let session = sessions::get(&app.store, tenant, &asked.session).await?;
    let session = session.ok_or_else(|| session_missing().at("/session"))?;
    Ok((asked, session))
}

async fn of_uploaded_session(
    app: &App,
    tenant: &Tenant,
    headers: &HeaderMap,
    body: Body,
) -> Result<(NewJobBody, StoredSession), Problem> {
    let form = receive_form(app, tenant, headers, body, &["session", "options"]).await?;
    let received = form.session.ok_or_else(|| {
        Problem::malformed("the form has no part `session`", "send the session as the part `session`")
    })?;
    let text = form.options.filter(|text| !text.is_empty());
    let options = text.map(|text| serde_json::from_slice(&text)).transpose().map_err(|error| {
        Problem::malformed(format!("the part `options`: {error}"), "send one JSON object").at("/options")
    })?;
    options::parse(options.clone())?; // before the upload is validated and kept
    let session = keep(app, tenant, received).await?.session;
    let asked =
        NewJobBody { session: session.id.clone(), options, labels: BTreeMap::new(), priority: 0, webhook: None };
    Ok((asked, session))
}

fn session_missing() -> Problem {
    Problem::new(
        StatusCode::NOT_FOUND,
        "session_not_found",
        "there is no such session",
        "upload it with POST /v1/sessions",
    )
}

/// A URL that may be called; what it resolves to is checked again at each call.
fn webhook_url(app: &App, webhook: Webhook) -> Result<String, Problem> {
    let refused = |error: webhooks::TargetError| {
        Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "webhook_refused", error.to_string(), error.remedy())
            .at("/webhook/url")
    };
    webhooks::check_url(&webhook.url, &app.allowed_networks).map_err(refused)?;
    Ok(webhook.url)
}

fn check_marks(labels: &BTreeMap<String, String>, priority: i64) -> Result<(), Problem> {
    let is_long = |text: &String| text.chars().count() > MAX_LABEL_CHARS;
    if labels.len() > MAX_LABELS || labels.iter().any(|(key, value)| key.is_empty() || is_long(key) || is_long(value)) {
        let remedy = format!("give at most {MAX_LABELS} labels of 1 to {MAX_LABEL_CHARS} characters");
        return Err(Problem::malformed("labels are too many, too long or empty", remedy).at("/labels"));
    }
    if priority.abs() > MAX_PRIORITY {
        let remedy = format!("take -{MAX_PRIORITY} to {MAX_PRIORITY}");
        return Err(Problem::malformed("priority is out of range", remedy).at("/priority"));
    }
    Ok(())
}

/// The key, bound to the canonical request: a form's boundary and a document's spaces do not count.
fn idempotency_key(headers: &HeaderMap, new: &NewJob, sha256: &str) -> Result<Option<IdempotencyKey>, Problem> {
    let Some(key) = headers.get("idempotency-key") else { return Ok(None) };
    let key =
        key.to_str().ok().filter(|key| (1..=MAX_LABEL_CHARS).contains(&key.len())).ok_or_else(|| {
            Problem::malformed("the Idempotency-Key is empty, too long or no ASCII", "send a fresh UUID")
        })?;
    let request = json!([sha256, new.options, new.labels, new.priority, new.webhook]).to_string();
    let fingerprint = hex::encode(Sha256::digest(request.as_bytes()));
    Ok(Some(IdempotencyKey { key: key.to_owned(), fingerprint }))
}

impl From<EnqueueError> for Problem {
    fn from(error: EnqueueError) -> Self {
        match error {
            EnqueueError::SessionMissing => session_missing(),
            EnqueueError::KeyReused => Self::new(
                StatusCode::UNPROCESSABLE_ENTITY,
                "idempotency_key_reused",
                "the Idempotency-Key was used for another request",
                "take a fresh key for each new request",
            ),
            EnqueueError::JobDeleted => Self::new(
                StatusCode::CONFLICT,
                "job_deleted",
                "the job of this Idempotency-Key was deleted",
                "take a fresh key to run it again",
            ),
            EnqueueError::Full { .. } | EnqueueError::TenantFull { .. } => {
                Self::new(StatusCode::TOO_MANY_REQUESTS, "queue_full", error.to_string(), "try again later")
                    .with_header(header::RETRY_AFTER, HeaderValue::from_static("60"))
            }
            EnqueueError::Store(error) => error.into(),
        }
    }
}
