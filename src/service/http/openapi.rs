//! `GET /openapi.json` (OpenAPI 3.1) and `GET /docs`.
//!
//! The handlers and the types that they read and write derive the document (`utoipa`). [`Description::of`] adds what holds
//! for groups of operations: ids in paths, access control, problem documents and links.

mod guide;
mod options;

use super::error;
use axum::Extension;
use axum::http::header;
use axum::response::{Html, IntoResponse};
use guide::escaped;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::{Arc, LazyLock};
use utoipa::PartialSchema;

/// A description that is written when it is first asked for: few starts of the service need it.
pub(super) type LazyDescription = LazyLock<Description>;

/// The description of the API.
pub(super) struct Description {
    /// The OpenAPI document.
    pub(super) json: String,
    /// The same as an HTML page without scripts.
    page: String,
}

/// Get this description.
#[utoipa::path(get, path = "/openapi.json", operation_id = "getDescription", tag = "service",
    responses((status = 200, description = "The OpenAPI document", body = Value)))]
pub(super) async fn document(Extension(description): Extension<Arc<LazyDescription>>) -> impl IntoResponse {
    ([(header::CONTENT_TYPE, "application/json")], description.json.clone())
}

/// Get the description as a page to read.
#[utoipa::path(get, path = "/docs", operation_id = "getDocs", tag = "service",
    responses((status = 200, description = "The page", body = String, content_type = "text/html")))]
pub(super) async fn page(Extension(description): Extension<Arc<LazyDescription>>) -> impl IntoResponse {
    let policy = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; frame-ancestors 'none'";
    ([(header::CONTENT_SECURITY_POLICY, policy)], Html(description.page.clone()))
}

impl Description {
    /// Completes the derived document and writes the page.
    pub(super) fn of(derived: utoipa::openapi::OpenApi) -> Self {
        let mut document = serde_json::to_value(derived).expect("an OpenAPI document serialises");
        document["info"] = json!({
            "title": "wandless",
            "version": env!("CARGO_PKG_VERSION"),
            "description": "Recovers moving people and the cameras that filmed them from 2D poses. Upload a session, submit a \
                job, follow it, download the result. A job that was answered 202 reaches exactly one final state and \
                publishes at most one result.",
            "license": { "name": "MIT OR Apache-2.0", "identifier": "MIT OR Apache-2.0" },
        });
        document["servers"] = json!([{ "url": "/" }]);
        document["components"]["securitySchemes"] = json!({
            "key": { "type": "http", "scheme": "bearer", "description": "An API key; required once a key was created" },
            "browser": { "type": "http", "scheme": "basic", "description": "The same key as the password" },
        });
        let problem = serde_json::to_value(error::Document::schema()).expect("a schema serialises");
        document["components"]["schemas"]["Problem"] = problem; // no handler names it: `complete` adds the error answers
        let paths = document["paths"].take();
        let mut paths: BTreeMap<String, Map<String, Value>> = serde_json::from_value(paths).expect("paths are objects");
        paths = paths.into_iter().map(|(path, methods)| (path.replace("{*", "{"), methods)).collect();
        let links = ["session", "job"].map(|kind| links(&paths, kind));
        for (path, methods) in &mut paths {
            for operation in methods.values_mut() {
                complete(path, operation);
                match operation["operationId"].as_str() {
                    Some("createSession") => operation["responses"]["201"]["links"] = links[0].clone(),
                    Some("createJob") => operation["responses"]["202"]["links"] = links[1].clone(),
                    _ => {}
                }
            }
        }
        document["paths"] = json!(paths);
        options::describe(&mut document["components"]["schemas"]);
        close_answers(&mut document["components"]["schemas"]);
        let json = serde_json::to_string_pretty(&document).expect("a JSON value serialises");
        Self { json, page: html(&paths, &document["components"]["schemas"]) }
    }
}

/// Adds the refusals that follow from the path, and describes every refusal.
fn complete(path: &str, operation: &mut Value) {
    let mut common = vec!["default"];
    if path.contains("{id}") {
        common.extend(["400", "404"]);
    }
    if path.starts_with("/v1") || path == "/metrics" {
        common.extend(["401", "403", "429", "503"]);
        operation["security"] = json!([{}, { "key": [] }, { "browser": [] }]);
    }
    describe_bytes(operation);
    let schema = json!({ "$ref": "#/components/schemas/Problem" });
    let Some(responses) = operation["responses"].as_object_mut() else { return };
    for status in common {
        responses.entry(status).or_insert(Value::Null);
    }
    for (status, response) in responses {
        if let Some(meaning) = meaning(status) {
            *response =
                json!({ "description": meaning, "content": { "application/problem+json": { "schema": schema } } });
        }
    }
}

/// Bodies that are not JSON are bytes or lines of text; generators of clients need the type.
fn describe_bytes(operation: &mut Value) {
    for place in ["/requestBody/content", "/responses/200/content"] {
        let content = operation.pointer_mut(place).and_then(Value::as_object_mut);
        for (media_type, body) in content.into_iter().flatten() {
            match media_type.as_str() {
                "application/zip" | "*/*" => body["schema"] = json!({ "type": "string", "format": "binary" }),
                "application/x-ndjson" => body["schema"] = json!({ "type": "string" }),
                _ => {}
            }
        }
    }
}

/// Meaning of a status that comes with a problem document.
fn meaning(status: &str) -> Option<&'static str> {
    Some(match status {
        "400" => "Malformed request",
        "401" => "A valid API key is required",
        "403" => "The key lacks the scope, or the request comes from a page of another site or names an unknown host",
        "404" => "The resource does not exist, or belongs to another tenant",
        "408" => "The body arrived too slowly",
        "409" => "Not possible in the current state",
        "412" => "If-Match names another version",
        "413" => "The body is too large",
        "415" => "Unsupported media type",
        "416" => "The range is outside of the file",
        "422" => "Understood, but impossible",
        "429" => "Too many requests; retry after the time in Retry-After",
        "500" => "The service failed; its log has the instance of the problem",
        "503" => "Busy or stopping; retry after the time in Retry-After",
        "507" => "The disk or the quota of the tenant is full",
        "default" => "Any other error",
        _ => return None,
    })
}

/// Operations that take the id of a newly created resource; a new session can also become a job.
fn links(paths: &BTreeMap<String, Map<String, Value>>, kind: &str) -> Value {
    let mut links = Map::new();
    let prefix = format!("/v1/{kind}s/{{id}}");
    for (_, methods) in paths.iter().filter(|(path, _)| path.starts_with(&prefix) && path.matches('{').count() == 1) {
        for id in methods.values().filter_map(|operation| operation["operationId"].as_str()) {
            let parameters = json!({ "id": "$response.body#/id" });
            links.insert(id.to_owned(), json!({ "operationId": id, "parameters": parameters }));
        }
    }
    if kind == "session" {
        let body = json!({ "session": "$response.body#/id" });
        links.insert("createJob".to_owned(), json!({ "operationId": "createJob", "requestBody": body }));
    }
    Value::Object(links)
}

/// Answers have no other members than the described ones; flattened members become members of their own.
fn close_answers(schemas: &mut Value) {
    let named = schemas.clone();
    let resolved = |part: &Value| {
        let target = part["$ref"].as_str().and_then(|reference| named.get(reference.rsplit('/').next()?));
        target.unwrap_or(part).clone()
    };
    for (name, schema) in schemas.as_object_mut().into_iter().flatten() {
        if let Some(parts) = schema.as_object_mut().and_then(|schema| schema.remove("allOf")) {
            let parts: Vec<Value> = parts.as_array().into_iter().flatten().map(resolved).collect();
            let members = |key: &str| parts.iter().map(|part| part[key].clone()).collect::<Vec<_>>();
            let properties: Map<String, Value> =
                members("properties").iter().flat_map(|p| p.as_object().cloned().into_iter().flatten()).collect();
            let required: Vec<Value> =
                members("required").iter().flat_map(|r| r.as_array().cloned().into_iter().flatten()).collect();
            schema["type"] = json!("object");
            (schema["properties"], schema["required"]) = (json!(properties), json!(required));
        }
        if schema.get("properties").is_some() && name != "SessionDocument" {
            schema["additionalProperties"] = json!(false);
        }
    }
}

fn html(paths: &BTreeMap<String, Map<String, Value>>, schemas: &Value) -> String {
    let mut rows = String::new();
    for (path, methods) in paths {
        for (method, operation) in methods {
            let statuses = operation["responses"].as_object().into_iter().flat_map(|responses| responses.keys());
            let (refusals, answers): (Vec<&str>, Vec<&str>) =
                statuses.map(String::as_str).partition(|status| meaning(status).is_some());
            let [method, path] = [&method.to_uppercase(), path].map(|text| escaped(text));
            let summary = escaped(operation["summary"].as_str().unwrap_or_default());
            let (answers, refusals) = (answers.join(", "), refusals.join(", "));
            let _ = writeln!(
                rows,
                "<tr><td><code>{method} {path}</code></td><td>{summary}</td><td>{answers}</td><td>{refusals}</td></tr>"
            );
        }
    }
    let mut types = String::new();
    for (name, schema) in schemas.as_object().into_iter().flatten() {
        let text = escaped(&serde_json::to_string_pretty(schema).unwrap_or_default());
        let _ = writeln!(types, "<h3 id=\"{name}\">{name}</h3>\n<pre>{text}</pre>");
    }
    let guide = guide::guide();
    format!(
        "<!doctype html>\n<html lang=\"en\"><meta charset=\"utf-8\"><title>wandless: HTTP API</title>\n\
         <style>body {{ font: 15px/1.5 sans-serif; max-width: 70em; margin: 2em auto; padding: 0 1em }} \
         td, th {{ padding: .3em .8em .3em 0; text-align: left; vertical-align: top }} \
         pre {{ background: #f4f4f4; padding: 1em; overflow: auto }}</style>\n\
         <h1>wandless: HTTP API</h1>\n<p>The same as an OpenAPI 3.1 document: <a href=\"/openapi.json\">openapi.json</a>. \
         Errors are problem documents with a code, a location and a remedy (<a href=\"#Problem\">Problem</a>).</p>\n\
         {guide}<h2>Routes</h2>\n<table><tr><th>Route</th><th>Purpose</th><th>Answers</th><th>Errors</th></tr>\n{rows}</table>\n\
         <h2>Types</h2>\n{types}</html>\n"
    )
}
