//! Every route and the layers around them.

use super::app::{App, HttpNetworks};
use super::error::Problem;
use super::openapi::{Description, LazyDescription};
use super::server::Stop;
use super::{
    access, archive, cors, deliveries, descriptors, error, events, exports, health, inspection, jobs, openapi, results,
    scene, server, sessions, submission, trace, viewer,
};
use crate::service::failpoint::fault;
use crate::service::shared::Shared;
use axum::http::{HeaderValue, StatusCode, header};
use axum::middleware::{from_fn, from_fn_with_state, map_response};
use axum::response::Response;
use axum::{Extension, Router};
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tower::util::option_layer;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// Time in which a proxy notices at `/readyz` that a node stops, and closes connections that it no longer uses.
const PROXY_GRACE: Duration = Duration::from_secs(10);

/// Serves the API until the service begins to stop.
pub(in crate::service) async fn serve(shared: Shared, networks: HttpNetworks, listener: TcpListener) {
    let app = App::new(shared, networks);
    let (settings, metrics) = (app.settings.clone(), app.metrics.clone());
    let (limits, proxies) = (&settings.limits, app.trusted_proxies.clone());
    let max_connections = descriptors::allowed_connections(limits.max_connections, settings.jobs.concurrent);
    // Of several nodes behind a proxy; a proxy in front of one alone has no other to turn to.
    let has_others = app.store.is_shared() && settings.role.serves() && !settings.limits.trusted_proxies.is_empty();
    let grace = if has_others && !fault("drain.abrupt") { PROXY_GRACE } else { Duration::ZERO };
    let stop = Stop { draining: app.draining.clone(), grace, limit: settings.drain_limit };
    let router = if settings.role.serves() { router(app) } else { worker_router(app) };
    server::serve(listener, router, limits, max_connections, proxies, metrics, stop).await;
}

/// The OpenAPI document of this program as text.
pub fn openapi_json() -> String {
    description().json
}

fn description() -> Description {
    Description::of(api().merge(secrets()).merge(monitoring()).merge(open()).into_openapi())
}

/// Routes that need an API key where keys are required.
fn api() -> OpenApiRouter<App> {
    OpenApiRouter::new()
        .routes(routes!(sessions::create, sessions::list))
        .routes(routes!(sessions::get, sessions::delete))
        .routes(routes!(inspection::get))
        .routes(routes!(submission::create, jobs::list))
        .routes(routes!(jobs::get, jobs::delete))
        .routes(routes!(events::stream))
        .routes(routes!(scene::get))
        .routes(routes!(jobs::cancel))
        .routes(routes!(results::manifest))
        .routes(routes!(results::artifact))
        .routes(routes!(archive::get))
        .routes(routes!(exports::add))
        .routes(routes!(results::cameras))
        .routes(routes!(results::people))
        .routes(routes!(results::report))
        .routes(routes!(deliveries::list))
        .routes(routes!(deliveries::redeliver))
}

/// Routes that need a key with the scope `write`, whatever the method.
fn secrets() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(deliveries::secret, deliveries::rotate_secret))
}

/// The route that needs a key with the scope `metrics`.
fn monitoring() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(health::metrics))
}

/// Routes without access control.
fn open() -> OpenApiRouter<App> {
    OpenApiRouter::new()
        .routes(routes!(health::alive))
        .routes(routes!(health::ready))
        .routes(routes!(openapi::document))
        .routes(routes!(openapi::page))
}

fn router(app: App) -> Router {
    let api = api().layer(from_fn_with_state(app.clone(), access::to_the_api));
    let monitoring = monitoring().layer(from_fn_with_state(app.clone(), access::to_the_metrics));
    let secrets = secrets().layer(from_fn_with_state(app.clone(), access::to_the_secrets));
    // What the routes derive of the document takes a megabyte: it is derived again when it is asked for.
    let (router, _) = api.merge(secrets).merge(monitoring).merge(open()).split_for_parts();
    router
        .merge(viewer::routes())
        .fallback(no_such_route)
        .method_not_allowed_fallback(no_such_method)
        .layer(Extension(Arc::new(LazyDescription::new(description))))
        .layer(from_fn(error::write_problems))
        .layer(option_layer(cors::layer(&app.settings.cors_origins)))
        .layer(from_fn_with_state(app.clone(), trace::follow))
        .layer(map_response(without_sniffing))
        .with_state(app)
}

/// The routes of a process that only runs jobs: for its supervisor and for Prometheus.
fn worker_router(app: App) -> Router {
    let monitoring = monitoring().layer(from_fn_with_state(app.clone(), access::to_the_metrics));
    let probes = OpenApiRouter::new().routes(routes!(health::alive)).routes(routes!(health::ready));
    let (router, _) = monitoring.merge(probes).split_for_parts();
    router
        .fallback(no_such_route)
        .method_not_allowed_fallback(no_such_method)
        .layer(from_fn(error::write_problems))
        .layer(from_fn_with_state(app.clone(), trace::follow))
        .with_state(app)
}

/// Browsers must not guess another media type than the declared one: text from an upload could become a script.
async fn without_sniffing(mut response: Response) -> Response {
    response.headers_mut().insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    response
}

async fn no_such_route() -> Problem {
    Problem::new(
        StatusCode::NOT_FOUND,
        "not_found",
        "this route does not exist",
        "the routes of the API begin with /v1",
    )
}

async fn no_such_method() -> Problem {
    let remedy = "use one of the methods in the header Allow";
    Problem::new(StatusCode::METHOD_NOT_ALLOWED, "method_not_allowed", "the route does not support this method", remedy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checked_in_openapi_document_is_current() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/openapi/openapi.json");
        let kept = std::fs::read_to_string(file).unwrap();
        assert!(kept.trim() == openapi_json().trim(), "write it again: wandless openapi > openapi/openapi.json");
    }

    #[test]
    fn references_resolve_and_operation_ids_are_unique() {
        use serde_json::Value;
        fn visit<'a>(value: &'a Value, references: &mut Vec<&'a str>, ids: &mut Vec<&'a str>) {
            match value {
                Value::Object(map) => {
                    references.extend(map.get("$ref").and_then(Value::as_str));
                    ids.extend(
                        map.get("operationId").filter(|_| map.contains_key("responses")).and_then(Value::as_str),
                    );
                    map.values().for_each(|value| visit(value, references, ids));
                }
                Value::Array(list) => list.iter().for_each(|value| visit(value, references, ids)),
                _ => {}
            }
        }
        let document: Value = serde_json::from_str(&openapi_json()).unwrap();
        let (mut references, mut ids) = (Vec::new(), Vec::new());
        visit(&document, &mut references, &mut ids);
        let n_operations = ids.len();
        ids.sort_unstable();
        ids.dedup();
        assert_eq!((ids.len(), n_operations), (28, 28));
        assert!(!references.is_empty());
        for flattened in ["sha256", "id"] {
            assert!(document["components"]["schemas"]["Session"]["properties"].get(flattened).is_some(), "{flattened}");
        }
        for reference in references {
            assert!(document.pointer(reference.trim_start_matches('#')).is_some(), "{reference}");
        }
    }
}
