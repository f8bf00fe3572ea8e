//! Access control: API keys, scopes and rate limits.
//!
//! A key is sent as `Authorization: Bearer wl_…`, or as the password of `Authorization: Basic`, for which a browser prompts.
//! While no key was ever created and the service listens on a loopback address, every request acts as the tenant `default`;
//! [`super::origin`] then checks the host that it was sent to.
//! Resources of other tenants are answered like resources that do not exist.

use super::app::App;
use super::connections::network;
use super::error::Problem;
use super::origin::{require_known_host, require_own_page};
use super::server::Peer;
use crate::service::failpoint::fault;
use crate::service::queue::job::Submitter;
use crate::service::store::keys::{self, Scope};
use crate::service::store::{StoreError, Tenant};
use crate::service::webhooks::Networks;
use axum::extract::{FromRequestParts, Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use std::net::{IpAddr, SocketAddr};
use std::time::{Duration, Instant};
use tracing::Span;

/// An answer that took longer is withheld if the key was revoked in the meantime.
const LONG_WAIT: Duration = Duration::from_secs(1);

/// The authenticated tenant of a request; every handler below `/v1` extracts it.
#[derive(Debug, Clone)]
pub(super) struct Caller {
    /// The only tenant whose resources the request can access.
    pub(super) tenant: Tenant,
}

impl<S: Sync + Send> FromRequestParts<S> for Caller {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        parts.extensions.get::<Caller>().cloned().ok_or_else(|| Problem::internal("a route without an access check"))
    }
}

/// What admitted a request: the id of a key, or `None` where no key was required.
#[derive(Debug, Clone)]
pub(super) struct Credential(Option<String>);

impl Credential {
    /// Whether a request would still be admitted.
    pub(super) async fn is_valid(&self, app: &App) -> Result<bool, StoreError> {
        match &self.0 {
            Some(key) => keys::is_active(&app.store, key).await,
            None => Ok(!requires_keys(app).await?),
        }
    }
}

impl<S: Sync + Send> FromRequestParts<S> for Credential {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        parts.extensions.get::<Self>().cloned().ok_or_else(|| Problem::internal("a route without an access check"))
    }
}

/// Middleware of the routes below `/v1`, adds [`Caller`] and [`Credential`]: GET and HEAD need the scope `read`, other
/// methods `write`.
pub(super) async fn to_the_api(State(app): State<App>, request: Request, next: Next) -> Response {
    let scope = if is_read(request.method()) { Scope::Read } else { Scope::Write };
    admit(app, scope, request, next).await
}

/// Middleware of the routes that show secrets: every method needs the scope `write`.
pub(super) async fn to_the_secrets(State(app): State<App>, request: Request, next: Next) -> Response {
    admit(app, Scope::Write, request, next).await
}

/// Middleware of `/metrics`: needs the scope `metrics`.
pub(super) async fn to_the_metrics(State(app): State<App>, request: Request, next: Next) -> Response {
    admit(app, Scope::Metrics, request, next).await
}

async fn admit(app: App, scope: Scope, request: Request, next: Next) -> Response {
    let (mut head, body) = request.into_parts();
    let start = Instant::now();
    let is_read = is_read(&head.method);
    let (caller, credential) = match caller(&app, scope, &head).await {
        Ok(admitted) => admitted,
        Err(problem) => return problem.into_response(),
    };
    head.extensions.insert(caller);
    if let Some(submitter) = head.extensions.get_mut::<Submitter>() {
        submitter.key.clone_from(&credential.0);
    }
    head.extensions.insert(credential.clone());
    let challenge = challenge(&head.headers);
    let response = next.run(Request::from_parts(head, body)).await;
    if !is_read || start.elapsed() < LONG_WAIT {
        return response;
    }
    match credential.is_valid(&app).await {
        Ok(true) => response,
        Ok(false) => unauthorized(challenge).into_response(),
        Err(error) => Problem::from(error).into_response(),
    }
}

fn is_read(method: &Method) -> bool {
    matches!(*method, Method::GET | Method::HEAD)
}

async fn caller(app: &App, scope: Scope, head: &Parts) -> Result<(Caller, Credential), Problem> {
    let note_access = |has_access: bool| {
        if let Some(peer) = head.extensions.get::<Peer>() {
            peer.connection.note_access(has_access);
        }
    };
    if !requires_keys(app).await? {
        require_known_host(app, head)?;
        require_own_page(app, head)?;
        note_access(true);
        let tenant = Tenant::default_tenant();
        Span::current().record("tenant", tenant.name());
        return Ok((Caller { tenant }, Credential(None)));
    }
    require_own_page(app, head)?;
    let key = match token(&head.headers) {
        Some(token) => keys::check(&app.store, &token).await?,
        None => None,
    };
    note_access(key.is_some());
    let Some(key) = key else { return Err(refuse_key(app, head)) };
    Span::current().record("tenant", key.tenant.name()).record("key.id", key.id.as_str());
    app.tenant_rates.take(key.tenant.name()).map_err(|wait| too_many("the tenant sends too many requests", wait))?;
    if !key.scopes.contains(&scope) {
        return Err(Problem::new(
            StatusCode::FORBIDDEN,
            "scope_missing",
            format!("the key does not have the scope `{}`", scope.name()),
            "ask the operator for a key with this scope",
        ));
    }
    let tenant = if fault("tenants.one") { Tenant::default_tenant() } else { key.tenant };
    Ok((Caller { tenant }, Credential(Some(key.id))))
}

async fn requires_keys(app: &App) -> Result<bool, StoreError> {
    Ok(!app.settings.listen.ip().is_loopback() || keys::any(&app.store).await?)
}

fn token(headers: &HeaderMap) -> Option<String> {
    let value = headers.get(header::AUTHORIZATION)?.to_str().ok()?;
    let (scheme, rest) = value.split_once(' ')?;
    match scheme.to_ascii_lowercase().as_str() {
        "bearer" => Some(rest.trim().to_owned()),
        "basic" => {
            let pair = String::from_utf8(STANDARD.decode(rest.trim()).ok()?).ok()?;
            Some(pair.split_once(':')?.1.to_owned())
        }
        _ => None,
    }
}

/// 401, or 429 after too many wrong keys from one address.
fn refuse_key(app: &App, head: &Parts) -> Problem {
    let peer = head.extensions.get::<Peer>().map(|peer| client(peer.address.ip(), &head.headers, &app.trusted_proxies));
    let peer = peer.map_or_else(String::new, |address| network(address).to_string());
    if let Err(wait) = app.bad_key_rates.take(&peer)
        && !fault("guesses.free")
    {
        return too_many("too many requests without a valid key", wait);
    }
    unauthorized(challenge(&head.headers))
}

/// The address of the client: that of the connection, or the last one in `X-Forwarded-For` that is not a trusted proxy. What stands before
/// it can be written by anyone.
fn client(peer: IpAddr, headers: &HeaderMap, proxies: &Networks) -> IpAddr {
    let lines: Vec<&str> = headers.get_all("x-forwarded-for").iter().filter_map(|line| line.to_str().ok()).collect();
    let mut client = peer;
    for word in lines.join(",").rsplit(',') {
        if !proxies.contain(client) {
            break;
        }
        let Some(before) = forwarded(word.trim()) else { break };
        client = before;
    }
    client
}

/// An address in `X-Forwarded-For`; some proxies write the port, too, and then an IPv6 address in brackets.
fn forwarded(word: &str) -> Option<IpAddr> {
    let with_port = || word.parse::<SocketAddr>().ok().map(|address| address.ip());
    let in_brackets = || word.strip_prefix('[')?.strip_suffix(']')?.parse().ok();
    word.parse().ok().or_else(with_port).or_else(in_brackets)
}

fn unauthorized(challenge: &'static str) -> Problem {
    Problem::new(
        StatusCode::UNAUTHORIZED,
        "unauthorized",
        "a valid API key is needed",
        "send the header Authorization: Bearer <key>; the operator creates keys with `wandless key create`",
    )
    .with_header(header::WWW_AUTHENTICATE, HeaderValue::from_static(challenge))
}

/// The `WWW-Authenticate` header: `Basic` makes the browser prompt for pages and downloads; scripts of the viewer get
/// `Bearer` and show their own prompt.
fn challenge(headers: &HeaderMap) -> &'static str {
    let is_script = headers.get("sec-fetch-dest").is_some_and(|destination| destination == "empty");
    if is_script { "Bearer realm=\"wandless\"" } else { "Basic realm=\"wandless\", charset=\"UTF-8\"" }
}

fn too_many(detail: &str, wait: Duration) -> Problem {
    let seconds = HeaderValue::from(wait.as_secs().max(1));
    Problem::new(StatusCode::TOO_MANY_REQUESTS, "too_many_requests", detail, "retry after the time in Retry-After")
        .with_header(header::RETRY_AFTER, seconds)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn browser_prompts_for_pages_but_not_for_scripts() {
        let of = |destination: &'static str| {
            let mut headers = HeaderMap::new();
            headers.insert("sec-fetch-dest", HeaderValue::from_static(destination));
            challenge(&headers)
        };
        assert!(of("empty").starts_with("Bearer"));
        assert!(of("document").starts_with("Basic") && challenge(&HeaderMap::new()).starts_with("Basic"));
    }

    #[test]
    fn only_trusted_proxies_name_the_client() {
        let proxies = Networks::parse("list", &["10.0.0.0/8".to_owned(), "::1".to_owned()]).unwrap();
        let of = |peer: &str, forwarded: &[&'static str]| {
            let mut headers = HeaderMap::new();
            for line in forwarded {
                headers.append("x-forwarded-for", HeaderValue::from_static(line));
            }
            client(peer.parse().unwrap(), &headers, &proxies).to_string()
        };
        assert_eq!(of("203.0.113.9", &["198.51.100.1"]), "203.0.113.9", "no proxy: its header counts for nothing");
        assert_eq!(
            of("10.1.1.1", &["1.2.3.4, 198.51.100.1"]),
            "198.51.100.1",
            "the client can invent what stands before"
        );
        assert_eq!(of("10.1.1.1", &["198.51.100.1, 10.2.2.2"]), "198.51.100.1", "a chain of proxies");
        assert_eq!(of("::1", &["1.2.3.4", "198.51.100.1"]), "198.51.100.1", "several lines are one list");
        for word in ["198.51.100.1:5678", "[2001:db8::7]:5678", "[2001:db8::7]", "2001:db8::7"] {
            let client = if word.starts_with('1') { "198.51.100.1" } else { "2001:db8::7" };
            assert_eq!(of("10.1.1.1", &[word]), client, "{word}: a proxy that writes ports hid its clients");
        }
        assert_eq!((of("10.1.1.1", &[]), of("10.1.1.1", &["unknown"])), ("10.1.1.1".to_owned(), "10.1.1.1".to_owned()));
    }

    #[test]
    fn reads_keys_from_bearer_and_basic() {
        let read = |value: &str| {
            let mut headers = HeaderMap::new();
            headers.insert(header::AUTHORIZATION, HeaderValue::from_str(value).unwrap());
            token(&headers)
        };
        assert_eq!(read("Bearer wl_a_b").as_deref(), Some("wl_a_b"));
        assert_eq!(read("bearer  wl_a_b").as_deref(), Some("wl_a_b"));
        assert_eq!(read("Basic dXNlcjp3bF9hX2I=").as_deref(), Some("wl_a_b"));
        for nothing in ["wl_a_b", "Basic !", "Digest x", "Basic d2w="] {
            assert_eq!(read(nothing), None, "{nothing}");
        }
    }
}
