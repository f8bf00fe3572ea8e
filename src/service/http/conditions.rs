//! Conditional requests (RFC 9110, section 13): `If-Match` and `If-None-Match` against the ETag of a resource.

use super::error::Problem;
use axum::http::{HeaderMap, HeaderName, StatusCode, header};

/// Refuses a request whose `If-Match` does not contain `tag`: the client knows another version.
pub(super) fn require_match(headers: &HeaderMap, tag: &str) -> Result<(), Problem> {
    // Weak tags never match here.
    if !headers.contains_key(header::IF_MATCH) || lists(headers, &header::IF_MATCH, |known| known == tag) {
        return Ok(());
    }
    Err(Problem::new(
        StatusCode::PRECONDITION_FAILED,
        "precondition_failed",
        format!("If-Match names another version; the current one is {tag}"),
        "get the resource again, and repeat the request with its ETag or without If-Match",
    ))
}

/// Whether `If-None-Match` contains `tag`: the client has this version.
pub(super) fn is_unchanged(headers: &HeaderMap, tag: &str) -> bool {
    lists(headers, &header::IF_NONE_MATCH, |known| known.trim_start_matches("W/") == tag)
}

/// Whether a header, a list of tags or `*`, has a matching tag.
fn lists(headers: &HeaderMap, name: &HeaderName, is_match: impl Fn(&str) -> bool) -> bool {
    let mut values = headers.get_all(name).iter().filter_map(|value| value.to_str().ok());
    values.any(|value| value.split(',').map(str::trim).any(|known| known == "*" || is_match(known)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tags_match_as_the_rfc_says() {
        let with = |name, value: &str| HeaderMap::from_iter([(name, value.parse().unwrap())]);
        let if_match = |value| require_match(&with(header::IF_MATCH, value), "\"a\"").is_ok();
        let if_none_match = |value| is_unchanged(&with(header::IF_NONE_MATCH, value), "\"a\"");
        for one in ["\"a\"", "\"b\", \"a\"", "*"] {
            assert!(if_match(one) && if_none_match(one), "{one}");
        }
        for other in ["\"b\"", "a", ""] {
            assert!(!if_match(other) && !if_none_match(other), "{other}");
        }
        assert!(!if_match("W/\"a\"") && if_none_match("W/\"a\""));
        assert!(require_match(&HeaderMap::new(), "\"a\"").is_ok() && !is_unchanged(&HeaderMap::new(), "\"a\""));
    }
}
