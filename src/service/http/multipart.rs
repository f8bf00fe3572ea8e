//! `multipart/form-data` (RFC 7578), read as a stream in bounded memory.
//!
//! Why not a library: the available ones buffer a preamble or the head of a part without a limit, and read ahead of their
//! reader. The forms that browsers and HTTP clients send need a hundred lines.

use super::body::GuardedBody;
use super::error::Problem;
use crate::service::settings::RequestLimits;
use axum::body::Body;
use axum::http::{HeaderMap, HeaderValue, header};

/// Longest head of a part: two short headers.
const MAX_HEAD_BYTES: usize = 8 << 10;

/// Longest boundary (RFC 2046).
const MAX_BOUNDARY_BYTES: usize = 70;

/// Reader of the parts of a form, in order.
pub(super) struct Multipart<'a, 'b> {
    body: &'a mut GuardedBody<'b>,
    /// `\r\n--` and the boundary.
    delimiter: Vec<u8>,
    buffer: Vec<u8>,
    is_in_part: bool,
    is_at_end: bool,
}

/// Head of a part; its file name and media type are ignored.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Part {
    /// Name of the form field.
    pub(super) name: String,
}

impl<'a, 'b> Multipart<'a, 'b> {
    /// Reads the boundary from the head of the request.
    pub(super) fn new(headers: &HeaderMap, body: &'a mut GuardedBody<'b>) -> Result<Self, Problem> {
        let content_type = headers.get(header::CONTENT_TYPE).and_then(|v| v.to_str().ok()).unwrap_or_default();
        let boundary = parameter(content_type, "boundary").filter(|b| (1..=MAX_BOUNDARY_BYTES).contains(&b.len()));
        let boundary = boundary.ok_or_else(|| malformed("the Content-Type has no valid boundary"))?;
        let delimiter = format!("\r\n--{boundary}").into_bytes();
        // The first delimiter is at the start of the body, without a line break before it.
        Ok(Self { body, delimiter, buffer: b"\r\n".to_vec(), is_in_part: false, is_at_end: false })
    }

    /// Head of the next part; skips the rest of the part before it. `None` after the last part.
    pub(super) async fn next_part(&mut self) -> Result<Option<Part>, Problem> {
        while self.is_in_part {
            self.data().await?;
        }
        if self.is_at_end {
            return Ok(None);
        }
        self.require(self.delimiter.len() + 2).await?;
        if !self.buffer.starts_with(&self.delimiter) {
            return Err(malformed("the body does not begin with its boundary"));
        }
        self.buffer.drain(..self.delimiter.len());
        if self.buffer.starts_with(b"--") {
            self.is_at_end = true;
            return Ok(None);
        }
        let head = self.head().await?;
        self.is_in_part = true;
        Ok(Some(head))
    }

    /// The next bytes of the part; `None` at its end.
    pub(super) async fn data(&mut self) -> Result<Option<Vec<u8>>, Problem> {
        while self.is_in_part {
            if let Some(end) = find(&self.buffer, &self.delimiter) {
                self.is_in_part = false;
                let rest = self.buffer.split_off(end);
                let bytes = std::mem::replace(&mut self.buffer, rest);
                return Ok((!bytes.is_empty()).then_some(bytes));
            }
            // A delimiter may begin in the last bytes: they are kept until the next chunk.
            let sure = self.buffer.len().saturating_sub(self.delimiter.len());
            if sure > 0 {
                let rest = self.buffer.split_off(sure);
                return Ok(Some(std::mem::replace(&mut self.buffer, rest)));
            }
            self.fill().await?;
        }
        Ok(None)
    }

    /// Reads a small part completely.
    pub(super) async fn text(&mut self, max_bytes: usize) -> Result<Vec<u8>, Problem> {
        let mut text = Vec::new();
        while let Some(bytes) = self.data().await? {
            text.extend_from_slice(&bytes);
            if text.len() > max_bytes {
                return Err(Problem::too_large(max_bytes as u64));
            }
        }
        Ok(text)
    }

    /// Reads the head of a part, up to the empty line.
    async fn head(&mut self) -> Result<Part, Problem> {
        let end = loop {
            if let Some(end) = find(&self.buffer, b"\r\n\r\n") {
                break end;
            }
            if self.buffer.len() > MAX_HEAD_BYTES {
                return Err(malformed("the head of a part is too long"));
            }
            self.fill().await?;
        };
        if !self.buffer.starts_with(b"\r\n") {
            return Err(malformed("a boundary is not followed by a line break"));
        }
        let head: Vec<u8> = self.buffer.drain(..end + 4).collect();
        let head = std::str::from_utf8(&head).map_err(|_| malformed("the head of a part is not UTF-8"))?;
        let value = |name: &str| {
            let mut lines = head.split("\r\n").filter_map(|line| line.split_once(':'));
            lines.find(|(key, _)| key.trim().eq_ignore_ascii_case(name)).map(|(_, value)| value.trim())
        };
        let disposition = value("content-disposition").unwrap_or_default();
        let name = parameter(disposition, "name").ok_or_else(|| malformed("a part has no name"))?;
        Ok(Part { name })
    }

    async fn require(&mut self, bytes: usize) -> Result<(), Problem> {
        while self.buffer.len() < bytes {
            self.fill().await?;
        }
        Ok(())
    }

    async fn fill(&mut self) -> Result<(), Problem> {
        let chunk = self.body.chunk().await?.ok_or_else(|| malformed("the body ends before its last boundary"))?;
        self.buffer.extend_from_slice(&chunk);
        Ok(())
    }
}

/// Reads a form from memory in pieces of `piece` bytes; returns the name and size of each part. Entry point of the fuzzer.
///
/// # Errors
/// What is malformed.
pub fn read_form(content_type: &str, form: &[u8], piece: usize) -> Result<Vec<(String, usize)>, String> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().map_err(|e| e.to_string())?;
    let value = HeaderValue::from_str(content_type).map_err(|e| e.to_string())?;
    let headers = HeaderMap::from_iter([(header::CONTENT_TYPE, value)]);
    let pieces: Vec<_> = form.chunks(piece).map(|piece| Ok::<_, std::io::Error>(piece.to_vec())).collect();
    let limits = RequestLimits::default();
    let read = async {
        let body = Body::from_stream(futures_util::stream::iter(pieces));
        let Ok(mut body) = GuardedBody::new(&headers, body, &limits, u64::MAX) else { return Ok(Vec::new()) };
        let mut multipart = Multipart::new(&headers, &mut body)?;
        let mut parts = Vec::new();
        while let Some(part) = multipart.next_part().await? {
            parts.push((part.name, multipart.text(usize::MAX).await?.len()));
        }
        Ok(parts)
    };
    runtime.block_on(read).map_err(|problem: Problem| problem.detail().to_owned())
}

fn malformed(detail: &str) -> Problem {
    Problem::malformed(detail, "send multipart/form-data as specified by RFC 7578")
}

/// The parameter `name` of a header value: `; name="value"` or `; name=value`.
fn parameter(value: &str, name: &str) -> Option<String> {
    let (_, mut rest) = value.split_once(';')?;
    loop {
        let (key, after) = rest.split_once('=')?;
        let after = after.trim_start();
        let (text, tail) = match after.strip_prefix('"') {
            Some(quoted) => quoted.split_once('"')?,
            None => after
                .split_once(';')
                .map_or((after.trim_end(), ""), |(text, _)| (text.trim_end(), &after[text.len()..])),
        };
        if key.trim().eq_ignore_ascii_case(name) {
            return Some(text.to_owned());
        }
        rest = tail.trim_start().strip_prefix(';')?;
    }
}

fn find(haystack: &[u8], needle: &[u8]) -> Option<usize> {
    let mut start = 0;
    while let Some(at) = haystack[start..].iter().position(|byte| *byte == needle[0]) {
        if haystack[start + at..].starts_with(needle) {
            return Some(start + at);
        }
        start += at + 1;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    const BODY: &str = "--AaB\r\nContent-Disposition: form-data; name=\"options\"\r\n\r\n{\"seed\":1}\r\n--AaB\r\n\
        content-disposition: form-data; name=\"session\"; filename=\"a;b.zip\"\r\nContent-Type: application/zip\r\n\r\n\
        PK\r\n--Aa\r\n\r\n--AaB--\r\n";

    async fn read(body: &str, cut: usize) -> Result<Vec<(Part, Vec<u8>)>, Problem> {
        let limits = RequestLimits::default();
        let mut headers = HeaderMap::new();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("multipart/form-data; boundary=AaB"));
        let (one, two) = body.as_bytes().split_at(cut);
        let chunks = [one.to_vec(), two.to_vec()].map(Ok::<_, std::io::Error>);
        let body = Body::from_stream(futures_util::stream::iter(chunks));
        let mut body = GuardedBody::new(&headers, body, &limits, 1 << 20).ok().unwrap();
        let mut multipart = Multipart::new(&headers, &mut body)?;
        let mut parts = Vec::new();
        while let Some(part) = multipart.next_part().await? {
            parts.push((part, multipart.text(1 << 10).await?));
        }
        Ok(parts)
    }

    #[tokio::test]
    async fn reads_the_same_parts_at_any_chunk_boundary() {
        let whole = read(BODY, 0).await.unwrap();
        assert_eq!(whole[0].0, Part { name: "options".into() });
        assert_eq!(whole[0].1, b"{\"seed\":1}");
        assert_eq!(whole[1].0, Part { name: "session".into() });
        assert_eq!(whole[1].1, b"PK\r\n--Aa\r\n");
        for cut in 0..BODY.len() {
            assert_eq!(read(BODY, cut).await.unwrap(), whole, "cut at {cut}");
        }
    }

    #[tokio::test]
    async fn rejects_truncated_form_and_preamble() {
        for end in 0..BODY.len() - 4 {
            assert!(read(&BODY[..end], 0).await.is_err(), "ends at {end}");
        }
        assert!(read(&format!("preamble\r\n{BODY}"), 0).await.is_err());
    }

    #[test]
    fn reads_quoted_and_plain_parameters() {
        assert_eq!(parameter("form-data; name=\"x\"; filename=\"y=1; z\"", "filename").as_deref(), Some("y=1; z"));
        assert_eq!(parameter("multipart/form-data; charset=utf-8; boundary=b", "boundary").as_deref(), Some("b"));
        assert_eq!(parameter("form-data", "name"), None);
    }
}
