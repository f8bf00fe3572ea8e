//! Gives every request an id, a log line and an entry in the metrics.
//!
//! Why not `tower_http::request_id`: it takes over any id of a client, unchecked, and ids are written into the log.

use super::app::App;
use super::error::Problem;
use crate::service::queue::job::Submitter;
use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderValue, Method};
use axum::middleware::Next;
use axum::response::Response;
use std::time::Instant;
use tracing::Instrument;
use tracing::field::Empty;

const REQUEST_ID: &str = "x-request-id";
/// Longest id that is taken over from a client or a proxy, characters.
const MAX_ID: usize = 64;

/// Middleware: runs a request under the id that the client sent, or under a new one.
pub(super) async fn follow(State(app): State<App>, mut request: Request, next: Next) -> Response {
    let start = Instant::now();
    let method = request.method().clone();
    let route = request.extensions().get::<MatchedPath>().map_or("none".to_owned(), |path| path.as_str().to_owned());
    let id = request_id(&request);
    let text = id.to_str().unwrap_or_default().to_owned();
    request.extensions_mut().insert(Submitter { request: Some(text), key: None });
    let span = tracing::info_span!(
        "request",
        request.id = id.to_str().unwrap_or_default(),
        %method,
        route,
        job.id = id_in_path(&request, "job_"),
        session.id = id_in_path(&request, "session_"),
        tenant = Empty, // the access check adds the tenant and the key
        key.id = Empty,
    );
    let mut response = next.run(request).instrument(span.clone()).await;
    response.headers_mut().insert(REQUEST_ID, id);
    let status = response.status();
    let code = response.extensions().get::<Problem>().map_or("", Problem::code);
    let seconds = start.elapsed().as_secs_f64();
    app.metrics.note_request(&method, &route, status.as_u16(), code, seconds);
    span.in_scope(|| {
        let status = status.as_u16();
        // Changes and errors are logged, plain reads are not.
        if !matches!(method, Method::GET | Method::HEAD) || status >= 400 {
            tracing::info!(status, code, duration_s = seconds, "request");
        } else {
            tracing::debug!(status, duration_s = seconds, "request");
        }
    });
    response
}

fn request_id(request: &Request) -> HeaderValue {
    let is_plain = |byte: &u8| byte.is_ascii_alphanumeric() || b"-_.:".contains(byte);
    let own = || HeaderValue::from_str(&uuid::Uuid::new_v4().to_string()).expect("a UUID is ASCII");
    let given = request.headers().get(REQUEST_ID);
    let given = given.filter(|id| (1..=MAX_ID).contains(&id.len()) && id.as_bytes().iter().all(is_plain));
    given.cloned().unwrap_or_else(own)
}

/// The id with this prefix in the path of a request.
fn id_in_path<'a>(request: &'a Request, prefix: &str) -> Option<&'a str> {
    let is_id = |part: &&str| {
        part.len() <= MAX_ID
            && part.strip_prefix(prefix).is_some_and(|digits| digits.bytes().all(|byte| byte.is_ascii_hexdigit()))
    };
    request.uri().path().split('/').find(is_id)
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::body::Body;

    #[test]
    fn only_plain_ids_of_a_path_are_logged() {
        let of = |path: &str| {
            let request = Request::builder().uri(path).body(Body::empty()).unwrap();
            id_in_path(&request, "job_").map(str::to_owned)
        };
        assert_eq!(of("/v1/jobs/job_0a/cancel").as_deref(), Some("job_0a"));
        for path in ["/v1/jobs", "/v1/jobs/job_x", "/v1/sessions/session_0a", &format!("/v1/jobs/job_{:070}", 0)] {
            assert_eq!(of(path), None, "{path}");
        }
    }
}
