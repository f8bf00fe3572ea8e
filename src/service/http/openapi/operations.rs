//! Every operation of the API, one entry each.

use serde_json::{Value, json};

/// One method of one route.
pub(super) struct Operation {
    pub(super) method: &'static str,
    pub(super) path: &'static str,
    pub(super) id: &'static str,
    pub(super) tag: &'static str,
    pub(super) summary: &'static str,
    pub(super) parameters: Vec<Value>,
    pub(super) body: Option<Value>,
    /// Answers that are no refusals.
    pub(super) answers: Vec<(u16, Value)>,
    /// Statuses of problem documents that this route has beside those of every route.
    pub(super) refusals: &'static [u16],
    /// Whether it asks for a key where keys are asked for.
    pub(super) needs_key: bool,
}

/// Every operation, in the order of a client's work.
pub(super) fn operations() -> Vec<Operation> {
    let mut all = sessions();
    all.extend(jobs());
    all.extend(results());
    all.extend(webhooks());
    all.extend(service());
    all
}

fn sessions() -> Vec<Operation> {
    let tag = "sessions";
    let upload = || {
        let binary = || json!({ "schema": {} });
        json!({ "required": true, "content": {
            "application/zip": binary(),
            "application/x-ndjson": binary(),
            "application/json": {
                "schema": { "$ref": "#/components/schemas/SessionDocument" }, "example": example_session() },
            "multipart/form-data": { "schema": {
                "type": "object", "required": ["session"], "additionalProperties": false,
                "properties": { "session": { "type": "string", "contentMediaType": "application/octet-stream" } } } },
        } })
    };
    let session = "Session";
    vec![
        Operation {
            body: Some(upload()),
            answers: vec![
                (201, linked(located(document("A new session", session)), &OF_SESSION)),
                (200, located(document("The same bytes were known", session))),
            ],
            refusals: &[400, 408, 413, 415, 422, 507],
            ..operation("post", "/v1/sessions", "createSession", tag, "Upload a session")
        },
        Operation {
            parameters: page_parameters(),
            answers: vec![(200, document("A page, newest first", "SessionPage"))],
            refusals: &[400],
            ..operation("get", "/v1/sessions", "listSessions", tag, "List sessions")
        },
        Operation {
            parameters: vec![id("session")],
            answers: vec![(200, document("The session", session))],
            refusals: &[400, 404],
            ..operation("get", "/v1/sessions/{id}", "getSession", tag, "Look at a session")
        },
        Operation {
            parameters: vec![id("session")],
            answers: vec![(204, json!({ "description": "It is gone" }))],
            refusals: &[400, 404, 409],
            ..operation("delete", "/v1/sessions/{id}", "deleteSession", tag, "Remove a session that no job needs")
        },
        Operation {
            parameters: vec![id("session")],
            answers: vec![(200, document("What can be expected", "Inspection"))],
            refusals: &[400, 404, 422],
            ..operation("get", "/v1/sessions/{id}/inspection", "inspectSession", tag, "Judge a session before solving")
        },
    ]
}

fn jobs() -> Vec<Operation> {
    let tag = "jobs";
    let new_job = json!({ "required": true, "content": {
        "application/json": { "schema": { "$ref": "#/components/schemas/NewJob" } },
        "multipart/form-data": { "schema": {
            "type": "object", "required": ["session"], "additionalProperties": false,
            "properties": {
                "session": { "type": "string", "contentMediaType": "application/octet-stream" },
                "options": { "type": "string", "contentMediaType": "application/json", "description": "Options as JSON" },
            } } },
    } });
    let key = json!({ "name": "Idempotency-Key", "in": "header", "required": false,
        "description": "The same key and request is the same job; with another request 422",
        "schema": { "type": "string", "minLength": 1, "maxLength": 256, "pattern": "^[!-~]+$" } });
    let mut filters = vec![
        query("state", json!({ "type": "string", "enum": STATES_OR_ALL })),
        query("label", json!({ "type": "string", "description": "`key` or `key=value`" })),
    ];
    filters.extend(page_parameters());
    let job = "Job";
    vec![
        Operation {
            parameters: vec![key],
            body: Some(new_job),
            answers: vec![(202, linked(located(document("Accepted: it will reach a final state", job)), &OF_JOB))],
            refusals: &[400, 404, 408, 409, 413, 415, 422, 507],
            ..operation("post", "/v1/jobs", "createJob", tag, "Submit a job")
        },
        Operation {
            parameters: filters,
            answers: vec![(200, document("A page, newest first", "JobPage"))],
            refusals: &[400],
            ..operation("get", "/v1/jobs", "listJobs", tag, "List jobs")
        },
        Operation {
            parameters: vec![
                id("job"),
                query(
                    "wait",
                    json!({ "type": "number", "minimum": 0,
                        "description": "Seconds to hold the answer until the job differs from If-None-Match; 60 at most" }),
                ),
                json!({ "name": "If-None-Match", "in": "header", "required": false, "schema": { "type": "string" } }),
            ],
            answers: vec![(200, tagged(document("The job", job))), (304, json!({ "description": "Unchanged" }))],
            refusals: &[400, 404],
            ..operation("get", "/v1/jobs/{id}", "getJob", tag, "Look at a job, or wait for it")
        },
        Operation {
            parameters: vec![id("job")],
            answers: vec![(204, json!({ "description": "It is gone; a running one is stopped" }))],
            refusals: &[400, 404],
            ..operation("delete", "/v1/jobs/{id}", "deleteJob", tag, "Remove a job and its files")
        },
        Operation {
            parameters: vec![id("job")],
            answers: vec![(
                200,
                json!({ "description": "Events `state`, `progress` and `log` until the final state",
                "content": { "text/event-stream": { "schema": { "type": "string" } } } }),
            )],
            refusals: &[400, 404],
            ..operation("get", "/v1/jobs/{id}/events", "followJob", tag, "Follow a job")
        },
        Operation {
            parameters: vec![id("job")],
            answers: vec![(202, document("It stops within 2 s", job))],
            refusals: &[400, 404, 409],
            ..operation("post", "/v1/jobs/{id}/cancel", "cancelJob", tag, "Stop a job")
        },
    ]
}

fn results() -> Vec<Operation> {
    let tag = "results";
    let of_file = |path, id_, summary, media_type: &str, schema: Value| Operation {
        parameters: vec![id("job")],
        answers: vec![
            (200, tagged(json!({ "description": "The file", "content": { media_type: { "schema": schema } } }))),
            (206, json!({ "description": "The range asked for" })),
            (304, json!({ "description": "Unchanged" })),
        ],
        refusals: &[400, 404, 409, 416, 500],
        ..operation("get", path, id_, tag, summary)
    };
    let json_file = |path, id, summary| of_file(path, id, summary, "application/json", json!({ "type": "object" }));
    let mut artifact =
        of_file("/v1/jobs/{id}/artifacts/{name}", "getArtifact", "One file of the result", "*/*", json!({}));
    artifact.parameters.push(json!({ "name": "name", "in": "path", "required": true, "schema": { "type": "string" },
        "description": "As the manifest has it; may hold slashes" }));
    vec![
        json_file("/v1/jobs/{id}/result", "getResult", "The manifest: every file with its digest"),
        artifact,
        json_file("/v1/jobs/{id}/cameras", "getCameras", "`cameras.json`"),
        json_file("/v1/jobs/{id}/people", "getPeople", "`people.json`"),
        json_file("/v1/jobs/{id}/report", "getReport", "`report.json`"),
    ]
}

fn webhooks() -> Vec<Operation> {
    let tag = "webhooks";
    vec![
        Operation {
            parameters: vec![id("job")],
            answers: vec![(200, document("Oldest first", "DeliveryList"))],
            refusals: &[400, 404],
            ..operation("get", "/v1/jobs/{id}/deliveries", "listDeliveries", tag, "What became of a job's webhooks")
        },
        Operation {
            parameters: vec![
                id("job"),
                json!({ "name": "delivery", "in": "path", "required": true,
                "schema": { "type": "string", "pattern": "^delivery_[0-9a-f]{32}$" } }),
            ],
            answers: vec![(202, document("It is made again at once", "Delivery"))],
            refusals: &[400, 404],
            ..operation(
                "post",
                "/v1/jobs/{id}/deliveries/{delivery}/redeliver",
                "redeliver",
                tag,
                "Make a call once more",
            )
        },
        Operation {
            answers: vec![(200, document("`whsec_…`", "WebhookSecret"))],
            ..operation("get", "/v1/webhook-secret", "getWebhookSecret", tag, "What signs the caller's webhooks")
        },
    ]
}

fn service() -> Vec<Operation> {
    let tag = "service";
    let open = |path, id, summary, media_type: &str, refusals| Operation {
        answers: vec![(200, json!({ "description": "Yes", "content": { media_type: { "schema": {} } } }))],
        refusals,
        needs_key: false,
        ..operation("get", path, id, tag, summary)
    };
    vec![
        open("/healthz", "isAlive", "The process answers", "application/json", &[]),
        open("/readyz", "isReady", "Work can be accepted", "application/json", &[503]),
        open("/openapi.json", "getDescription", "This description", "application/json", &[]),
        open("/docs", "getDocs", "The description for people", "text/html", &[]),
        Operation {
            needs_key: true,
            ..open("/metrics", "getMetrics", "Metrics for Prometheus", "application/openmetrics-text", &[])
        },
    ]
}

/// States of a job.
pub(super) const STATES: [&str; 7] = ["queued", "running", "canceling", "succeeded", "failed", "canceled", "dead"];

/// As a filter; an empty one filters nothing.
const STATES_OR_ALL: [&str; 8] = ["", "queued", "running", "canceling", "succeeded", "failed", "canceled", "dead"];

fn operation(
    method: &'static str,
    path: &'static str,
    id: &'static str,
    tag: &'static str,
    summary: &'static str,
) -> Operation {
    let (parameters, answers) = (Vec::new(), Vec::new());
    Operation { method, path, id, tag, summary, parameters, body: None, answers, refusals: &[], needs_key: true }
}

fn document(description: &str, schema: &str) -> Value {
    let schema = json!({ "$ref": format!("#/components/schemas/{schema}") });
    json!({ "description": description, "content": { "application/json": { "schema": schema } } })
}

fn located(mut answer: Value) -> Value {
    answer["headers"]["Location"] = json!({ "schema": { "type": "string" }, "description": "Where it lies" });
    answer
}

/// Operations on what was just made.
const OF_SESSION: [&str; 3] = ["getSession", "inspectSession", "deleteSession"];
const OF_JOB: [&str; 9] = [
    "getJob",
    "getResult",
    "getCameras",
    "getPeople",
    "getReport",
    "listDeliveries",
    "followJob",
    "cancelJob",
    "deleteJob",
];

/// Says which operations take the id of the answer; a new session is also what a job is made of.
fn linked(mut answer: Value, operations: &[&str]) -> Value {
    for operation in operations {
        let parameters = json!({ "id": "$response.body#/id" });
        answer["links"][*operation] = json!({ "operationId": operation, "parameters": parameters });
    }
    if operations.contains(&"getSession") {
        let body = json!({ "session": "$response.body#/id" });
        answer["links"]["createJob"] = json!({ "operationId": "createJob", "requestBody": body });
    }
    answer
}

/// One person before two cameras, in one frame.
fn example_session() -> Value {
    let keypoints: Vec<Value> =
        (0..17).map(|i| json!([600.0 + f64::from(i % 2) * 40.0, 100.0 + 30.0 * f64::from(i), 0.9])).collect();
    let camera = |id: &str| {
        let k = json!([[900.0, 0.0, 640.0], [0.0, 900.0, 360.0], [0.0, 0.0, 1.0]]);
        json!({ "id": id, "width": 1280, "height": 720, "K": k, "dist": [0.0, 0.0, 0.0, 0.0, 0.0] })
    };
    let poses = json!({ "frames": [{ "frame": 0, "people": [{ "track_id": null, "keypoints": keypoints }] }] });
    json!({
        "name": "example", "fps": 25.0, "n_frames": 1, "keypoint_convention": "coco17",
        "cameras": [camera("left"), camera("right")], "poses": { "left": poses, "right": poses },
    })
}

fn tagged(mut answer: Value) -> Value {
    answer["headers"]["ETag"] = json!({ "schema": { "type": "string" } });
    answer
}

fn id(kind: &str) -> Value {
    json!({ "name": "id", "in": "path", "required": true, "description": format!("Id of the {kind}"),
        "schema": { "type": "string", "pattern": format!("^{kind}_[0-9a-f]{{32}}$") } })
}

fn query(name: &str, schema: Value) -> Value {
    json!({ "name": name, "in": "query", "required": false, "schema": schema })
}

fn page_parameters() -> Vec<Value> {
    vec![
        query(
            "page_size",
            json!({ "type": "integer", "minimum": 0, "maximum": i64::MAX, "default": 50,
                "description": "More than 500 are 500" }),
        ),
        query(
            "page_token",
            json!({ "type": "string", "pattern": "^(s[0-9a-f]{1,15})?$",
            "description": "`next_page_token` of the page before" }),
        ),
    ]
}
