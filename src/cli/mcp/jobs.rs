//! What the tools do: calls of the job API.

use super::messages::Progress;
use crate::cli::client::{Client, JobAnswer, WAIT_S};
use crate::cli::output_folder::require_free;
use crate::cli::submit;
use crate::pipeline::Options;
use crate::pipeline::option_reference::options_document;
use crate::session::parser_errors::in_json_words;
use serde_json::{Map, Value, json};
use std::path::Path;
use std::time::{Duration, Instant};

/// Longest time for which [`follow`] waits, s.
const MAX_WAIT_S: f64 = 600.0;

/// The wait of [`follow`] where none is given, s.
const USUAL_WAIT_S: f64 = 60.0;

type Arguments = Map<String, Value>;

pub(super) fn submit(client: &Client, arguments: &Arguments, progress: Progress) -> anyhow::Result<Value> {
    let options = arguments.get("options").cloned().unwrap_or_else(|| json!({}));
    let refused = |error: serde_json::Error| {
        anyhow::anyhow!("the options are refused: {}; list_options describes them", in_json_words(&error))
    };
    let options: Options = serde_json::from_value(options).map_err(refused)?;
    progress(0.0, "uploading the session");
    let job = submit::submit_job(client, Path::new(text(arguments, "session")), &options)?;
    Ok(described(&job))
}

pub(super) fn correct(client: &Client, arguments: &Arguments, _: Progress) -> anyhow::Result<Value> {
    let corrections = arguments.get("corrections").cloned().unwrap_or_default();
    let body = json!({ "corrects": text(arguments, "job"), "options": { "corrections": corrections } });
    Ok(described(&client.create_job_of(&body)?))
}

pub(super) fn options(_: &Client, _: &Arguments, _: Progress) -> anyhow::Result<Value> {
    Ok(json!({ "options": options_document() }))
}

pub(super) fn list(client: &Client, arguments: &Arguments, _: Progress) -> anyhow::Result<Value> {
    let state = arguments.get("state").and_then(Value::as_str).unwrap_or_default();
    anyhow::ensure!(state.bytes().all(|b| b.is_ascii_lowercase()), "{state:?} is not a state of a job");
    let page: Value = client.document_at(&format!("/v1/jobs?page_size=20&state={state}"))?;
    let short = |job: &Value| json!({ "job": job["id"], "state": job["state"], "session": job["session"], "created_at": job["created_at"] });
    Ok(json!({ "jobs": page["jobs"].as_array().into_iter().flatten().map(short).collect::<Vec<_>>() }))
}

pub(super) fn follow(client: &Client, arguments: &Arguments, progress: Progress) -> anyhow::Result<Value> {
    let wait_s = arguments.get("wait_s").and_then(Value::as_f64).unwrap_or(USUAL_WAIT_S).clamp(0.0, MAX_WAIT_S);
    let deadline = Instant::now() + Duration::from_secs_f64(wait_s);
    loop {
        let left_s = deadline.saturating_duration_since(Instant::now()).as_secs();
        let job = client.wait_for_job(checked_id(text(arguments, "job"))?, left_s.min(WAIT_S))?;
        progress(job.progress.fraction, &job.progress.message);
        if job.is_final() || left_s == 0 {
            return Ok(described(&job));
        }
    }
}

pub(super) fn cancel(client: &Client, arguments: &Arguments, _: Progress) -> anyhow::Result<Value> {
    let job: JobAnswer = client.send_document(&path(arguments, "/cancel")?, &json!({}))?;
    Ok(described(&job))
}

pub(super) fn report(client: &Client, arguments: &Arguments, _: Progress) -> anyhow::Result<Value> {
    let report: Value = client.document_at(&path(arguments, "/report")?)?;
    let cameras: Value = client.document_at(&path(arguments, "/cameras")?)?;
    let of_camera = |camera: &Value| {
        chosen(camera, &["id", "status", "position", "reprojection_px", "sigma_position_mm", "sigma_angle_deg"])
    };
    let of_person = |person: &Value| {
        let names =
            ["id", "name", "first_frame", "last_frame", "n_detections", "reprojection_px", "joint_sigma_mm", "body"];
        chosen(person, &names)
    };
    let rows = |document: &Value, of_row: &dyn Fn(&Value) -> Value| -> Vec<Value> {
        document.as_array().into_iter().flatten().map(of_row).collect()
    };
    Ok(json!({
        "verdict": report["quality"]["verdict"],
        "reasons": report["quality"]["reasons"],
        "cameras": rows(&cameras["cameras"], &of_camera),
        "people": rows(&report["people"], &of_person),
        "scale": report["scale"],
        "heldout_px": report["heldout_px"],
        "suspicions": report["suspicions"],
    }))
}

pub(super) fn export(client: &Client, arguments: &Arguments, _: Progress) -> anyhow::Result<Value> {
    let formats = arguments.get("formats").cloned().unwrap_or_default();
    let manifest: Value = client.send_document(&path(arguments, "/exports")?, &json!({ "exports": formats }))?;
    let names = manifest["files"].as_array().into_iter().flatten().map(|file| file["name"].clone());
    Ok(json!({ "files": names.collect::<Vec<_>>() }))
}

pub(super) fn download(client: &Client, arguments: &Arguments, progress: Progress) -> anyhow::Result<Value> {
    let folder = Path::new(text(arguments, "folder"));
    require_free(folder)?;
    progress(0.0, "downloading the result");
    submit::download(client, checked_id(text(arguments, "job"))?, folder)?;
    Ok(json!({ "folder": std::path::absolute(folder)? }))
}

fn described(job: &JobAnswer) -> Value {
    json!({
        "job": job.id,
        "state": job.state,
        "is_final": job.is_final(),
        "stage": job.progress.stage,
        "fraction": job.progress.fraction,
        "message": job.progress.message,
        "error": job.error.as_ref().map(ToString::to_string),
    })
}

/// The fields of an object that it has.
fn chosen(object: &Value, names: &[&str]) -> Value {
    let present = names.iter().filter_map(|name| Some(((*name).to_owned(), object.get(*name)?.clone())));
    Value::Object(present.collect())
}

/// A text argument; `Tool::fault` has checked that it is there.
fn text<'a>(arguments: &'a Arguments, name: &str) -> &'a str {
    arguments.get(name).and_then(Value::as_str).unwrap_or_default()
}

fn path(arguments: &Arguments, part: &str) -> anyhow::Result<String> {
    Ok(format!("/v1/jobs/{}{part}", checked_id(text(arguments, "job"))?))
}

/// A job id without characters that mean something else in a path.
fn checked_id(id: &str) -> anyhow::Result<&str> {
    let is_plain = !id.is_empty() && id.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_');
    anyhow::ensure!(is_plain, "{id:?} is not the id of a job");
    Ok(id)
}
