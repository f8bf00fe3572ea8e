//! `POST /v1/jobs`: creates a job for a stored session, or for a session in the same form.

use super::access::Caller;
use super::app::App;
use super::body::{GuardedBody, object};
use super::correction::{corrected_job, not_an_object, with_options_of};
use super::error::Problem;
use super::jobs::{JobDocument, answer};
use super::options;
use super::upload::{MediaType, keep, receive_form, unless_refused};
use crate::pipeline::corrections::Correction;
use crate::pipeline::{CameraFacts, Options};
use crate::service::queue::job::{Job, Submitter};
use crate::service::queue::{EnqueueError, IdempotencyKey, NewJob, QueueLimits, fingerprint_as_sent};
use crate::service::store::Tenant;
use crate::service::store::sessions::{self, AddError, SessionSummary, StoredSession};
use crate::service::webhooks;
use crate::session::parser_errors::in_json_words;
use axum::Extension;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use serde::de::{Deserializer, Error as _};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use utoipa::openapi::schema::{AdditionalProperties, Object, ObjectBuilder, Type};
use utoipa::{IntoParams, ToSchema};

/// Largest number of labels of one job.
const MAX_LABELS: usize = 32;
/// Longest label key, label value and Idempotency-Key, characters.
const MAX_LABEL_CHARS: usize = 256;
/// Largest size of all labels of one job, bytes of keys and values: lists return the labels of each job.
const MAX_LABEL_BYTES: usize = 4096;
/// Largest absolute value of `priority`.
const MAX_PRIORITY: i64 = 1000;

/// A job to create.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = NewJob)]
struct NewJobBody {
    /// Id of the session; that of the corrected job where it is left out.
    #[schema(nullable = false)]
    session: Option<String>,
    /// Id of a succeeded job whose people `options.corrections` correct. Its session and options are taken over, as far as the
    /// request does not state others, and the new job continues from what the corrections leave valid.
    #[serde(alias = "from_job")]
    #[schema(nullable = false)]
    corrects: Option<String>,
    /// The same as `options.corrections`.
    #[schema(value_type = Option<Vec<Correction>>, nullable = false)]
    corrections: Option<Value>,
    #[schema(value_type = Option<Options>)]
    options: Option<Value>,
    #[serde(default)]
    #[schema(schema_with = labels_schema)]
    labels: BTreeMap<String, String>,
    /// Jobs of higher priority run first, among the jobs of one tenant.
    #[serde(default)]
    #[schema(minimum = -1000, maximum = 1000, default = 0)]
    priority: i64,
    #[serde(default, deserialize_with = "webhook_object")]
    webhook: Option<Webhook>,
}

/// Reads a webhook from an object only: serde would take a list of its values, too.
fn webhook_object<'de, D: Deserializer<'de>>(document: D) -> Result<Option<Webhook>, D::Error> {
    let object = Option::<Map<String, Value>>::deserialize(document)?;
    object.map(|object| Webhook::deserialize(Value::Object(object)).map_err(D::Error::custom)).transpose()
}

impl NewJobBody {
    /// What separates a request that corrects a job from others under the same Idempotency-Key; `None` for other requests, which
    /// state all of what they mean.
    fn fingerprint_as_sent(&self) -> Option<String> {
        let Self { session, corrects, corrections: _among_options, options, labels, priority, webhook } = self;
        let corrects = corrects.as_ref()?;
        let webhook = webhook.as_ref().map(|webhook| &webhook.url);
        Some(fingerprint_as_sent(&json!([corrects, session, options, labels, priority, webhook])))
    }

    /// Moves `corrections` to the options.
    fn with_corrections_among_options(mut self) -> Result<Self, Problem> {
        let Some(corrections) = self.corrections.take() else { return Ok(self) };
        let options = self.options.take().filter(|options| !options.is_null()).unwrap_or_else(|| json!({}));
        let Value::Object(mut options) = options else { return Err(not_an_object()) };
        if options.insert("corrections".to_owned(), corrections).is_some() {
            let detail = "`corrections` and `options.corrections` are both stated";
            return Err(Problem::malformed(detail, "state one of them").at("/corrections"));
        }
        self.options = Some(Value::Object(options));
        Ok(self)
    }
}

fn labels_schema() -> Object {
    let text = || ObjectBuilder::new().schema_type(Type::String).max_length(Some(MAX_LABEL_CHARS));
    ObjectBuilder::new()
        .schema_type(Type::Object)
        .description(Some("Marks of the client, which `GET /v1/jobs?label=` can filter by"))
        .max_properties(Some(MAX_LABELS))
        .property_names(Some(text().min_length(Some(1)).pattern(Some("^[^=]+$"))))
        .additional_properties(Some(AdditionalProperties::RefOr(text().build().into())))
        .build()
}

/// Receiver of the HTTP call that reports the end of the job.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct Webhook {
    #[schema(format = "uri", max_length = 2000)]
    url: String,
}

/// A session and the options of its job as a form.
#[derive(ToSchema)]
#[allow(dead_code)] // describes what `receive_form` reads
struct JobForm {
    #[schema(format = Binary, content_media_type = "application/octet-stream")]
    session: String,
    /// Options as JSON.
    #[schema(required = false, content_media_type = "application/json")]
    options: String,
}

fn example_job() -> Value {
    json!({
        "session": "session_0123456789abcdef0123456789abcdef",
        "options": { "people": 3, "fps": 25, "scale": { "from": "height", "metres": 1.82, "who": "tallest" } },
        "labels": { "take": "07" },
    })
}

/// Headers of a submission.
#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code)] // describes what `idempotency_key` reads
struct SubmissionHeaders {
    /// The same key with the same request returns the same job, also after the session was deleted; with another request the
    /// answer is 422. 30 days after its first use, the key of a deleted job is forgotten.
    #[param(rename = "Idempotency-Key", nullable = false, min_length = 1, max_length = 256, pattern = "^[!-~]+$")]
    idempotency_key: Option<String>,
}

/// Submit a job.
#[utoipa::path(post, path = "/v1/jobs", operation_id = "createJob", tag = "jobs", params(SubmissionHeaders),
    request_body(content((NewJobBody = "application/json", example = json!(example_job())),
        (inline(JobForm) = "multipart/form-data"))),
    responses((status = 202, description = "Accepted: the job will reach a final state", body = JobDocument,
            headers(("Location" = String, description = "Path of the job"))),
        (status = 400), (status = 404), (status = 408), (status = 409), (status = 413), (status = 415), (status = 422),
        (status = 507)))]
pub(super) async fn create(
    State(app): State<App>,
    Caller { tenant }: Caller,
    Extension(submitter): Extension<Submitter>,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let key = idempotency_key(&headers)?;
    let mut as_sent = None;
    let (asked, session) = match MediaType::of(&headers) {
        Some(MediaType::Json) => {
            let asked = read_document(&app, &headers, body).await?.with_corrections_among_options()?;
            as_sent = asked.fingerprint_as_sent();
            // Before the corrected job is looked up: a repetition is answered after that job was deleted, too.
            if let (Some(key), Some(as_sent)) = (&key, &as_sent)
                && let Some(job) = app.queue.job_of_request(&tenant, key, as_sent).await?
            {
                return Ok(accepted(job));
            }
            of_stored_session(&app, &tenant, asked, key.as_deref()).await?
        }
        Some(MediaType::Multipart) => of_uploaded_session(&app, &tenant, &headers, body).await?,
        _ => return Err(Problem::unsupported_media_type("application/json or multipart/form-data")),
    };
    let parsed = options::parse(asked.options)?;
    if let Some(cameras) = &session.cameras {
        options::check(&parsed, cameras, &app.store.folders.bodies())?;
    }
    check_labels_and_priority(&asked.labels, asked.priority)?;
    let webhook = asked.webhook.map(|webhook| webhook_url(&app, webhook)).transpose()?;
    let options = serde_json::to_value(&parsed).map_err(Problem::internal)?;
    let (labels, priority) = (asked.labels, asked.priority);
    let new = NewJob { tenant, session: session.id, options, labels, priority, webhook, submitter };
    let key = key.map(|key| IdempotencyKey { key, fingerprint: new.fingerprint(&session.sha256), as_sent });
    let limits = QueueLimits::of(&app.settings.limits, &app.settings.tenants);
    Ok(accepted(app.queue.enqueue(&new, key.as_ref(), limits).await?))
}

fn accepted(job: Job) -> Response {
    tracing::Span::current().record("job.id", job.id.as_str());
    let location = [(header::LOCATION, format!("/v1/jobs/{}", job.id))];
    (StatusCode::ACCEPTED, location, answer(job)).into_response()
}

/// The session of a request.
struct AskedSession {
    id: String,
    sha256: String,
    /// `None` for a deleted session on which a job was accepted under the Idempotency-Key of this request.
    cameras: Option<Vec<CameraFacts>>,
}

impl AskedSession {
    fn stored(session: StoredSession) -> Self {
        let SessionSummary { sha256, camera_facts, .. } = session.summary;
        Self { id: session.id, sha256, cameras: Some(camera_facts) }
    }
}

async fn read_document(app: &App, headers: &HeaderMap, body: Body) -> Result<NewJobBody, Problem> {
    let limits = &app.settings.limits;
    let body = unless_refused(GuardedBody::new(headers, body, limits, limits.max_json_bytes)).await?;
    let text = unless_refused(body.read_all().await).await?;
    object(&text, "send {\"session\": \"<id>\", \"options\"?: {…}, \"labels\"?: {…}, \"priority\"?: 0}")
}

async fn of_stored_session(
    app: &App,
    tenant: &Tenant,
    mut asked: NewJobBody,
    key: Option<&str>,
) -> Result<(NewJobBody, AskedSession), Problem> {
    let id = take_over_corrected(app, tenant, &mut asked).await?;
    if let Some(session) = sessions::get(&app.store, tenant, &id).await? {
        return Ok((asked, AskedSession::stored(session)));
    }
    let sha256 = match key {
        Some(key) => app.queue.session_of_key(tenant, key, &id).await?,
        None => None,
    };
    let sha256 = sha256.ok_or_else(|| session_missing().at("/session"))?;
    let session = AskedSession { id, sha256, cameras: None };
    Ok((asked, session))
}

/// Adds the options of the job that is corrected; returns the id of the session.
async fn take_over_corrected(app: &App, tenant: &Tenant, asked: &mut NewJobBody) -> Result<String, Problem> {
    let Some(corrects) = &asked.corrects else {
        let missing = || Problem::malformed("the body names no session", "add `session`, or `corrects`");
        return asked.session.clone().ok_or_else(|| missing().at("/session"));
    };
    let earlier = corrected_job(app, tenant, corrects).await?;
    if asked.session.as_ref().is_some_and(|session| *session != earlier.session) {
        let detail = format!("the corrected job is of the session {}", earlier.session);
        return Err(Problem::malformed(detail, "leave `session` out").at("/session"));
    }
    asked.options = with_options_of(&earlier, asked.options.take())?;
    Ok(earlier.session)
}

async fn of_uploaded_session(
    app: &App,
    tenant: &Tenant,
    headers: &HeaderMap,
    body: Body,
) -> Result<(NewJobBody, AskedSession), Problem> {
    let form = receive_form(app, tenant, headers, body, &["session", "options"]).await?;
    let received = form
        .session
        .ok_or_else(|| Problem::malformed("the form has no part `session`", "add the session as the part `session`"))?;
    let text = form.options.filter(|text| !text.is_empty());
    let options = text.map(|text| serde_json::from_slice(&text)).transpose().map_err(|error| {
        Problem::malformed(format!("the part `options`: {}", in_json_words(&error)), "send one JSON object")
            .at("/options")
    })?;
    options::parse(options.clone())?; // before the upload is validated and stored
    let session = keep(app, tenant, received).await?.session;
    let (labels, session_id) = (BTreeMap::new(), Some(session.id.clone()));
    let (corrects, corrections, webhook) = (None, None, None);
    let asked = NewJobBody { session: session_id, corrects, corrections, options, labels, priority: 0, webhook };
    Ok((asked, AskedSession::stored(session)))
}

fn session_missing() -> Problem {
    Problem::new(
        StatusCode::NOT_FOUND,
        "session_not_found",
        "the session does not exist",
        "upload it with POST /v1/sessions",
    )
}

/// Checks that the URL may be called; the addresses that it resolves to are checked again at each call.
fn webhook_url(app: &App, webhook: Webhook) -> Result<String, Problem> {
    let refused = |error: webhooks::TargetError| {
        Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "webhook_refused", error.to_string(), error.remedy())
            .at("/webhook/url")
    };
    webhooks::check_url(&webhook.url, &app.allowed_networks).map_err(refused)?;
    Ok(webhook.url)
}

fn check_labels_and_priority(labels: &BTreeMap<String, String>, priority: i64) -> Result<(), Problem> {
    let is_long = |text: &String| text.chars().count() > MAX_LABEL_CHARS;
    if labels.len() > MAX_LABELS || labels.iter().any(|(key, value)| key.is_empty() || is_long(key) || is_long(value)) {
        let remedy = format!("use at most {MAX_LABELS} labels of 1 to {MAX_LABEL_CHARS} characters");
        return Err(
            Problem::malformed("there are too many labels, or a label is too long or empty", remedy).at("/labels")
        );
    }
    if let Some(key) = labels.keys().find(|key| key.contains('=')) {
        let detail =
            format!("the key of the label {key:?} has the character =, which ends the key in ?label=key=value");
        return Err(Problem::malformed(detail, "write the key without it").at("/labels"));
    }
    if labels.iter().any(|(key, value)| key.contains('\0') || value.contains('\0')) {
        let detail = "a label has the character U+0000";
        return Err(Problem::malformed(detail, "write the labels without it").at("/labels"));
    }
    let bytes: usize = labels.iter().map(|(key, value)| key.len() + value.len()).sum();
    if bytes > MAX_LABEL_BYTES {
        let detail = format!("the labels have {bytes} bytes");
        return Err(Problem::malformed(detail, format!("use at most {MAX_LABEL_BYTES} bytes")).at("/labels"));
    }
    if !(-MAX_PRIORITY..=MAX_PRIORITY).contains(&priority) {
        let remedy = format!("use -{MAX_PRIORITY} to {MAX_PRIORITY}");
        return Err(Problem::malformed(format!("priority is {priority}"), remedy).at("/priority"));
    }
    Ok(())
}

/// The header `Idempotency-Key`.
fn idempotency_key(headers: &HeaderMap) -> Result<Option<String>, Problem> {
    let Some(key) = headers.get("idempotency-key") else { return Ok(None) };
    let key =
        key.to_str().ok().filter(|key| (1..=MAX_LABEL_CHARS).contains(&key.len())).ok_or_else(|| {
            Problem::malformed("the Idempotency-Key is empty, too long or not ASCII", "use a new UUID")
        })?;
    Ok(Some(key.to_owned()))
}

impl From<EnqueueError> for Problem {
    fn from(error: EnqueueError) -> Self {
        match error {
            EnqueueError::SessionMissing => session_missing(),
            EnqueueError::KeyReused => Self::new(
                StatusCode::UNPROCESSABLE_ENTITY,
                "idempotency_key_reused",
                "the Idempotency-Key was used for another request",
                "use a new key for each new request",
            ),
            EnqueueError::JobDeleted => Self::new(
                StatusCode::CONFLICT,
                "job_deleted",
                "the job of this Idempotency-Key was deleted",
                "use a new key to run it again",
            ),
            EnqueueError::Full { .. } | EnqueueError::TenantFull { .. } => {
                Self::new(StatusCode::TOO_MANY_REQUESTS, "queue_full", error.to_string(), "try again later")
                    .with_header(header::RETRY_AFTER, HeaderValue::from_static("60"))
            }
            EnqueueError::QuotaExceeded { stored, max } => AddError::QuotaExceeded { stored, max }.into(),
            EnqueueError::Store(error) => error.into(),
        }
    }
}
