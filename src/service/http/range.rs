//! The `Range` header (RFC 9110, section 14), for one range of a file.

use super::error::Problem;
use crate::service::failpoint::fault;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};

/// The bytes of a file to send.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Part {
    pub(super) start: u64,
    pub(super) length: u64,
    pub(super) is_partial: bool,
}

/// Reads the requested range of a file of `bytes` bytes. Returns the whole file without a range, for several ranges or a
/// malformed range, and if `If-Range` does not match `tag`.
///
/// # Errors
/// 416 for a range after the end of the file.
pub(super) fn requested_part(headers: &HeaderMap, tag: &str, bytes: u64) -> Result<Part, Problem> {
    let whole = Part { start: 0, length: bytes, is_partial: false };
    let text = |name| headers.get(name).and_then(|value: &HeaderValue| value.to_str().ok());
    if text(header::IF_RANGE).is_some_and(|known| known != tag) {
        return Ok(whole);
    }
    let Some((first, last)) = text(header::RANGE).and_then(parse) else { return Ok(whole) };
    let (start, end) = match (first, last) {
        (Some(first), Some(last)) if last < first => return Ok(whole),
        (Some(first), last) => (first, last.map_or(bytes, |last| last.saturating_add(1).min(bytes))),
        (None, Some(suffix)) => (bytes.saturating_sub(suffix), bytes),
        (None, None) => return Ok(whole),
    };
    if start >= end {
        return Err(unsatisfiable(bytes));
    }
    let start = if fault("range.shifted") { (start + 1).min(end) } else { start };
    Ok(Part { start, length: end - start, is_partial: true })
}

/// Parses `bytes=first-last`, where one of the two may be missing.
fn parse(range: &str) -> Option<(Option<u64>, Option<u64>)> {
    let (first, last) = range.strip_prefix("bytes=")?.trim().split_once('-')?;
    let number = |text: &str| {
        let text = text.trim();
        if text.is_empty() { Some(None) } else { text.parse().ok().map(Some) }
    };
    Some((number(first)?, number(last)?))
}

fn unsatisfiable(bytes: u64) -> Problem {
    let problem = Problem::new(
        StatusCode::RANGE_NOT_SATISFIABLE,
        "range_not_satisfiable",
        format!("the file has {bytes} bytes"),
        "request a range inside of the file",
    );
    match HeaderValue::from_str(&format!("bytes */{bytes}")) {
        Ok(value) => problem.with_header(header::CONTENT_RANGE, value),
        Err(_) => problem,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(range: &str) -> Result<Part, Problem> {
        let mut headers = HeaderMap::new();
        headers.insert(header::RANGE, HeaderValue::from_str(range).unwrap());
        requested_part(&headers, "\"t\"", 10)
    }

    #[test]
    fn reads_ranges_by_the_rfc() {
        let some = |start, length| Part { start, length, is_partial: true };
        assert_eq!(part("bytes=0-0").unwrap(), some(0, 1));
        assert_eq!(part("bytes=2-").unwrap(), some(2, 8));
        assert_eq!(part("bytes=-3").unwrap(), some(7, 3));
        assert_eq!(part("bytes=-30").unwrap(), some(0, 10));
        assert_eq!(part("bytes=8-18446744073709551615").unwrap(), some(8, 2));
        for all in ["bytes=3-2", "bytes=a-b", "lines=1-2", "bytes=-", "bytes=0-1,3-4"] {
            assert_eq!(part(all).unwrap(), Part { start: 0, length: 10, is_partial: false }, "{all}");
        }
        for outside in ["bytes=10-", "bytes=10-12", "bytes=-0"] {
            assert!(part(outside).is_err(), "{outside}");
        }
    }
}
