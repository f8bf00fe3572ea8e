//! `GET /openapi.json` (OpenAPI 3.1) and `GET /docs`: the API described out of one table, checked against the router by a
//! test and against the checked-in `openapi/openapi.json` by another.

mod operations;
mod schemas;

use axum::http::header;
use axum::response::{Html, IntoResponse, Response};
use operations::{Operation, operations};
use serde_json::{Map, Value, json};
use std::sync::LazyLock;

/// The whole description.
pub fn document() -> Value {
    let mut paths = Map::new();
    for operation in operations() {
        let methods = paths.entry(operation.path.to_owned()).or_insert_with(|| json!({}));
        methods[operation.method] = described(&operation);
    }
    json!({
        "openapi": "3.1.0",
        "info": {
            "title": "wandless",
            "version": env!("CARGO_PKG_VERSION"),
            "description": "Moving people and the cameras that filmed them, recovered together. Upload a session, submit a \
                job, follow it, fetch the result. Once a job was answered 202 it reaches exactly one final state and at \
                most one published result.",
            "license": { "name": "MIT OR Apache-2.0", "identifier": "MIT OR Apache-2.0" },
        },
        "servers": [{ "url": "/" }],
        "paths": paths,
        "components": {
            "schemas": schemas::schemas(),
            "securitySchemes": {
                "key": { "type": "http", "scheme": "bearer", "description": "An API key; asked for once one was made" },
                "browser": { "type": "http", "scheme": "basic", "description": "The same key as the password" },
            },
        },
    })
}

/// The description as it is checked in.
pub fn text() -> String {
    serde_json::to_string_pretty(&document()).expect("a document of strings and numbers always serialises")
}

static TEXT: LazyLock<String> = LazyLock::new(text);

/// `GET /openapi.json`.
pub(super) async fn document_route() -> Response {
    ([(header::CONTENT_TYPE, "application/json")], TEXT.as_str()).into_response()
}

static PAGE: LazyLock<String> = LazyLock::new(written_page);

/// `GET /docs`: the description for people; one page without scripts.
pub(super) async fn page() -> Response {
    let policy = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; frame-ancestors 'none'";
    ([(header::CONTENT_SECURITY_POLICY, policy), (header::X_CONTENT_TYPE_OPTIONS, "nosniff")], Html(PAGE.as_str()))
        .into_response()
}

fn described(operation: &Operation) -> Value {
    let mut described = json!({
        "operationId": operation.id,
        "summary": operation.summary,
        "tags": [operation.tag],
        "responses": {},
    });
    if !operation.parameters.is_empty() {
        described["parameters"] = Value::Array(operation.parameters.clone());
    }
    if let Some(body) = &operation.body {
        described["requestBody"] = body.clone();
    }
    if operation.needs_key {
        described["security"] = json!([{}, { "key": [] }, { "browser": [] }]);
    }
    for (status, answer) in &operation.answers {
        described["responses"][status.to_string()] = answer.clone();
    }
    let refusal = |description: &str| {
        let schema = json!({ "$ref": "#/components/schemas/Problem" });
        json!({ "description": description, "content": { "application/problem+json": { "schema": schema } } })
    };
    for status in operation.refusals {
        described["responses"][status.to_string()] = refusal(meaning(*status));
    }
    if operation.needs_key {
        for status in [401, 403, 429, 503] {
            described["responses"][status.to_string()] = refusal(meaning(status));
        }
    }
    described["responses"]["default"] = refusal("Any other error");
    described
}

/// What a status says of a request.
fn meaning(status: u16) -> &'static str {
    match status {
        400 => "Malformed",
        401 => "A valid key is needed",
        403 => "The key lacks the scope, or a page of another site asks",
        404 => "There is none, or it is another tenant's",
        408 => "The body came too slowly",
        409 => "Not in this state",
        413 => "Too large",
        415 => "Unsupported media type",
        416 => "The range lies outside of the file",
        422 => "Understood, but impossible",
        429 => "Too many; Retry-After says when to come back",
        503 => "Busy, or stopping; Retry-After says when to come back",
        507 => "The disk or the tenant's quota is full",
        _ => "The service failed; the instance stands in its log",
    }
}

fn written_page() -> String {
    let mut rows = String::new();
    for operation in operations() {
        let answers: Vec<String> = operation.answers.iter().map(|(status, _)| status.to_string()).collect();
        let refusals: Vec<String> = operation.refusals.iter().map(u16::to_string).collect();
        rows.push_str(&format!(
            "<tr><td><code>{} {}</code></td><td>{}</td><td>{}</td><td>{}</td></tr>\n",
            operation.method.to_uppercase(),
            escaped(operation.path),
            escaped(operation.summary),
            answers.join(", "),
            refusals.join(", "),
        ));
    }
    let mut things = String::new();
    for (name, schema) in schemas::schemas().as_object().into_iter().flatten() {
        let text = serde_json::to_string_pretty(schema).unwrap_or_default();
        things.push_str(&format!("<h3 id=\"{name}\">{name}</h3>\n<pre>{}</pre>\n", escaped(&text)));
    }
    format!(
        "<!doctype html>\n<html lang=\"en\"><meta charset=\"utf-8\"><title>wandless: HTTP API</title>\n\
         <style>body {{ font: 15px/1.5 sans-serif; max-width: 70em; margin: 2em auto; padding: 0 1em }} \
         td, th {{ padding: .3em .8em .3em 0; text-align: left; vertical-align: top }} \
         pre {{ background: #f4f4f4; padding: 1em; overflow: auto }}</style>\n\
         <h1>wandless: HTTP API</h1>\n<p>For machines: <a href=\"/openapi.json\">openapi.json</a> (OpenAPI 3.1). Errors are \
         problem documents with a code, a place and a remedy (<a href=\"#Problem\">Problem</a>).</p>\n\
         <table><tr><th>Route</th><th>Does</th><th>Answers</th><th>Refuses</th></tr>\n{rows}</table>\n\
         <h2>What is sent and answered</h2>\n{things}</html>\n"
    )
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::Options;
    use std::collections::BTreeSet;

    #[test]
    fn the_table_describes_every_route_and_no_other() {
        let plain = |path: &str| path.replace("{*", "{");
        let routes: BTreeSet<String> = super::super::api()
            .iter()
            .map(|(path, _)| plain(path))
            .chain(super::super::open().iter().map(|(path, _)| plain(path)))
            .chain(["/metrics".to_owned()])
            .collect();
        let described: BTreeSet<String> = operations().iter().map(|operation| operation.path.to_owned()).collect();
        assert_eq!(described, routes);
    }

    #[test]
    fn the_checked_in_description_is_this_one() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/openapi/openapi.json");
        let kept = std::fs::read_to_string(file).unwrap();
        assert!(kept.trim() == text().trim(), "write it anew: wandless openapi > openapi/openapi.json");
    }

    #[test]
    fn every_reference_leads_somewhere_and_every_id_is_its_own() {
        fn references(value: &Value, found: &mut Vec<String>) {
            match value {
                Value::Object(map) => {
                    found.extend(map.get("$ref").and_then(Value::as_str).map(str::to_owned));
                    map.values().for_each(|value| references(value, found));
                }
                Value::Array(list) => list.iter().for_each(|value| references(value, found)),
                _ => {}
            }
        }
        let document = document();
        let mut found = Vec::new();
        references(&document, &mut found);
        assert!(!found.is_empty());
        for reference in found {
            assert!(document.pointer(reference.trim_start_matches('#')).is_some(), "{reference}");
        }
        let ids: BTreeSet<&str> = operations().iter().map(|operation| operation.id).collect();
        assert_eq!(ids.len(), operations().len());
    }

    #[test]
    fn the_described_options_are_those_of_the_pipeline() {
        let described = document();
        let described = described["components"]["schemas"]["Options"]["properties"].as_object().unwrap();
        let known = serde_json::to_value(Options::default()).unwrap();
        let names = |map: &Map<String, Value>| map.keys().cloned().collect::<BTreeSet<_>>();
        assert_eq!(names(described), names(known.as_object().unwrap()));
        for (name, value) in known.as_object().unwrap() {
            assert_eq!(&described[name]["default"], value, "{name}");
        }
        let exports = described["exports"]["items"]["enum"].as_array().unwrap();
        let all = serde_json::json!({ "exports": exports });
        assert_eq!(serde_json::from_value::<Options>(all).unwrap().exports.len(), exports.len());
    }
}
