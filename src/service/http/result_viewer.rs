//! The viewer on a result folder, without a service: `/`, its assets, and the few read-only routes that the page of a job uses.
//!
//! The folder is shown as the only job of the only session. Files are looked up in the manifest, so that no request can name
//! another file. Only requests to loopback names are answered, as by a service without keys.

use super::error::{self, Problem};
use super::origin::is_loopback_name;
use super::viewer;
use axum::body::Body;
use axum::extract::{Path as UrlPath, Request, State};
use axum::http::{StatusCode, header};
use axum::middleware::{Next, from_fn};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};
use tokio::net::TcpListener;
use tokio_util::io::ReaderStream;

/// Id of the folder as a job.
pub const JOB: &str = "job_00000000000000000000000000000000";
/// Id of the session of that job.
const SESSION: &str = "session_00000000000000000000000000000000";

/// A result folder as the viewer's page sees it.
#[derive(Debug)]
pub struct ResultFolder {
    root: PathBuf,
    /// Media types by file name.
    files: BTreeMap<String, String>,
    job: Value,
    session: Value,
}

/// Reason why a folder cannot be shown.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {reason}; give the folder that `reconstruct --out` or `submit --out` has written")]
pub struct NotAResult {
    path: String,
    reason: String,
}

/// The fields of `manifest.json` that the page needs.
#[derive(Deserialize)]
struct Manifest {
    input: Input,
    options: Value,
    solver_version: String,
    publish: Publish,
    files: Vec<FileEntry>,
}

#[derive(Deserialize)]
struct Input {
    name: String,
    sha256: String,
}

#[derive(Deserialize)]
struct Publish {
    frame_range: [i64; 2],
    #[serde(default)]
    people: Vec<Value>,
}

#[derive(Deserialize)]
struct FileEntry {
    name: String,
    media_type: String,
}

impl ResultFolder {
    /// Opens a result folder.
    ///
    /// # Errors
    /// [`NotAResult`] if `manifest.json`, `report.json` or `cameras.json` is missing or damaged.
    pub fn open(root: &Path) -> Result<Self, NotAResult> {
        let manifest_value = read_json(root, "manifest.json")?;
        let manifest: Manifest =
            serde_json::from_value(manifest_value).map_err(|error| not_a_result(root, "manifest.json", &error))?;
        let mut report = read_json(root, "report.json")?;
        let cameras = read_json(root, "cameras.json")?;
        let facts = |camera: &Value| json!({ "id": camera["id"], "has_extrinsics": false, "has_intrinsics": true });
        let facts: Vec<Value> = cameras["cameras"].as_array().into_iter().flatten().map(facts).collect();
        let time = rfc3339(root.join("manifest.json").metadata().and_then(|meta| meta.modified()).ok());
        let Input { name, sha256 } = manifest.input;
        let name = if name.is_empty() { root.display().to_string() } else { name };
        let [first, last] = manifest.publish.frame_range;
        let session = json!({
            "id": SESSION, "name": name, "sha256": sha256, "cameras": facts.len(), "frames": last - first + 1,
            "people_max": manifest.publish.people.len(), "keypoint_convention": "", "format": "result folder",
            "warnings": [], "bytes": 0, "camera_facts": facts, "created_at": time,
        });
        let job = json!({
            "id": JOB, "state": "succeeded", "session": SESSION, "options": manifest.options, "labels": {}, "priority": 0,
            "created_at": time, "started_at": time, "finished_at": time, "attempt": 1,
            "progress": { "stage": "", "stage_index": 0, "stage_count": 0, "fraction": 1.0, "message": "", "eta_s": null },
            "stage_seconds": {}, "quality": report["quality"].take(), "suspicions": report["suspicions"].as_array().cloned().unwrap_or_default(),
            "error": null, "solver_version": manifest.solver_version, "links": {},
        });
        let own = ("manifest.json".to_owned(), "application/json".to_owned());
        let files = manifest.files.into_iter().map(|file| (file.name, file.media_type)).chain([own]).collect();
        Ok(Self { root: root.to_owned(), files, job, session })
    }

    /// Serves the folder on a listener of the loopback until `stop` ends.
    ///
    /// # Errors
    /// The error of the listener.
    pub async fn serve(self, listener: TcpListener, stop: impl Future<Output = ()> + Send + 'static) -> io::Result<()> {
        axum::serve(listener, router(Arc::new(self))).with_graceful_shutdown(stop).await
    }
}

/// Whether the program contains the viewer's page.
pub fn has_page() -> bool {
    viewer::has_page()
}

fn read_json(root: &Path, name: &str) -> Result<Value, NotAResult> {
    let bytes = std::fs::read(root.join(name)).map_err(|error| not_a_result(root, name, &error))?;
    serde_json::from_slice(&bytes).map_err(|error| not_a_result(root, name, &error))
}

fn not_a_result(root: &Path, name: &str, error: &dyn std::fmt::Display) -> NotAResult {
    NotAResult { path: root.join(name).display().to_string(), reason: error.to_string() }
}

fn router(folder: Arc<ResultFolder>) -> Router {
    type Shown = State<Arc<ResultFolder>>;
    let file = |name: &'static str| get(move |State(folder): Shown| async move { folder.file(name).await });
    Router::new()
        .route("/v1/jobs", get(async |State(folder): Shown| page("jobs", &folder.job)))
        .route("/v1/sessions", get(async |State(folder): Shown| page("sessions", &folder.session)))
        .route("/v1/sessions/{id}", get(async |State(folder): Shown| Json(folder.session.clone())))
        .route("/v1/jobs/{id}", get(async |State(folder): Shown| Json(folder.job.clone())))
        .route("/v1/jobs/{id}/events", get(async |State(folder): Shown| folder.events()))
        .route("/v1/jobs/{id}/result", file("manifest.json"))
        .route("/v1/jobs/{id}/cameras", file("cameras.json"))
        .route("/v1/jobs/{id}/people", file("people.json"))
        .route("/v1/jobs/{id}/report", file("report.json"))
        .route("/v1/jobs/{id}/artifacts/{*name}", get(artifact))
        .merge(viewer::routes())
        .fallback(async || read_only(StatusCode::NOT_FOUND, "not_found"))
        .method_not_allowed_fallback(async || read_only(StatusCode::METHOD_NOT_ALLOWED, "read_only"))
        .layer(from_fn(require_loopback_name))
        .layer(from_fn(error::write_problems))
        .with_state(folder)
}

fn page(items: &str, item: &Value) -> Json<Value> {
    Json(json!({ items: [item], "next_page_token": null }))
}

async fn artifact(
    State(folder): State<Arc<ResultFolder>>,
    UrlPath((_, name)): UrlPath<(String, String)>,
) -> Result<Response, Problem> {
    folder.file(&name).await
}

impl ResultFolder {
    /// The job's state as the only event.
    fn events(&self) -> impl IntoResponse + use<> {
        let event = format!("event: state\nid: 1\ndata: {}\n\n", self.job);
        ([(header::CONTENT_TYPE, "text/event-stream")], event)
    }

    /// A file of the manifest.
    async fn file(&self, name: &str) -> Result<Response, Problem> {
        let missing = || {
            let remedy = "GET /v1/jobs/{id}/result lists all files";
            Problem::new(StatusCode::NOT_FOUND, "not_found", "the result does not contain this file", remedy)
        };
        let media_type = self.files.get(name).ok_or_else(missing)?;
        let file = tokio::fs::File::open(self.root.join(name)).await.map_err(|_| missing())?;
        let body = Body::from_stream(ReaderStream::with_capacity(file, 64 << 10));
        Ok(([(header::CONTENT_TYPE, media_type.as_str()), (header::CACHE_CONTROL, "no-cache")], body).into_response())
    }
}

fn read_only(status: StatusCode, code: &'static str) -> Problem {
    let remedy = "start `wandless serve` to upload and solve sessions";
    Problem::new(status, code, "this viewer shows one result folder and changes nothing", remedy)
}

/// Refuses other hosts than the loopback: a page of another site could otherwise read the result under its own name.
async fn require_loopback_name(request: Request, next: Next) -> Result<Response, Problem> {
    let host = request.headers().get(header::HOST).and_then(|host| host.to_str().ok()).unwrap_or_default();
    if is_loopback_name(host) {
        return Ok(next.run(request).await);
    }
    let detail = format!("the viewer does not answer requests to the host {host:?}");
    Err(Problem::new(StatusCode::FORBIDDEN, "unknown_host", detail, "use http://127.0.0.1"))
}

/// A time as RFC 3339 in UTC; the epoch where it is unknown.
fn rfc3339(time: Option<SystemTime>) -> String {
    let since = time.and_then(|time| time.duration_since(UNIX_EPOCH).ok()).unwrap_or_default().as_secs() as i64;
    let (days, seconds) = (since.div_euclid(86_400), since.rem_euclid(86_400));
    // Days since 0000-03-01 in eras of 400 years, whose years begin in March, so that leap days are the last of a year.
    let z = days + 719_468;
    let (era, day_of_era) = (z.div_euclid(146_097), z.rem_euclid(146_097));
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    let year = era * 400 + year_of_era + i64::from(month <= 2);
    let (hour, minute, second) = (seconds / 3600, seconds / 60 % 60, seconds % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}Z")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;
    use tower::ServiceExt;

    fn folder() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let manifest = json!({
            "input": { "name": "take", "sha256": "00" }, "options": {}, "solver_version": "0.1.0",
            "publish": { "frame_range": [5, 14] }, "files": [{ "name": "cameras.json", "media_type": "application/json" }],
        });
        let write = |name: &str, value: Value| std::fs::write(folder.path().join(name), value.to_string()).unwrap();
        write("manifest.json", manifest);
        write(
            "report.json",
            json!({ "quality": { "verdict": "pass", "reasons": [] }, "suspicions": [{ "code": "rotated" }] }),
        );
        write("cameras.json", json!({ "cameras": [{ "id": "a" }] }));
        write("secret.json", json!("secret"));
        folder
    }

    async fn answer(method: &str, path: &str, host: &str) -> (StatusCode, Value) {
        let folder = folder();
        let router = router(Arc::new(ResultFolder::open(folder.path()).unwrap()));
        let request = Request::builder().method(method).uri(path).header("host", host).body(Body::empty()).unwrap();
        let response = router.oneshot(request).await.unwrap();
        let status = response.status();
        let bytes = axum::body::to_bytes(response.into_body(), 1 << 20).await.unwrap();
        (status, serde_json::from_slice(&bytes).unwrap_or_default())
    }

    #[tokio::test]
    async fn folder_is_the_only_job() {
        let (status, job) = answer("GET", &format!("/v1/jobs/{JOB}"), "127.0.0.1:9").await;
        assert_eq!(
            (status, &job["state"], &job["quality"]["verdict"]),
            (StatusCode::OK, &json!("succeeded"), &json!("pass"))
        );
        assert_eq!(job["suspicions"][0]["code"], "rotated");
        let (_, sessions) = answer("GET", "/v1/sessions", "localhost").await;
        assert_eq!(
            (&sessions["sessions"][0]["frames"], &sessions["sessions"][0]["camera_facts"][0]["id"]),
            (&json!(10), &json!("a"))
        );
    }

    #[tokio::test]
    async fn only_files_of_the_manifest_are_sent() {
        let path = |name: &str| format!("/v1/jobs/{JOB}/artifacts/{name}");
        assert_eq!(answer("GET", &path("cameras.json"), "127.0.0.1").await.0, StatusCode::OK);
        for name in ["secret.json", "../secret.json", "%2e%2e/secret.json", "/etc/hostname"] {
            assert_eq!(answer("GET", &path(name), "127.0.0.1").await.0, StatusCode::NOT_FOUND, "{name}");
        }
    }

    #[tokio::test]
    async fn changes_and_other_hosts_are_refused() {
        let (status, problem) = answer("POST", "/v1/sessions", "127.0.0.1").await;
        assert_eq!((status, &problem["code"]), (StatusCode::METHOD_NOT_ALLOWED, &json!("read_only")));
        let (status, problem) = answer("GET", "/v1/jobs", "evil.example").await;
        assert_eq!((status, &problem["code"]), (StatusCode::FORBIDDEN, &json!("unknown_host")));
    }

    #[test]
    fn folder_without_manifest_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let error = ResultFolder::open(folder.path()).unwrap_err().to_string();
        assert!(error.contains("manifest.json") && error.contains("--out"), "{error}");
    }

    #[test]
    fn times_have_the_form_of_rfc_3339() {
        let at = |seconds| rfc3339(Some(UNIX_EPOCH + Duration::from_secs(seconds)));
        assert_eq!(at(0), "1970-01-01T00:00:00Z");
        assert_eq!(at(951_782_400), "2000-02-29T00:00:00Z");
        assert_eq!(at(1_767_225_599), "2025-12-31T23:59:59Z");
    }
}
