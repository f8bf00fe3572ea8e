//! Problem documents (RFC 9457): the form of every error answer.

use crate::service::failpoint::fault;
use crate::service::store::StoreError;
use crate::service::store::sessions::AddError;
use crate::session::upload::UploadError;
use axum::body::Body;
use axum::extract::Request;
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

/// An error as the client sees it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Problem {
    document: Box<Document>,
    headers: Vec<(HeaderName, HeaderValue)>,
}

/// Detail of a failed write for want of space.
const DISK_FULL: &str = "the disk of the service is full";

/// Description of an error (RFC 9457).
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = Problem)]
pub(super) struct Document {
    /// Always `about:blank`; `code` identifies the error.
    #[serde(rename = "type")]
    kind: &'static str,
    /// Name of the status.
    title: &'static str,
    #[serde(serialize_with = "status_as_number")]
    #[schema(value_type = u16, minimum = 400, maximum = 599)]
    status: StatusCode,
    /// What is wrong.
    detail: String,
    /// Path of the request; for an internal error an id that the log of the service contains.
    instance: String,
    /// Identifies the kind of error.
    code: &'static str,
    /// File inside the upload.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    file: Option<String>,
    /// Id of the camera.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    camera: Option<String>,
    /// Frame number of the session.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    frame: Option<i64>,
    /// Index of the person in the frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    person: Option<usize>,
    /// JSON pointer to the erroneous value.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pointer: Option<String>,
    /// What to do.
    remedy: String,
}

fn status_as_number<S: serde::Serializer>(status: &StatusCode, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_u16(status.as_u16())
}

impl Problem {
    /// A problem with its status, its code, what is wrong, and what to do.
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
            file: None,
            camera: None,
            frame: None,
            person: None,
            pointer: None,
            remedy: remedy.into(),
        };
        Self { document: Box::new(document), headers: Vec::new() }
    }

    /// Identifies the kind of error.
    pub(super) fn code(&self) -> &'static str {
        self.document.code
    }

    /// What is wrong.
    pub(super) fn detail(&self) -> &str {
        &self.document.detail
    }

    /// Adds the JSON pointer to the erroneous value.
    pub(super) fn at(mut self, pointer: impl Into<String>) -> Self {
        self.document.pointer = Some(pointer.into());
        self
    }

    /// A rejected upload, with the location of the error.
    pub(super) fn of_upload(status: StatusCode, error: UploadError) -> Self {
        let UploadError { code, detail, remedy, file, camera, frame, person, pointer, .. } = error;
        let mut problem = Self::new(status, code, detail, remedy);
        *problem.document = Document { file, camera, frame, person, pointer, ..*problem.document };
        problem
    }

    /// Adds a header to the answer.
    pub(super) fn with_header(mut self, name: HeaderName, value: HeaderValue) -> Self {
        self.headers.push((name, value));
        self
    }

    /// 400.
    pub(super) fn malformed(detail: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, "malformed", detail, remedy)
    }

    /// 404 for a resource; `kind` is "job" or "session".
    pub(super) fn not_found(kind: &str) -> Self {
        Self::new(
            StatusCode::NOT_FOUND,
            "not_found",
            format!("the {kind} does not exist"),
            format!("list the existing ones with GET /v1/{kind}s"),
        )
    }

    /// 415 with the accepted media types.
    pub(super) fn unsupported_media_type(accepted: &str) -> Self {
        Self::new(
            StatusCode::UNSUPPORTED_MEDIA_TYPE,
            "unsupported_media_type",
            "this route does not accept the media type of the body",
            format!("set Content-Type to {accepted}"),
        )
    }

    /// 413.
    pub(super) fn too_large(limit: u64) -> Self {
        Self::new(
            StatusCode::PAYLOAD_TOO_LARGE,
            "too_large",
            format!("the body is larger than {limit} bytes"),
            "send less: shorten the recording, or compress it in a zip file",
        )
    }

    /// 500: the cause is logged under a new id, which the client receives as the instance.
    pub(super) fn internal(error: impl std::fmt::Display) -> Self {
        let incident = uuid::Uuid::new_v4();
        tracing::error!(%incident, %error, "a request failed");
        let mut problem = Self::new(
            StatusCode::INTERNAL_SERVER_ERROR,
            "internal",
            "the service failed",
            "try again; if the error persists, report the instance to the operator",
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
    pub(super) fn disk_full(detail: impl Into<String>) -> Self {
        if fault("disk.unnamed") {
            return Self::internal(detail.into());
        }
        Self::new(
            StatusCode::INSUFFICIENT_STORAGE,
            "disk_full",
            detail,
            "delete jobs and sessions that are not needed, or ask the operator",
        )
    }

    /// 507 for a full disk, 500 for any other failed file operation.
    pub(super) fn from_io(error: &std::io::Error) -> Self {
        match error.kind() {
            std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded => Self::disk_full(DISK_FULL),
            _ => Self::internal(error),
        }
    }
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        match &error {
            _ if error.is_busy() => Self::unavailable("busy", "the database is busy"),
            StoreError::Database(_) if error.is_disk_full() => Self::disk_full(DISK_FULL),
            // Another request has just stored the same; a repetition finds it.
            StoreError::Database(sqlx::Error::Database(cause)) if cause.is_unique_violation() => {
                Self::unavailable("busy", "another request is storing the same")
            }
            StoreError::Blobs { .. } => {
                tracing::error!(%error, "a request failed");
                Self::unavailable("storage", "the store of the uploads and results does not answer")
            }
            StoreError::Folder { source, .. } => Self::from_io(source),
            StoreError::DiskFull { .. } => Self::disk_full(error.to_string()),
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
                "delete sessions and jobs that are not needed, or ask the operator for more",
            ),
            AddError::NameTooLong { .. } => {
                Self::new(StatusCode::UNPROCESSABLE_ENTITY, "name_too_long", error.to_string(), "shorten the name")
                    .at("/name")
            }
            AddError::NameUnstorable => Self::malformed(error.to_string(), "write the name without it").at("/name"),
            AddError::Store(error) => error.into(),
        }
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let mut response = self.document.status.into_response();
        response.extensions_mut().insert(self); // `write_problems` adds the body
        response
    }
}

/// Middleware: writes the problem document into the answer of a failed request.
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
