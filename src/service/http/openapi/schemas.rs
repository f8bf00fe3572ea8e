//! What is sent and answered, as JSON Schema (2020-12).

use super::operations::STATES;
use serde_json::{Value, json};

/// Every schema by its name.
pub(super) fn schemas() -> Value {
    json!({
        "Problem": problem(),
        "SessionDocument": session_document(),
        "Session": session(),
        "SessionPage": page("sessions", "Session"),
        "Inspection": inspection(),
        "NewJob": new_job(),
        "Options": options(),
        "Job": job(),
        "JobPage": page("jobs", "Job"),
        "Progress": progress(),
        "Quality": quality(),
        "JobError": job_error(),
        "Delivery": delivery(),
        "DeliveryList": {
            "type": "object", "required": ["deliveries"], "additionalProperties": false,
            "properties": { "deliveries": { "type": "array", "items": of("Delivery") } },
        },
        "WebhookSecret": {
            "type": "object", "required": ["secret"], "additionalProperties": false,
            "properties": { "secret": { "type": "string", "pattern": "^whsec_" } },
        },
    })
}

fn of(name: &str) -> Value {
    json!({ "$ref": format!("#/components/schemas/{name}") })
}

fn or_null(name: &str) -> Value {
    json!({ "oneOf": [of(name), { "type": "null" }] })
}

fn text() -> Value {
    json!({ "type": "string" })
}

fn texts() -> Value {
    json!({ "type": "array", "items": { "type": "string" } })
}

fn time() -> Value {
    json!({ "type": "string", "format": "date-time" })
}

fn time_or_null() -> Value {
    json!({ "type": ["string", "null"], "format": "date-time" })
}

fn count() -> Value {
    json!({ "type": "integer", "minimum": 0 })
}

fn page(items: &str, schema: &str) -> Value {
    json!({
        "type": "object", "required": [items, "next_page_token"], "additionalProperties": false,
        "properties": {
            items: { "type": "array", "items": of(schema) },
            "next_page_token": { "type": ["string", "null"], "description": "null on the last page" },
        },
    })
}

fn problem() -> Value {
    json!({
        "type": "object", "description": "RFC 9457",
        "required": ["type", "title", "status", "detail", "instance", "code", "remedy"],
        "additionalProperties": false,
        "properties": {
            "type": text(), "title": text(), "status": { "type": "integer", "minimum": 400, "maximum": 599 },
            "detail": text(), "instance": text(),
            "code": { "type": "string", "description": "For machines" },
            "remedy": { "type": "string", "description": "What to do" },
            "file": text(), "camera": text(), "frame": { "type": "integer" }, "person": count(), "pointer": text(),
        },
    })
}

fn session_document() -> Value {
    json!({
        "type": "object", "description": "A session in one document; the README has the layout",
        "required": ["cameras", "poses", "fps", "keypoint_convention"],
        "properties": {
            "name": {}, "fps": { "type": "number" }, "n_frames": { "type": ["integer", "null"], "minimum": 0 }, "keypoint_convention": text(),
            "cameras": { "type": "array", "items": { "type": "object" } }, "poses": { "type": "object" },
        },
    })
}

fn session() -> Value {
    json!({
        "type": "object", "additionalProperties": false,
        "required": ["id", "name", "sha256", "cameras", "frames", "people_max", "keypoint_convention", "format",
            "warnings", "bytes", "camera_facts", "created_at"],
        "properties": {
            "id": text(), "name": text(), "sha256": text(), "cameras": count(), "frames": count(),
            "people_max": count(), "keypoint_convention": text(), "format": text(), "warnings": texts(),
            "bytes": count(), "created_at": time(),
            "camera_facts": { "type": "array", "items": {
                "type": "object", "required": ["id", "has_extrinsics"], "additionalProperties": false,
                "properties": { "id": text(), "has_extrinsics": { "type": "boolean" } } } },
        },
    })
}

fn inspection() -> Value {
    let number_or_null = json!({ "type": ["number", "null"] });
    json!({
        "type": "object", "additionalProperties": false,
        "required": ["cameras", "pairs", "groups", "findings", "expected"],
        "properties": {
            "cameras": { "type": "array", "items": { "type": "object", "additionalProperties": false,
                "required": ["id", "frames_with_people", "detections", "distance_m"],
                "properties": { "id": text(), "frames_with_people": count(), "detections": count(),
                    "distance_m": number_or_null } } },
            "pairs": { "type": "array", "items": { "type": "object", "additionalProperties": false,
                "required": ["cameras", "frames_together", "baseline_m"],
                "properties": { "cameras": texts(), "frames_together": count(), "baseline_m": number_or_null } } },
            "groups": { "type": "array", "items": texts() },
            "findings": { "type": "array", "items": { "type": "object", "additionalProperties": false,
                "required": ["code", "detail", "cameras"],
                "properties": {
                    "code": { "enum": ["split", "few_frames", "no_person", "static", "tiny_baseline", "collinear"] },
                    "detail": text(), "cameras": texts() } } },
            "expected": { "type": "object", "additionalProperties": false,
                "required": ["joint_error_mm", "solve_s", "cameras_per_person"],
                "properties": { "joint_error_mm": number_or_null, "solve_s": { "type": "number" },
                    "cameras_per_person": { "type": "number" } } },
        },
    })
}

fn new_job() -> Value {
    json!({
        "type": "object", "required": ["session"], "additionalProperties": false,
        "properties": {
            "session": { "type": "string", "description": "Id of the session" },
            "options": or_null("Options"),
            "labels": { "type": "object", "maxProperties": 32, "propertyNames": { "minLength": 1, "maxLength": 256 },
                "additionalProperties": { "type": "string", "maxLength": 256 } },
            "priority": { "type": "integer", "minimum": -1000, "maximum": 1000, "default": 0,
                "description": "Higher runs first, among the tenant's own jobs" },
            "webhook": { "oneOf": [{ "type": "null" }, {
                "type": "object", "required": ["url"], "additionalProperties": false,
                "properties": { "url": { "type": "string", "format": "uri", "maxLength": 2000 } } }] },
        },
    })
}

fn options() -> Value {
    let choice = |values: &[&str], default: &str| json!({ "enum": values, "default": default });
    let flag = json!({ "type": "boolean", "default": true });
    json!({
        "type": "object", "additionalProperties": false,
        "properties": {
            "people": { "type": ["integer", "null"], "minimum": 1, "default": null, "description": "How many, where known" },
            "extrinsics": choice(&["estimate", "fixed", "refine"], "estimate"),
            "intrinsics": choice(&["fixed", "refine_focal"], "fixed"),
            "scale": scale(),
            "up_axis": choice(&["y", "z"], "y"),
            "denoise": flag, "motion_prior": flag, "collision": flag,
            "body": { "type": "string", "default": "default" },
            "sync": choice(&["given", "estimate"], "given"),
            "seed": { "type": "integer", "minimum": 0, "default": 0 },
            "exports": { "type": "array", "default": ["smpl_npz"], "items": { "enum": [
                "smpl_npz", "easymocap", "glb", "bvh", "usd", "trc", "c3d", "opencv_yaml", "calib_toml", "anipose_toml",
                "colmap", "chan", "blender"] } },
        },
    })
}

fn scale() -> Value {
    let metres = json!({ "type": "number", "exclusiveMinimum": 0 });
    let variant = |from: &str, required: &[&str], properties: Value| {
        let mut properties = properties;
        properties["from"] = json!({ "const": from });
        json!({ "type": "object", "required": required, "additionalProperties": false, "properties": properties })
    };
    json!({ "default": { "from": "body" }, "oneOf": [
        variant("body", &["from"], json!({})),
        variant("height", &["from", "metres", "who"], json!({ "metres": metres, "who": { "type": "string" } })),
        variant("camera_distance", &["from", "metres", "cameras"], json!({ "metres": metres,
            "cameras": { "type": "array", "items": { "type": "string" }, "minItems": 2, "maxItems": 2 } })),
    ] })
}

fn job() -> Value {
    json!({
        "type": "object", "additionalProperties": false,
        "required": ["id", "state", "session", "options", "labels", "priority", "created_at", "started_at", "finished_at",
            "attempt", "progress", "stage_seconds", "quality", "error", "solver_version", "links"],
        "properties": {
            "id": text(), "state": { "enum": STATES }, "session": text(), "options": of("Options"),
            "labels": { "type": "object", "additionalProperties": text() }, "priority": { "type": "integer" },
            "created_at": time(), "started_at": time_or_null(), "finished_at": time_or_null(),
            "attempt": count(), "progress": of("Progress"),
            "stage_seconds": { "type": "object", "additionalProperties": { "type": "number", "minimum": 0 } },
            "quality": or_null("Quality"), "error": or_null("JobError"),
            "solver_version": { "type": ["string", "null"] },
            "links": { "type": "object", "additionalProperties": text() },
        },
    })
}

fn progress() -> Value {
    json!({
        "type": "object", "additionalProperties": false,
        "required": ["stage", "stage_index", "stage_count", "fraction", "message", "eta_s"],
        "properties": {
            "stage": text(), "stage_index": count(), "stage_count": count(),
            "fraction": { "type": "number", "minimum": 0, "maximum": 1, "description": "Never falls" },
            "message": text(), "eta_s": { "type": ["number", "null"] },
        },
    })
}

fn quality() -> Value {
    json!({
        "type": "object", "required": ["verdict", "reasons"], "additionalProperties": false,
        "properties": { "verdict": { "enum": ["pass", "warn", "reject"] }, "reasons": texts() },
    })
}

fn job_error() -> Value {
    json!({
        "type": "object", "required": ["code", "detail"], "additionalProperties": false,
        "properties": { "code": text(), "detail": text(), "remedy": text(), "camera": text(),
            "frame": { "type": "integer" }, "person": count(), "pointer": text() },
    })
}

fn delivery() -> Value {
    json!({
        "type": "object", "additionalProperties": false,
        "required": ["id", "event", "url", "state", "tries", "last_status", "last_error", "created_at", "updated_at"],
        "properties": {
            "id": { "type": "string", "description": "The receiver's `webhook-id`" },
            "event": { "enum": ["job.succeeded", "job.failed", "job.canceled", "job.dead"] },
            "url": text(), "state": { "enum": ["waiting", "delivered", "failed"] }, "tries": count(),
            "last_status": { "type": ["integer", "null"] }, "last_error": { "type": ["string", "null"] },
            "created_at": time(), "updated_at": time(),
        },
    })
}
