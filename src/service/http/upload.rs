//! Request bodies as they come: bounded in size and in patience, streamed to disk with their digest.

use super::error::Problem;
use crate::service::failpoint::fault;
use crate::service::settings::RequestLimits;
use crate::service::store::folders::TemporaryFile;
use axum::body::{Body, Bytes};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use http_body_util::BodyExt;
use sha2::{Digest, Sha256};
use std::time::Duration;
use tokio::io::AsyncWriteExt;
use tokio::time::{Instant, timeout};

/// How much of a refused body is read so that the client gets to see the answer instead of a broken pipe.
const POLITENESS: u64 = 16 << 20;

/// A body read chunk by chunk under the limits.
pub(super) struct GuardedBody<'a> {
    body: Body,
    limits: &'a RequestLimits,
    max_bytes: u64,
    received: u64,
    window_end: Instant,
    window_bytes: u64,
    /// The client asked whether to send at all (`Expect: 100-continue`): an answer before the first read is a no.
    asks_first: bool,
}

impl<'a> GuardedBody<'a> {
    /// Refuses at once what says itself that it is too large, or comes encoded.
    pub(super) fn new(
        headers: &HeaderMap,
        body: Body,
        limits: &'a RequestLimits,
        max_bytes: u64,
    ) -> Result<Self, Refused<'a>> {
        let window_end = Instant::now() + limits.body_window;
        let asks_first = headers.contains_key(header::EXPECT);
        let guarded = Self { body, limits, max_bytes, received: 0, window_end, window_bytes: 0, asks_first };
        let length = headers.get(header::CONTENT_LENGTH).and_then(|v| v.to_str().ok()?.parse::<u64>().ok());
        if length.is_some_and(|length| length > max_bytes) && !fault("length.unread") {
            return Err(Refused { problem: Problem::too_large(max_bytes), body: guarded });
        }
        if headers.get(header::CONTENT_ENCODING).is_some_and(|encoding| encoding != "identity") {
            let problem = Problem::new(
                StatusCode::UNSUPPORTED_MEDIA_TYPE,
                "unsupported_encoding",
                "the body has a Content-Encoding",
                "send it plain; a zip is deflated already",
            );
            return Err(Refused { problem, body: guarded });
        }
        Ok(guarded)
    }

    /// The next bytes; `None` at the end.
    pub(super) async fn chunk(&mut self) -> Result<Option<Bytes>, Problem> {
        loop {
            let patience = if fault("body.patient") { Duration::MAX } else { self.limits.body_idle_timeout };
            let frame = timeout(patience, self.body.frame()).await;
            let frame = frame.map_err(|_| too_slow("nothing came for too long"))?;
            let Some(frame) = frame else { return Ok(None) };
            let frame = frame.map_err(|_| Problem::malformed("the body ended early", "send it again"))?;
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
            return Err(too_slow("the body came too slowly"));
        }
        (self.window_end, self.window_bytes) = (now + self.limits.body_window, 0);
        Ok(())
    }

    /// The whole of a small body.
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

    /// Reads on for a while into nothing.
    async fn drain(mut self) {
        if self.asks_first && self.received == 0 {
            return;
        }
        self.max_bytes = u64::MAX;
        let end = self.received + POLITENESS;
        let drained = async { while self.received < end && matches!(self.chunk().await, Ok(Some(_))) {} };
        let _ = timeout(Duration::from_secs(2), drained).await; // polite, not patient
    }
}

/// A refused body: its problem is answered once some of the rest was read.
pub(super) struct Refused<'a> {
    problem: Problem,
    body: GuardedBody<'a>,
}

impl Refused<'_> {
    /// The answer.
    pub(super) async fn problem(self) -> Problem {
        refuse(self.body, self.problem).await
    }
}

/// Reads on for a while, so that the client sees `problem`, and ends the connection after it.
pub(super) async fn refuse(body: GuardedBody<'_>, problem: Problem) -> Problem {
    body.drain().await;
    problem.with_header(header::CONNECTION, HeaderValue::from_static("close"))
}

fn too_slow(detail: &str) -> Problem {
    Problem::new(StatusCode::REQUEST_TIMEOUT, "too_slow", detail, "send the body without pauses")
        .with_header(header::CONNECTION, HeaderValue::from_static("close"))
}

/// Bytes on their way to disk.
pub(super) struct Spool {
    file: TemporaryFile,
    writer: tokio::fs::File,
    hasher: Sha256,
    bytes: u64,
}

/// An upload that lies complete in `tmp/`, not yet synced.
#[derive(Debug)]
pub(super) struct Spooled {
    /// Gone when dropped.
    pub(super) file: TemporaryFile,
    /// Digest of the bytes.
    pub(super) sha256: String,
    /// How many.
    pub(super) bytes: u64,
}

impl Spool {
    /// An empty file.
    pub(super) async fn create(file: TemporaryFile) -> Result<Self, Problem> {
        let writer = tokio::fs::File::create(&file.path).await.map_err(|e| Problem::from_io(&e))?;
        Ok(Self { file, writer, hasher: Sha256::new(), bytes: 0 })
    }

    /// Appends.
    pub(super) async fn write(&mut self, bytes: &[u8]) -> Result<(), Problem> {
        self.hasher.update(bytes);
        self.bytes += bytes.len() as u64;
        self.writer.write_all(bytes).await.map_err(|e| Problem::from_io(&e))
    }

    /// Hands the whole over.
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
    async fn a_body_may_be_as_large_as_allowed_and_no_larger() {
        let limits = RequestLimits::default();
        assert_eq!(read(body(5, false), &limits, 500).await, Ok(500));
        assert_eq!(read(body(5, false), &limits, 499).await, Err(413));
    }

    #[tokio::test]
    async fn a_body_that_stalls_or_dribbles_is_cut() {
        let idle = RequestLimits { body_idle_timeout: Duration::from_millis(20), ..RequestLimits::default() };
        assert_eq!(read(body(2, true), &idle, 1000).await, Err(408));
        let slow = RequestLimits { body_window: Duration::ZERO, body_min_bytes: 101, ..RequestLimits::default() };
        assert_eq!(read(body(2, false), &slow, 1000).await, Err(408));
        let fast_enough = RequestLimits { body_window: Duration::ZERO, body_min_bytes: 100, ..slow };
        assert_eq!(read(body(2, false), &fast_enough, 1000).await, Ok(200));
    }
}
