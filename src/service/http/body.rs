//! Request bodies: limited in size and time, streamed to disk with their digest.

use super::error::Problem;
use crate::service::failpoint::fault;
use crate::service::settings::RequestLimits;
use crate::service::store::folders::TemporaryFile;
use crate::session::parser_errors::{in_json_words, pointer_step};
use axum::body::{Body, Bytes};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use http_body_util::BodyExt;
use serde::de::DeserializeOwned;
use serde_path_to_error::Segment;
use sha2::{Digest, Sha256};
use std::time::Duration;
use tokio::io::AsyncWriteExt;
use tokio::time::{Instant, timeout};

/// Bytes of a refused body that are still read, so that the client receives the answer instead of a broken pipe.
const MAX_DRAINED_BYTES: u64 = 16 << 20;

/// A request body that is read chunk by chunk under the limits.
pub(super) struct GuardedBody<'a> {
    body: Body,
    limits: &'a RequestLimits,
    max_bytes: u64,
    received: u64,
    window_end: Instant,
    window_bytes: u64,
    /// The client waits for permission to send (`Expect: 100-continue`); an answer before the first read is a refusal.
    expects_continue: bool,
}

impl<'a> GuardedBody<'a> {
    /// Refuses a body whose head declares that it is too large or encoded.
    pub(super) fn new(
        headers: &HeaderMap,
        body: Body,
        limits: &'a RequestLimits,
        max_bytes: u64,
    ) -> Result<Self, Refused<'a>> {
        let window_end = Instant::now() + limits.body_window;
        let expects_continue = headers.contains_key(header::EXPECT);
        let guarded = Self { body, limits, max_bytes, received: 0, window_end, window_bytes: 0, expects_continue };
        let length = headers.get(header::CONTENT_LENGTH).and_then(|v| v.to_str().ok()?.parse::<u64>().ok());
        if length.is_some_and(|length| length > max_bytes) && !fault("length.unread") {
            return Err(Refused { problem: Problem::too_large(max_bytes), body: guarded });
        }
        if headers.get(header::CONTENT_ENCODING).is_some_and(|encoding| encoding != "identity") {
            let problem = Problem::new(
                StatusCode::UNSUPPORTED_MEDIA_TYPE,
                "unsupported_encoding",
                "the body has a Content-Encoding",
                "send the body without encoding; a zip file is compressed already",
            );
            return Err(Refused { problem, body: guarded });
        }
        Ok(guarded)
    }

    /// The next bytes; `None` at the end of the body.
    pub(super) async fn chunk(&mut self) -> Result<Option<Bytes>, Problem> {
        loop {
            let idle_timeout = if fault("body.patient") { Duration::MAX } else { self.limits.body_idle_timeout };
            let frame = timeout(idle_timeout, self.body.frame()).await;
            let frame = frame.map_err(|_| too_slow("no data arrived for too long"))?;
            let Some(frame) = frame else { return Ok(None) };
            let frame = frame.map_err(|_| Problem::malformed("the body ended early", "send the request again"))?;
            let Ok(bytes) = frame.into_data() else { continue }; // trailers
            self.received += bytes.len() as u64;
            if self.received > self.max_bytes {
                return Err(Problem::too_large(self.max_bytes));
            }
            self.require_minimum_rate(bytes.len() as u64)?;
            return Ok(Some(bytes));
        }
    }

    fn require_minimum_rate(&mut self, bytes: u64) -> Result<(), Problem> {
        self.window_bytes += bytes;
        let now = Instant::now();
        if now < self.window_end {
            return Ok(());
        }
        if self.window_bytes < self.limits.body_min_bytes && !fault("body.patient") {
            return Err(too_slow("the body arrived too slowly"));
        }
        (self.window_end, self.window_bytes) = (now + self.limits.body_window, 0);
        Ok(())
    }

    /// Reads a small body completely.
    pub(super) async fn read_all(mut self) -> Result<Vec<u8>, Refused<'a>> {
        let mut all = Vec::new();
        loop {
            match self.chunk().await {
                Ok(Some(bytes)) => all.extend_from_slice(&bytes),
                Ok(None) => return Ok(all),
                Err(problem) => return Err(Refused { problem, body: self }),
            }
        }
    }

    /// Reads and discards more of the body for a short time.
    async fn drain(mut self) {
        if self.expects_continue && self.received == 0 {
            return;
        }
        self.max_bytes = u64::MAX;
        let end = self.received + MAX_DRAINED_BYTES;
        let drained = async { while self.received < end && matches!(self.chunk().await, Ok(Some(_))) {} };
        let _ = timeout(Duration::from_secs(2), drained).await; // the client gets little time
    }
}

/// Reads the JSON object of a body. A list is refused: serde would take its items as the fields of `T` in their order.
pub(super) fn object<T: DeserializeOwned>(text: &[u8], remedy: &str) -> Result<T, Problem> {
    if text.trim_ascii_start().first().is_some_and(|first| *first != b'{') {
        return Err(Problem::malformed("the body is not a JSON object", remedy));
    }
    let mut parser = serde_json::Deserializer::from_slice(text);
    let read = serde_path_to_error::deserialize(&mut parser).map_err(|error| {
        let pointer = pointer(error.path());
        let problem = Problem::malformed(format!("the body: {}", in_json_words(error.inner())), remedy);
        if pointer.is_empty() { problem } else { problem.at(pointer) }
    })?;
    parser.end().map_err(|error| Problem::malformed(format!("the body: {error}"), remedy))?;
    Ok(read)
}

/// JSON pointer (RFC 6901) of a value; empty for the document.
fn pointer(path: &serde_path_to_error::Path) -> String {
    let step = |segment: &Segment| match segment {
        Segment::Seq { index } => format!("/{index}"),
        Segment::Map { key } | Segment::Enum { variant: key } => pointer_step(key),
        Segment::Unknown => String::new(),
    };
    path.iter().map(step).collect()
}

/// A refused body and its problem; the answer is sent after some of the rest was read.
pub(super) struct Refused<'a> {
    problem: Problem,
    body: GuardedBody<'a>,
}

impl Refused<'_> {
    /// Drains the body and returns the answer.
    pub(super) async fn problem(self) -> Problem {
        refuse(self.body, self.problem).await
    }
}

/// Drains the body, so that the client receives `problem`; the connection is closed after the answer.
pub(super) async fn refuse(body: GuardedBody<'_>, problem: Problem) -> Problem {
    body.drain().await;
    problem.with_header(header::CONNECTION, HeaderValue::from_static("close"))
}

fn too_slow(detail: &str) -> Problem {
    Problem::new(StatusCode::REQUEST_TIMEOUT, "too_slow", detail, "send the body without pauses")
        .with_header(header::CONNECTION, HeaderValue::from_static("close"))
}

/// A body that is being written to a temporary file.
pub(super) struct Spool {
    file: TemporaryFile,
    writer: tokio::fs::File,
    hasher: Sha256,
    bytes: u64,
}

/// A complete upload in `tmp/`, not yet synced to the disk.
#[derive(Debug)]
pub(super) struct Spooled {
    /// The temporary file; removed on drop.
    pub(super) file: TemporaryFile,
    /// SHA-256 of the bytes, hex.
    pub(super) sha256: String,
    /// Number of bytes.
    pub(super) bytes: u64,
}

impl Spool {
    /// Creates the empty file.
    pub(super) async fn create(file: TemporaryFile) -> Result<Self, Problem> {
        let writer = tokio::fs::File::create(&file.path).await.map_err(|e| Problem::from_io(&e))?;
        Ok(Self { file, writer, hasher: Sha256::new(), bytes: 0 })
    }

    /// Appends bytes.
    pub(super) async fn write(&mut self, bytes: &[u8]) -> Result<(), Problem> {
        self.hasher.update(bytes);
        self.bytes += bytes.len() as u64;
        self.writer.write_all(bytes).await.map_err(|e| Problem::from_io(&e))
    }

    /// Flushes the file and returns it with its digest.
    pub(super) async fn finish(mut self) -> Result<Spooled, Problem> {
        self.writer.flush().await.map_err(|e| Problem::from_io(&e))?;
        Ok(Spooled { file: self.file, sha256: hex::encode(self.hasher.finalize()), bytes: self.bytes })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures_util::{StreamExt, stream};

    type Chunks = Vec<Result<Vec<u8>, std::io::Error>>;

    fn body(chunks: usize, then_hangs: bool) -> Body {
        let chunks: Chunks = (0..chunks).map(|_| Ok(vec![0; 100])).collect();
        let chunks = stream::iter(chunks);
        if then_hangs { Body::from_stream(chunks.chain(stream::pending())) } else { Body::from_stream(chunks) }
    }

    async fn read(body: Body, limits: &RequestLimits, max_bytes: u64) -> Result<usize, u16> {
        let status = |problem: Problem| axum::response::IntoResponse::into_response(problem).status().as_u16();
        let mut guarded =
            GuardedBody::new(&HeaderMap::new(), body, limits, max_bytes).ok().expect("no header to refuse");
        let mut received = 0;
        while let Some(bytes) = guarded.chunk().await.map_err(status)? {
            received += bytes.len();
        }
        Ok(received)
    }

    #[tokio::test]
    async fn accepts_bodies_up_to_the_size_limit() {
        let limits = RequestLimits::default();
        assert_eq!(read(body(5, false), &limits, 500).await, Ok(500));
        assert_eq!(read(body(5, false), &limits, 499).await, Err(413));
    }

    #[tokio::test]
    async fn rejects_a_stalled_or_slow_body() {
        let idle = RequestLimits { body_idle_timeout: Duration::from_millis(20), ..RequestLimits::default() };
        assert_eq!(read(body(2, true), &idle, 1000).await, Err(408));
        let slow = RequestLimits { body_window: Duration::ZERO, body_min_bytes: 101, ..RequestLimits::default() };
        assert_eq!(read(body(2, false), &slow, 1000).await, Err(408));
        let fast_enough = RequestLimits { body_window: Duration::ZERO, body_min_bytes: 100, ..slow };
        assert_eq!(read(body(2, false), &fast_enough, 1000).await, Ok(200));
    }
}
