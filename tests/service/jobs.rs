//! Jobs: submit, idempotency, wait, list, cancel, delete.

use crate::http::{FORM, JSON, form};
use crate::server::Server;
use crate::take::{LONG, take, zipped};
use serde_json::{Value, json};
use std::process::Command;
use std::time::{Duration, Instant};

#[test]
fn job_succeeds() {
    let server = Server::start();
    let session = server.upload(20, 1);
    let body =
        json!({ "session": session, "options": { "extrinsics": "fixed" }, "labels": { "take": "7" }, "priority": 3 });
    let accepted = server.post_json("/v1/jobs", &body).expect(202);
    let job = accepted.json();
    let id = job["id"].as_str().unwrap();
    assert_eq!(accepted.header("location"), format!("/v1/jobs/{id}"));
    assert_eq!(job["state"], "queued");
    assert_eq!((&job["session"], &job["labels"]["take"]), (&json!(session), &json!("7")));
    assert_eq!(job["options"]["extrinsics"], "fixed");
    assert_eq!(job["options"]["seed"], 0, "defaults are included");

    let done = server.wait_for_state(id, "succeeded");
    assert_eq!(done["progress"]["fraction"], 1.0);
    assert_eq!(done["attempt"], 1);
    assert!(matches!(done["quality"]["verdict"].as_str(), Some("pass" | "warn" | "reject")));
    assert!(done["quality"]["reasons"].is_array() && done["error"].is_null());
    let report = server.get(&format!("/v1/jobs/{id}/report")).expect(200).json();
    assert!(job["suspicions"] == json!([]) && done["suspicions"].is_array());
    assert_eq!(done["suspicions"], report["suspicions"]);
    assert!(done["stage_seconds"].as_object().unwrap().values().all(|seconds| seconds.as_f64().unwrap() >= 0.0));
    assert!(!done["stage_seconds"].as_object().unwrap().is_empty());
    let times = ["created_at", "started_at", "finished_at"].map(|key| done[key].as_str().unwrap().to_owned());
    assert!(times.is_sorted(), "{times:?}");
    assert!(done["solver_version"].is_string());
}

#[test]
fn one_shot_submission_uploads_and_enqueues() {
    let server = Server::start();
    let zip = zipped(&take(20, 2));
    let body = form(&[("options", br#"{"extrinsics": "fixed", "seed": 5}"#), ("session", &zip)]);
    let job = server.post("/v1/jobs", &[FORM, ("idempotency-key", "k")], &body).expect(202).json();
    assert_eq!(job["options"]["seed"], 5);
    let again = form(&[("session", &zip), ("options", br#"{"seed": 5,   "extrinsics": "fixed"}"#)]);
    let repeated = server.post("/v1/jobs", &[FORM, ("idempotency-key", "k")], &again).expect(202).json();
    assert_eq!(repeated["id"], job["id"], "the same request in another order of parts and keys");
    server.wait_for_state(job["id"].as_str().unwrap(), "succeeded");
}

#[test]
fn repeated_idempotency_key_gives_one_job() {
    let server = Server::start();
    let session = server.upload(10, 1);
    let body = json!({ "session": session }).to_string();
    let ask = || server.post("/v1/jobs", &[JSON, ("idempotency-key", "once")], body.as_bytes()).expect(202).json();
    let mut ids: Vec<Value> = std::thread::scope(|scope| {
        let asked: Vec<_> = (0..20).map(|_| scope.spawn(ask)).collect();
        asked.into_iter().map(|answer| answer.join().unwrap()["id"].clone()).collect()
    });
    ids.dedup();
    assert_eq!(ids.len(), 1);
    assert_eq!(server.get("/v1/jobs").json()["jobs"].as_array().unwrap().len(), 1);
    let other = json!({ "session": session, "priority": 1 }).to_string();
    let refused = server.post("/v1/jobs", &[JSON, ("idempotency-key", "once")], other.as_bytes());
    refused.expect_problem(422, "idempotency_key_reused");
    let id = ids[0].as_str().unwrap();
    server.delete(&format!("/v1/jobs/{id}")).expect(204);
    let late = server.post("/v1/jobs", &[JSON, ("idempotency-key", "once")], body.as_bytes());
    late.expect_problem(409, "job_deleted");
}

#[test]
fn key_gives_its_job_after_the_session_is_deleted() {
    let server = Server::start();
    let session = server.upload(10, 1);
    let body = json!({ "session": session, "options": { "extrinsics": "fixed" } }).to_string();
    let key = [JSON, ("idempotency-key", "once")];
    let job = server.post("/v1/jobs", &key, body.as_bytes()).expect(202).json();
    server.wait_for_state(job["id"].as_str().unwrap(), "succeeded");
    server.delete(&format!("/v1/sessions/{session}")).expect(204);
    let again = server.post("/v1/jobs", &key, body.as_bytes()).expect(202).json();
    assert_eq!((&again["id"], &again["state"]), (&job["id"], &json!("succeeded")));
    let other = json!({ "session": session, "options": { "extrinsics": "fixed", "seed": 1 } }).to_string();
    server.post("/v1/jobs", &key, other.as_bytes()).expect_problem(422, "idempotency_key_reused");
    server.post("/v1/jobs", &[JSON], body.as_bytes()).expect_problem(404, "session_not_found");
}

#[test]
fn wait_ends_on_change_and_unchanged_job_is_304() {
    let server = Server::start();
    let first = server.submit(&server.upload(LONG, 1));
    let waiting = server.submit(&server.upload(10, 2));
    let path = format!("/v1/jobs/{waiting}");
    let tag = server.get(&path).expect(200).header("etag").to_owned();
    server.get_with(&path, &[("if-none-match", &tag)]).expect(304);
    let start = Instant::now();
    server.get_with(&format!("{path}?wait=0.5"), &[("if-none-match", &tag)]).expect(304);
    assert!(start.elapsed() >= Duration::from_millis(500));
    let weak = format!("\"other\", W/{tag}"); // as proxies that compress answers send it
    server.get_with(&path, &[("if-none-match", &weak)]).expect(304);
    server.get_with(&format!("{path}?wait=0.5"), &[("if-none-match", &weak)]).expect(304);
    assert!(start.elapsed() >= Duration::from_secs(1), "a weak tag ended the wait");
    let changed = std::thread::scope(|scope| {
        let held = scope.spawn(|| server.get_with(&format!("{path}?wait=30"), &[("if-none-match", &tag)]));
        std::thread::sleep(Duration::from_millis(300));
        server.post_json(&format!("{path}/cancel"), &Value::Null).expect(202);
        held.join().unwrap().expect(200)
    });
    assert_eq!(changed.json()["state"], "canceled");
    assert!(start.elapsed() < Duration::from_secs(10), "the answer was held although the job had changed");
    server.delete(&format!("/v1/jobs/{first}")).expect(204);
}

#[test]
fn cancel_stops_the_work_within_2_s() {
    let server = Server::start();
    let id = server.submit(&server.upload(LONG, 1));
    server.wait_for_state(&id, "running");
    let path = format!("/v1/jobs/{id}/cancel");
    let start = Instant::now();
    let asked = server.post_json(&path, &Value::Null).expect(202).json();
    assert!(matches!(asked["state"].as_str(), Some("canceling" | "canceled")));
    let done = server.wait_for_state(&id, "canceled");
    assert!(start.elapsed() < Duration::from_secs(2), "the cancel took {:?}", start.elapsed());
    assert_eq!(server.children(), [0; 0]);
    assert_eq!(server.files("results").len(), 0);
    assert!(done["finished_at"].is_string() && done["quality"].is_null());
    server.post_json(&path, &Value::Null).expect(202);
    let early = server.get(&format!("/v1/jobs/{id}/result")).expect_problem(409, "not_ready");
    let remedy = early["remedy"].as_str().unwrap();
    assert!(remedy.contains("submit another job"), "a wait for a job that has ended was advised: {remedy}");
}

#[test]
fn cancel_kills_an_unresponsive_child() {
    let server = Server::start();
    let id = server.submit(&server.upload(LONG, 1));
    server.wait_for_state(&id, "running");
    crate::server::signal(server.child(), rustix::process::Signal::STOP);
    let start = Instant::now();
    server.post_json(&format!("/v1/jobs/{id}/cancel"), &Value::Null).expect(202);
    server.wait_for_state(&id, "canceled");
    assert!(start.elapsed() < Duration::from_secs(2), "the cancel took {:?}", start.elapsed());
}

#[test]
fn deletes_a_job_in_any_state() {
    let server = Server::start();
    let done = server.submit(&server.upload(10, 1));
    server.wait_for_state(&done, "succeeded");
    let running = server.submit(&server.upload(LONG, 2));
    server.wait_for_state(&running, "running");
    for id in [&done, &running] {
        server.delete(&format!("/v1/jobs/{id}")).expect(204);
        server.get(&format!("/v1/jobs/{id}")).expect_problem(404, "not_found");
        server.delete(&format!("/v1/jobs/{id}")).expect_problem(404, "not_found");
    }
    let next = server.submit(&server.upload(10, 3)); // the worker is available again
    server.wait_for_state(&next, "succeeded");
    let left = server.files("results");
    assert!(left.iter().all(|file| file.to_string_lossy().contains(&next)), "{left:?}");
}

#[test]
fn lists_jobs_by_state_label_and_page() {
    let server = Server::start();
    let busy = server.submit(&server.upload(LONG, 1));
    let session = server.upload(10, 2);
    let submit = |label: &str| {
        let body = json!({ "session": session, "labels": { "scene": label } });
        server.post_json("/v1/jobs", &body).expect(202).json()["id"].as_str().unwrap().to_owned()
    };
    let jobs = [submit("a"), submit("b"), submit("a")];
    server.wait_for_state(&busy, "running");
    let list = |query: &str| -> Vec<String> {
        let page = server.get(&format!("/v1/jobs?{query}")).expect(200).json();
        page["jobs"].as_array().unwrap().iter().map(|job| job["id"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(list("state=queued"), [&*jobs[2], &*jobs[1], &*jobs[0]]);
    assert_eq!(list("state=running"), [&*busy]);
    assert_eq!(list("label=scene%3Da"), [&*jobs[2], &*jobs[0]]);
    assert_eq!(list("label=scene"), [&*jobs[2], &*jobs[1], &*jobs[0]]);
    assert_eq!(list("page_size=1"), [&*jobs[2]]);
    server.delete(&format!("/v1/jobs/{busy}")).expect(204);
}

#[test]
fn fits_the_requested_body_model() {
    let server = Server::start();
    let file = server.data().join("own.npz");
    let body = |words: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_wandless"));
        let output = command.arg("body").args(words).output().unwrap();
        assert!(output.status.success(), "{output:?}");
        String::from_utf8(output.stdout).unwrap()
    };
    let (file, data) = (file.to_str().unwrap(), server.data().to_str().unwrap());
    body(&["export", "--out", file]);
    body(&["add", "studio", file, "--data", data]);
    assert!(body(&["list", "--data", data]).starts_with("studio: "));

    let session = server.upload(20, 1);
    let options = |name: &str| json!({ "session": session, "options": { "extrinsics": "fixed", "body": name } });
    let problem = server.post_json("/v1/jobs", &options("other")).expect_problem(422, "option_impossible");
    let detail = problem["detail"].as_str().unwrap();
    assert!(detail.contains("use \"default\" or \"studio\""), "{detail}");
    let job = server.post_json("/v1/jobs", &options("studio")).expect(202).json();
    let id = job["id"].as_str().unwrap();
    server.wait_for_state(id, "succeeded");
    let people = server.get(&format!("/v1/jobs/{id}/people")).expect(200).json();
    assert_eq!(people["body_model"]["name"], "studio");
}
