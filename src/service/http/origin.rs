//! Checks of a browser's requests: by which name it reached the service, and whether a page of another site sent them.
//!
//! Without keys a request has the rights of the operator, so only loopback names and the hosts of the setting
//! `allowed_hosts` are served: a page whose own name resolves to the loopback (DNS rebinding) is of the same origin as the
//! service in the eyes of the browser, but its name is in the `Host` header.

use super::app::App;
use super::error::Problem;
use crate::service::failpoint::fault;
use axum::http::request::Parts;
use axum::http::uri::Authority;
use axum::http::{Method, StatusCode, header};
use std::net::IpAddr;

/// Refuses a request to a name that is neither a loopback name nor listed.
pub(super) fn require_known_host(app: &App, head: &Parts) -> Result<(), Problem> {
    let requested = requested_host(head).unwrap_or_default();
    if is_known(requested, &app.settings.allowed_hosts) || fault("hosts.any") {
        return Ok(());
    }
    Err(Problem::new(
        StatusCode::FORBIDDEN,
        "unknown_host",
        format!("without API keys the service does not answer requests to the host {requested:?}"),
        "use http://127.0.0.1, or ask the operator to list the host in allowed_hosts or to create a key",
    ))
}

/// Refuses changes by pages of other sites: they must not act with the rights of the browser's user.
pub(super) fn require_own_page(app: &App, head: &Parts) -> Result<(), Problem> {
    let text = |name: &str| head.headers.get(name).map(|value| value.to_str().unwrap_or_default());
    let origin = text("origin");
    let is_own = match (text("sec-fetch-site"), origin) {
        (Some(site), _) => matches!(site, "same-origin" | "none"),
        // Browsers send no `Sec-Fetch-Site` to plain HTTP addresses other than the loopback.
        (None, Some(origin)) => is_origin_of(origin, requested_host(head).unwrap_or_default()),
        (None, None) => true, // not a browser
    };
    let is_read = matches!(head.method, Method::GET | Method::HEAD);
    let is_listed = origin.is_some_and(|origin| app.settings.cors_origins.iter().any(|listed| listed == origin));
    if is_read || is_own || is_listed || fault("origins.any") {
        return Ok(());
    }
    Err(Problem::new(
        StatusCode::FORBIDDEN,
        "foreign_page",
        format!("pages of other sites cannot change anything here; the origin is {:?}", origin.unwrap_or_default()),
        "ask the operator to list the site in cors_origins; a proxy in front must pass the Host header on",
    ))
}

/// The host and port that the client asked for.
fn requested_host(head: &Parts) -> Option<&str> {
    let of_target = head.uri.authority().map(Authority::as_str);
    of_target.or_else(|| head.headers.get(header::HOST)?.to_str().ok())
}

/// Whether a `Host` header names the loopback.
pub(super) fn is_loopback_name(requested: &str) -> bool {
    is_known(requested, &[])
}

fn is_known(requested: &str, allowed: &[String]) -> bool {
    let Ok(authority) = requested.parse::<Authority>() else { return false };
    let host = authority.host().trim_end_matches('.');
    let address = host.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>();
    let is_same = |listed: &String| listed.eq_ignore_ascii_case(host) || listed.eq_ignore_ascii_case(requested);
    address.is_ok_and(|address| address.is_loopback())
        || host.eq_ignore_ascii_case("localhost")
        || allowed.iter().any(is_same)
}

/// Whether a page of `origin` has the host and port `requested`.
fn is_origin_of(origin: &str, requested: &str) -> bool {
    let Some((scheme, host)) = origin.split_once("://") else { return false };
    let default_port = if scheme == "https" { ":443" } else { ":80" };
    let plain = |host: &str| host.strip_suffix(default_port).unwrap_or(host).to_ascii_lowercase();
    !host.is_empty() && plain(host) == plain(requested)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_loopback_names_and_listed_hosts_are_known() {
        let allowed = ["studio.example".to_owned()];
        for host in ["localhost", "LOCALHOST:8700", "localhost.", "127.0.0.1:8700", "127.1.2.3", "[::1]:8700"] {
            assert!(is_known(host, &[]), "{host}");
        }
        for host in ["studio.example", "Studio.Example:8700"] {
            assert!(is_known(host, &allowed) && !is_known(host, &[]), "{host}");
        }
        for host in
            ["", "x", "localhost.evil.example", "127.0.0.1.evil.example", "localhost@evil.example", "10.0.0.1", "a b"]
        {
            assert!(!is_known(host, &allowed), "{host}");
        }
    }

    #[test]
    fn origin_must_have_the_host_and_port_of_the_request() {
        for (origin, host) in [
            ("http://10.0.0.1:8700", "10.0.0.1:8700"),
            ("https://studio.example", "studio.example"),
            ("https://studio.example", "Studio.example:443"),
            ("http://studio.example", "studio.example:80"),
        ] {
            assert!(is_origin_of(origin, host), "{origin} {host}");
        }
        for (origin, host) in [
            ("null", "null"),
            ("", ""),
            ("http://", ""),
            ("http://evil.example", "studio.example"),
            ("http://studio.example:8701", "studio.example:8700"),
            ("https://studio.example", "studio.example:80"),
        ] {
            assert!(!is_origin_of(origin, host), "{origin} {host}");
        }
    }
}
