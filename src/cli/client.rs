//! Blocking HTTP client of `submit`, `demo` and `mcp`.

use super::bad_input::BadInput;
use crate::pipeline::CameraFacts;
use crate::service::store::artifacts::{FileDigest, digest_file};
use anyhow::{Context, bail};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::fs::File;
use std::io::{Read, Seek, Write};
use std::path::Path;
use std::time::{Duration, Instant};
use ureq::http::{Response, StatusCode, header};
use ureq::typestate::{WithBody, WithoutBody};
use ureq::{Agent, Body, RequestBuilder};

/// Seconds for which the service may hold one request for the state of a job (long polling).
pub(super) const WAIT_S: u64 = 30;

/// Time for which a service that does not answer is asked again.
const RETRY_TIME: Duration = Duration::from_secs(60);

/// Shortest time between two tries.
const PAUSE: Duration = Duration::from_secs(1);

/// Address of a service, the connections to it and the key.
pub(super) struct Client {
    agent: Agent,
    /// URL without user information and final slash.
    server: String,
    /// Value of the header `Authorization`.
    authorization: Option<String>,
}

/// The fields of a session that the client needs.
#[derive(Debug, Deserialize)]
pub(super) struct SessionAnswer {
    pub(super) id: String,
    #[serde(default)]
    pub(super) warnings: Vec<String>,
    #[serde(default)]
    pub(super) camera_facts: Vec<CameraFacts>,
}

/// The fields of a job that the client needs.
#[derive(Debug, Deserialize)]
pub(super) struct JobAnswer {
    pub(super) id: String,
    pub(super) state: String,
    pub(super) progress: ProgressAnswer,
    pub(super) error: Option<ProblemAnswer>,
}

impl JobAnswer {
    /// Whether the job has ended.
    pub(super) fn is_final(&self) -> bool {
        matches!(self.state.as_str(), "succeeded" | "failed" | "canceled" | "dead")
    }
}

#[derive(Debug, Deserialize)]
pub(super) struct ProgressAnswer {
    pub(super) stage: String,
    pub(super) fraction: f64,
    pub(super) message: String,
}

/// A problem document, or the error of a failed job.
#[derive(Debug, Deserialize)]
pub(super) struct ProblemAnswer {
    code: String,
    detail: String,
    #[serde(default)]
    remedy: String,
    file: Option<String>,
    camera: Option<String>,
    frame: Option<i64>,
}

impl std::fmt::Display for ProblemAnswer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut place = Vec::new();
        place.extend(self.file.as_ref().map(|file| format!("file {file:?}")));
        place.extend(self.camera.as_ref().map(|camera| format!("camera {camera:?}")));
        place.extend(self.frame.map(|frame| format!("frame {frame}")));
        let place = if place.is_empty() { String::new() } else { format!("{}: ", place.join(", ")) };
        write!(f, "{place}{} ({})", self.detail, self.code)?;
        if self.remedy.is_empty() { Ok(()) } else { write!(f, "; {}", self.remedy) }
    }
}

/// List of the files of a result.
#[derive(Debug, Deserialize)]
pub(super) struct Manifest {
    pub(super) files: Vec<ManifestFile>,
}

#[derive(Debug, Deserialize)]
pub(super) struct ManifestFile {
    pub(super) name: String,
    pub(super) sha256: String,
}

impl Client {
    /// Client of the service at `server` (`http://host:port`). Without a `key`, the password in the URL is the key.
    pub(super) fn new(server: &str, key: Option<&str>) -> Self {
        let (server, password) = without_userinfo(server);
        let key = key.filter(|key| !key.trim().is_empty()).map(str::to_owned).or(password);
        let config = Agent::config_builder()
            .http_status_as_error(false) // the client reads problem documents
            .timeout_connect(Some(Duration::from_secs(10)))
            .timeout_recv_response(Some(Duration::from_secs(WAIT_S + 300))) // the service validates a large upload before it answers
            .build();
        let authorization = key.map(|key| format!("Bearer {}", key.trim()));
        Self { agent: Agent::new_with_config(config), server: server.trim_end_matches('/').to_owned(), authorization }
    }

    /// URL of the service, without user information.
    pub(super) fn server(&self) -> &str {
        &self.server
    }

    /// What stands before the cause where no answer arrives.
    fn unanswered(&self) -> String {
        format!("{} does not answer; check --server and that `wandless serve` runs there", self.server)
    }

    fn get(&self, path: &str) -> RequestBuilder<WithoutBody> {
        self.with_key(self.agent.get(format!("{}{path}", self.server)))
    }

    fn post(&self, path: &str) -> RequestBuilder<WithBody> {
        self.with_key(self.agent.post(format!("{}{path}", self.server)))
    }

    fn with_key<B>(&self, request: RequestBuilder<B>) -> RequestBuilder<B> {
        match &self.authorization {
            Some(authorization) => request.header(header::AUTHORIZATION, authorization),
            None => request,
        }
    }

    /// Uploads a session; again for up to [`RETRY_TIME`] where the service is there but busy.
    pub(super) fn upload(&self, session: &File, media_type: &str) -> anyhow::Result<SessionAnswer> {
        let bytes = session.metadata()?.len().to_string();
        let send = || {
            let mut file = session;
            file.rewind()?;
            let request = self.post("/v1/sessions").header(header::CONTENT_LENGTH, &bytes);
            request.content_type(media_type).send(file)
        };
        match send().with_context(|| self.unanswered())? {
            busy if is_busy(busy.status()) => self.with_retries(send),
            answer => self.document(answer),
        }
    }

    /// Creates a job. The idempotency key makes repeated requests create one job only.
    pub(super) fn create_job(&self, session: &str, options: &serde_json::Value) -> anyhow::Result<JobAnswer> {
        self.create_job_of(&serde_json::json!({ "session": session, "options": options }))
    }

    /// Creates the job that a document describes.
    pub(super) fn create_job_of(&self, job: &serde_json::Value) -> anyhow::Result<JobAnswer> {
        let key = uuid::Uuid::new_v4().to_string();
        self.with_retries(|| {
            let request = self.post("/v1/jobs").header("idempotency-key", &key);
            request.send_json(job)
        })
    }

    /// Waits until the job has changed or `wait_s` seconds have passed, at most [`WAIT_S`], and returns it.
    pub(super) fn wait_for_job(&self, id: &str, wait_s: u64) -> anyhow::Result<JobAnswer> {
        self.with_retries(|| self.get(&format!("/v1/jobs/{id}?wait={wait_s}")).call())
    }

    /// The document at a path of the API.
    pub(super) fn document_at<T: DeserializeOwned>(&self, path: &str) -> anyhow::Result<T> {
        self.with_retries(|| self.get(path).call())
    }

    /// The answer to a document that is sent to a path of the API.
    pub(super) fn send_document<T: DeserializeOwned>(&self, path: &str, body: &serde_json::Value) -> anyhow::Result<T> {
        self.document(self.post(path).send_json(body).with_context(|| self.unanswered())?)
    }

    /// List of the files of a result.
    pub(super) fn manifest(&self, job: &str) -> anyhow::Result<Manifest> {
        self.with_retries(|| self.get(&format!("/v1/jobs/{job}/result")).call())
    }

    /// One of the JSON files of a result that have a route of their own: `report`, `cameras`, `people`.
    pub(super) fn result_file(&self, job: &str, name: &str) -> anyhow::Result<serde_json::Value> {
        self.with_retries(|| self.get(&format!("/v1/jobs/{job}/{name}")).call())
    }

    /// Downloads one file of a result and checks its digest; a transfer that broke off is repeated for up to [`RETRY_TIME`].
    pub(super) fn download(&self, job: &str, name: &str, sha256: Option<&str>, to: &Path) -> anyhow::Result<()> {
        let path = format!("/v1/jobs/{job}/artifacts/{}", percent_encoded(name));
        let deadline = Instant::now() + RETRY_TIME;
        loop {
            let response = self.expect_success(self.answered(|| self.get(&path).call())?)?;
            let error = match received(response, sha256, to).with_context(|| to.display().to_string())? {
                Received::Whole => return Ok(()),
                Received::Broken(error) => error,
            };
            if Instant::now() >= deadline {
                bail!("{name}: {error}");
            }
            tracing::warn!(name, error, "the download broke off; trying again");
            std::thread::sleep(PAUSE);
        }
    }

    /// The document that a request is answered with, see [`Self::answered`].
    fn with_retries<T: DeserializeOwned>(
        &self,
        ask: impl Fn() -> Result<Response<Body>, ureq::Error>,
    ) -> anyhow::Result<T> {
        self.document(self.answered(ask)?)
    }

    /// Repeats a request for up to [`RETRY_TIME`] while the service is unavailable or asks for patience.
    fn answered(&self, ask: impl Fn() -> Result<Response<Body>, ureq::Error>) -> anyhow::Result<Response<Body>> {
        let deadline = Instant::now() + RETRY_TIME;
        loop {
            let pause = match ask() {
                Ok(response) if is_busy(response.status()) && Instant::now() < deadline => retry_after(&response),
                Ok(response) => return Ok(response),
                Err(error) if Instant::now() >= deadline => return Err(error).with_context(|| self.unanswered()),
                Err(error) => {
                    tracing::warn!(%error, "the service does not answer; trying again");
                    PAUSE
                }
            };
            std::thread::sleep(pause.min(deadline.saturating_duration_since(Instant::now())).max(PAUSE));
        }
    }

    fn document<T: DeserializeOwned>(&self, response: Response<Body>) -> anyhow::Result<T> {
        let mut response = self.expect_success(response)?;
        Ok(response.body_mut().with_config().limit(64 << 20).read_json()?)
    }

    fn expect_success(&self, mut response: Response<Body>) -> anyhow::Result<Response<Body>> {
        let status = response.status();
        if status.is_success() {
            return Ok(response);
        }
        let problem = response.body_mut().read_json::<ProblemAnswer>();
        let text = problem.map_or_else(|_| format!("{} answered {status}", self.server), |problem| problem.to_string());
        match status {
            StatusCode::BAD_REQUEST
            | StatusCode::PAYLOAD_TOO_LARGE
            | StatusCode::UNSUPPORTED_MEDIA_TYPE
            | StatusCode::UNPROCESSABLE_ENTITY => Err(BadInput(text).into()),
            _ => bail!(text),
        }
    }
}

/// Whether the same request can succeed later.
fn is_busy(status: StatusCode) -> bool {
    matches!(status, StatusCode::SERVICE_UNAVAILABLE | StatusCode::TOO_MANY_REQUESTS)
}

/// The time in `Retry-After`.
fn retry_after(response: &Response<Body>) -> Duration {
    let seconds = response.headers().get(header::RETRY_AFTER).and_then(|value| value.to_str().ok()?.parse().ok());
    seconds.map_or(PAUSE, Duration::from_secs)
}

/// End of a download.
enum Received {
    Whole,
    /// The transfer broke off, or its bytes have another digest.
    Broken(String),
}

/// Writes the body of an answer to a file and compares its digest with `sha256`, or with the ETag.
///
/// # Errors
/// When the file cannot be written.
fn received(mut response: Response<Body>, sha256: Option<&str>, to: &Path) -> std::io::Result<Received> {
    let etag = response.headers().get(header::ETAG).and_then(|tag| tag.to_str().ok()).map(str::to_owned);
    let (mut body, mut file) = (response.body_mut().as_reader(), File::create(to)?);
    let mut buffer = vec![0; 1 << 16];
    loop {
        match body.read(&mut buffer) {
            Ok(0) => break,
            Ok(n) => file.write_all(&buffer[..n])?,
            Err(error) => return Ok(Received::Broken(error.to_string())),
        }
    }
    let FileDigest { sha256: found, .. } = digest_file(to)?;
    // A proxy that compresses answers makes the tag weak.
    let tag = etag.as_deref().map(|tag| tag.trim_start_matches("W/").trim_matches('"'));
    Ok(match sha256.or(tag).is_none_or(|sha256| sha256 == found) {
        true => Received::Whole,
        false => Received::Broken("the downloaded file does not match its digest".to_owned()),
    })
}

/// Percent-encodes a file name by RFC 3986; slashes are kept.
fn percent_encoded(name: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"/-._~".contains(&byte);
    name.bytes().map(|b| if plain(b) { char::from(b).to_string() } else { format!("%{b:02X}") }).collect()
}

/// Reads the URL of a service from the command line.
pub(super) fn server_url(text: &str) -> Result<String, String> {
    let has_scheme = ["http://", "https://"].iter().any(|scheme| text.starts_with(scheme));
    if has_scheme { Ok(text.to_owned()) } else { Err(format!("write it with its scheme: http://{text}")) }
}

/// Splits a URL into the URL without user information and the password, which must not appear in messages.
pub(super) fn without_userinfo(url: &str) -> (String, Option<String>) {
    let start = url.find("://").map_or(0, |at| at + "://".len());
    let end = url[start..].find(['/', '?', '#']).map_or(url.len(), |at| start + at);
    let Some((userinfo, host)) = url[start..end].rsplit_once('@') else { return (url.to_owned(), None) };
    let password = userinfo.split_once(':').map(|(_, password)| password.to_owned());
    (format!("{}{host}{}", &url[..start], &url[end..]), password)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn user_information_is_split_off() {
        let split = |url: &str| {
            let (url, password) = without_userinfo(url);
            (url, password.unwrap_or_default())
        };
        let of = |url: &str, password: &str| (url.to_owned(), password.to_owned());
        assert_eq!(split("http://127.0.0.1:8700"), of("http://127.0.0.1:8700", ""));
        assert_eq!(split("http://x:wl_a_b@host:8700/base"), of("http://host:8700/base", "wl_a_b"));
        assert_eq!(split("https://wl_a_b@host"), of("https://host", ""));
        assert_eq!(split("x:a@b@host/?q=u:p@c"), of("host/?q=u:p@c", "a@b"));
    }

    /// Answers one connection after the other, each with the given text.
    fn serving(answers: Vec<String>) -> String {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        std::thread::spawn(move || {
            for answer in answers {
                let (mut stream, _) = listener.accept().unwrap();
                assert!(stream.read(&mut [0; 4096]).unwrap() > 0);
                stream.write_all(answer.as_bytes()).unwrap();
            }
        });
        format!("http://{address}")
    }

    #[test]
    fn a_download_that_broke_off_is_repeated() {
        let head = "HTTP/1.1 200 OK\r\nConnection: close\r\n";
        // FIPS 180-2, appendix B.1.
        let tag = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        let server = serving(vec![
            "HTTP/1.1 429 Too Many Requests\r\nRetry-After: 1\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
                .to_owned(),
            format!("{head}ETag: \"{tag}\"\r\nContent-Length: 3\r\n\r\nab"),
            format!("{head}ETag: \"{tag}\"\r\nContent-Length: 3\r\n\r\nabc"),
            "HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\nConnection: close\r\n\r\n".to_owned(),
        ]);
        let folder = tempfile::tempdir().unwrap();
        let (client, file) = (Client::new(&server, None), folder.path().join("people.json"));
        client.download("job_1", "people.json", None, &file).unwrap();
        assert_eq!(std::fs::read(&file).unwrap(), b"abc");
        let missing = client.download("job_1", "people.json", None, &file).unwrap_err();
        assert!(missing.to_string().contains("404"), "{missing}");
    }

    #[test]
    fn an_upload_to_a_busy_service_ended_the_command() {
        let document = r#"{"id": "session_1"}"#;
        let busy =
            "HTTP/1.1 503 Service Unavailable\r\nRetry-After: 1\r\nContent-Length: 0\r\nConnection: close\r\n\r\n";
        let stored = format!(
            "HTTP/1.1 201 Created\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{document}",
            document.len()
        );
        let server = serving(vec![busy.to_owned(), busy.to_owned(), stored]);
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("session.json"), "{}").unwrap();
        let file = File::open(folder.path().join("session.json")).unwrap();
        assert_eq!(Client::new(&server, None).upload(&file, "application/json").unwrap().id, "session_1");
    }

    #[test]
    fn address_without_scheme_is_named() {
        assert!(server_url("http://h:1").is_ok() && server_url("https://h").is_ok());
        assert_eq!(server_url("h:8700").unwrap_err(), "write it with its scheme: http://h:8700");
    }

    #[test]
    fn given_key_is_preferred_to_the_password_of_the_url() {
        let key = |url: &str, key: Option<&str>| Client::new(url, key).authorization.unwrap_or_default();
        assert_eq!(key("http://x:of_url@host", Some("given")), "Bearer given");
        assert_eq!(key("http://x:of_url@host", None), "Bearer of_url");
        assert_eq!(key("http://host", None), "");
    }
}
