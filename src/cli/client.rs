//! The HTTP client of `submit` and `demo`: blocking, small.

use super::BadInput;
use crate::service::store::artifacts::{FileDigest, digest_file};
use anyhow::{Context, bail};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::fs::File;
use std::path::Path;
use std::time::{Duration, Instant};
use ureq::http::{Response, StatusCode, header};
use ureq::{Agent, Body};

/// Seconds that one question about a job may be held.
const WAIT: u32 = 30;

/// A service that does not answer for so long is given up.
const PATIENCE: Duration = Duration::from_secs(60);

/// A service's address and the connections to it.
pub(super) struct Client {
    agent: Agent,
    server: String,
}

/// A session, as far as it matters here.
#[derive(Debug, Deserialize)]
pub(super) struct SessionAnswer {
    pub(super) id: String,
    #[serde(default)]
    pub(super) warnings: Vec<String>,
}

/// A job, as far as it matters here.
#[derive(Debug, Deserialize)]
pub(super) struct JobAnswer {
    pub(super) id: String,
    pub(super) state: String,
    pub(super) progress: ProgressAnswer,
    pub(super) quality: Option<serde_json::Value>,
    pub(super) error: Option<ProblemAnswer>,
}

impl JobAnswer {
    /// Whether it has ended.
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

/// What a problem document or a failed job says.
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

/// The result's list of files.
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
    /// A client of `server` (`http://host:port`).
    pub(super) fn new(server: &str) -> Self {
        let config = Agent::config_builder()
            .http_status_as_error(false) // problem documents are read
            .timeout_connect(Some(Duration::from_secs(10)))
            .timeout_recv_response(Some(Duration::from_secs(u64::from(WAIT) + 300))) // a large upload is validated first
            .build();
        Self { agent: Agent::new_with_config(config), server: server.trim_end_matches('/').to_owned() }
    }

    /// Uploads a session.
    pub(super) fn upload(&self, session: &File, media_type: &str) -> anyhow::Result<SessionAnswer> {
        let request = self.agent.post(format!("{}/v1/sessions", self.server));
        let bytes = session.metadata()?.len();
        let request = request.header(header::CONTENT_LENGTH, bytes.to_string()).content_type(media_type);
        self.document(request.send(session).with_context(|| self.server.clone())?)
    }

    /// Submits a job; said twice it is still one job.
    pub(super) fn create_job(&self, session: &str, options: &serde_json::Value) -> anyhow::Result<JobAnswer> {
        let key = uuid::Uuid::new_v4().to_string();
        self.patiently(|| {
            let request = self.agent.post(format!("{}/v1/jobs", self.server)).header("idempotency-key", &key);
            request.send_json(serde_json::json!({ "session": session, "options": options }))
        })
    }

    /// The job, once it has changed or half a minute is over.
    pub(super) fn wait_for_job(&self, id: &str) -> anyhow::Result<JobAnswer> {
        self.patiently(|| self.agent.get(format!("{}/v1/jobs/{id}?wait={WAIT}", self.server)).call())
    }

    /// The result's list of files.
    pub(super) fn manifest(&self, job: &str) -> anyhow::Result<Manifest> {
        self.patiently(|| self.agent.get(format!("{}/v1/jobs/{job}/result", self.server)).call())
    }

    /// Downloads one file of a result and checks it.
    pub(super) fn download(&self, job: &str, name: &str, sha256: Option<&str>, to: &Path) -> anyhow::Result<()> {
        let url = format!("{}/v1/jobs/{job}/artifacts/{}", self.server, percent_encoded(name));
        let response = self.agent.get(url).call().with_context(|| self.server.clone())?;
        let mut response = self.expect_success(response)?;
        let etag = response.headers().get(header::ETAG).and_then(|tag| tag.to_str().ok()).map(str::to_owned);
        let mut file = File::create(to).with_context(|| to.display().to_string())?;
        std::io::copy(&mut response.body_mut().as_reader(), &mut file).with_context(|| name.to_owned())?;
        let FileDigest { sha256: found, .. } = digest_file(to)?;
        let tag = etag.as_deref().map(|tag| tag.trim_matches('"'));
        if sha256.or(tag).is_some_and(|sha256| sha256 != found) {
            bail!("{name}: the bytes received are not the ones published; download again");
        }
        Ok(())
    }

    /// Asks again while the service restarts.
    fn patiently<T: DeserializeOwned>(
        &self,
        ask: impl Fn() -> Result<Response<Body>, ureq::Error>,
    ) -> anyhow::Result<T> {
        let deadline = Instant::now() + PATIENCE;
        loop {
            match ask() {
                Ok(response) if response.status() == StatusCode::SERVICE_UNAVAILABLE && Instant::now() < deadline => {}
                Ok(response) => return self.document(response),
                Err(error) if Instant::now() >= deadline => return Err(error).with_context(|| self.server.clone()),
                Err(error) => tracing::warn!(%error, "the service does not answer; asking again"),
            }
            std::thread::sleep(Duration::from_secs(1));
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
        let text = problem.map_or_else(|_| format!("{} answers {status}", self.server), |problem| problem.to_string());
        match status {
            StatusCode::BAD_REQUEST
            | StatusCode::PAYLOAD_TOO_LARGE
            | StatusCode::UNSUPPORTED_MEDIA_TYPE
            | StatusCode::UNPROCESSABLE_ENTITY => Err(BadInput(text).into()),
            _ => bail!(text),
        }
    }
}

/// A name with its slashes, the rest as RFC 3986 wants it.
fn percent_encoded(name: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"/-._~".contains(&byte);
    name.bytes().map(|b| if plain(b) { char::from(b).to_string() } else { format!("%{b:02X}") }).collect()
}
