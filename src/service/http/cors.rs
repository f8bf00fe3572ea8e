//! Cross-origin requests: pages of an origin can read answers only if the operator has listed the origin.

use axum::http::{HeaderName, HeaderValue, Method, header};
use std::time::Duration;
use tower_http::cors::CorsLayer;

/// Allows the `origins` to call the API; `None` where none is listed.
pub(super) fn layer(origins: &[String]) -> Option<CorsLayer> {
    let origins: Vec<HeaderValue> = origins.iter().filter_map(|origin| HeaderValue::from_str(origin).ok()).collect();
    let idempotency_key = HeaderName::from_static("idempotency-key");
    let request_id = HeaderName::from_static("x-request-id");
    let last_event_id = HeaderName::from_static("last-event-id");
    (!origins.is_empty()).then(|| {
        CorsLayer::new()
            .allow_origin(origins)
            .allow_methods([Method::GET, Method::HEAD, Method::POST, Method::DELETE])
            .allow_headers([
                header::AUTHORIZATION,
                header::CONTENT_TYPE,
                header::IF_MATCH,
                header::IF_NONE_MATCH,
                header::IF_RANGE,
                header::RANGE,
                idempotency_key,
                last_event_id,
            ])
            .expose_headers([header::ETAG, header::LOCATION, header::RETRY_AFTER, request_id, header::CONTENT_RANGE])
            .max_age(Duration::from_secs(600))
    })
}
