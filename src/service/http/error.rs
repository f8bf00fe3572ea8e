//! Problem documents (RFC 9457): every error a client can meet.

use crate::service::failpoint::fault;
use crate::service::store::StoreError;
use crate::service::store::sessions::AddError;
use axum::body::Body;
use axum::extract::Request;
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use serde::Serialize;

/// An error as the client sees it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Problem {
    document: Box<Document>,
    headers: Vec<(HeaderName, HeaderValue)>,
}

/// The body. `instance` is the request's path; of an internal error an id that stands in the log.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Document {
    /// `about:blank`: the code says more than a page would.
    #[serde(rename = "type")]
    kind: &'static str,
    title: &'static str,
    #[serde(serialize_with = "status_as_number")]
    status: StatusCode,
    detail: String,
    instance: String,
    code: &'static str,
    #[serde(flatten)]
    place: Place,
    remedy: String,
}

fn status_as_number<S: serde::Serializer>(status: &StatusCode, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_u16(status.as_u16())
}

/// Where in the request or the upload the fault lies.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub(super) struct Place {
    /// Member of the upload.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) file: Option<String>,
    /// Camera id.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) camera: Option<String>,
    /// Frame, in the session's numbers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) frame: Option<i64>,
    /// Position of the person in the frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) person: Option<usize>,
    /// JSON pointer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) pointer: Option<String>,
}

impl Problem {
    /// A problem: what went wrong, for machines and for people, and what to do.
    pub(super) fn new(
        status: StatusCode,
        code: &'static str,
        detail: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        let document = Document {
            kind: "about:blank",
            title: status.canonical_reason().unwrap_or("Error"),
            status,
            detail: detail.into(),
            instance: String::new(),
            code,
            place: Place::default(),
            remedy: remedy.into(),
        };
        Self { document: Box::new(document), headers: Vec::new() }
    }

    /// For machines.
    pub(super) fn code(&self) -> &'static str {
        self.document.code
    }

    /// For people.
    pub(super) fn detail(&self) -> &str {
        &self.document.detail
    }

    /// The same, naming a place in the request's JSON.
    pub(super) fn at(mut self, pointer: impl Into<String>) -> Self {
        self.document.place.pointer = Some(pointer.into());
        self
    }

    /// The same, naming a place in an upload.
    pub(super) fn in_upload(mut self, place: Place) -> Self {
        self.document.place = place;
        self
    }

    /// The same with a header.
    pub(super) fn with_header(mut self, name: HeaderName, value: HeaderValue) -> Self {
        self.headers.push((name, value));
        self
    }

    /// 400.
    pub(super) fn malformed(detail: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, "malformed", detail, remedy)
    }

    /// 404 for a thing of a kind.
    pub(super) fn not_found(kind: &str) -> Self {
        Self::new(
            StatusCode::NOT_FOUND,
            "not_found",
            format!("there is no such {kind}"),
            format!("list what there is with GET /v1/{kind}s"),
        )
    }

    /// 415, naming what is taken.
    pub(super) fn unsupported_media_type(accepted: &str) -> Self {
        Self::new(
            StatusCode::UNSUPPORTED_MEDIA_TYPE,
            "unsupported_media_type",
            "the body is of no kind that this route takes",
            format!("set Content-Type to {accepted}"),
        )
    }

    /// 413.
    pub(super) fn too_large(limit: u64) -> Self {
        Self::new(
            StatusCode::PAYLOAD_TOO_LARGE,
            "too_large",
            format!("the body is larger than {limit} bytes"),
            "send less: cut the take, or deflate it in a zip",
        )
    }

    /// 500: the cause goes to the log under a fresh id, the client learns the id.
    pub(super) fn internal(error: impl std::fmt::Display) -> Self {
        let incident = uuid::Uuid::new_v4();
        tracing::error!(%incident, %error, "a request failed");
        let mut problem = Self::new(
            StatusCode::INTERNAL_SERVER_ERROR,
            "internal",
            "the service failed",
            "try again; if it stays so, give the operator the instance",
        );
        problem.document.instance = format!("urn:uuid:{incident}");
        problem
    }

    /// 503 with `Retry-After`.
    pub(super) fn unavailable(code: &'static str, detail: impl Into<String>) -> Self {
        Self::new(StatusCode::SERVICE_UNAVAILABLE, code, detail, "try again in a few seconds")
            .with_header(header::RETRY_AFTER, HeaderValue::from_static("5"))
    }

    /// 507.
    pub(super) fn disk_full() -> Self {
        Self::new(
            StatusCode::INSUFFICIENT_STORAGE,
            "disk_full",
            "the service's disk is full",
            "delete jobs and sessions that nobody needs, or ask the operator",
        )
    }

    /// What a failed file operation means to the client.
    pub(super) fn from_io(error: &std::io::Error) -> Self {
        match error.kind() {
            std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded if !fault("disk.unnamed") => {
                Self::disk_full()
            }
            _ => Self::internal(error),
        }
    }
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        match &error {
            StoreError::Database(sqlx::Error::PoolTimedOut) => Self::unavailable("busy", "the database is busy"),
            StoreError::Database(sqlx::Error::Database(cause)) => match cause.code().as_deref() {
                Some("5" | "6" | "261" | "517") => Self::unavailable("busy", "the database is busy"), // BUSY, LOCKED
                _ if error.is_disk_full() => Self::disk_full(),
                _ => Self::internal(error),
            },
            _ => Self::internal(error),
        }
    }
}

impl From<AddError> for Problem {
    fn from(error: AddError) -> Self {
        match error {
            AddError::QuotaExceeded { .. } => Self::new(
                StatusCode::INSUFFICIENT_STORAGE,
                "quota_exceeded",
                error.to_string(),
                "delete sessions and jobs that nobody needs, or ask the operator for more",
            ),
            AddError::Store(error) => error.into(),
        }
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let mut response = self.document.status.into_response();
        response.extensions_mut().insert(self); // written by `write_problems`, which knows the request
        response
    }
}

/// Writes the problem document of a failed request.
pub(super) async fn write_problems(request: Request, next: Next) -> Response {
    let path = request.uri().path().to_owned();
    let mut response = next.run(request).await;
    let Some(mut problem) = response.extensions_mut().get::<Problem>().cloned() else { return response };
    if problem.document.instance.is_empty() {
        problem.document.instance = path;
    }
    let headers = response.headers_mut();
    headers.remove(header::CONTENT_LENGTH);
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/problem+json"));
    for (name, value) in std::mem::take(&mut problem.headers) {
        headers.insert(name, value);
    }
    let body = serde_json::to_vec(&problem.document).expect("a problem is strings and numbers, which always serialise");
    *response.body_mut() = Body::from(body);
    response
}
