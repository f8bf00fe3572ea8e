//! Every error is a problem document, and the service keeps running.

use crate::http::{FORM, JSON, ZIP, form, send, send_raw};
use crate::server::{Server, command};
use crate::take::{take, zipped};
use serde_json::{Value, json};
use std::process::Command;
use std::time::{Duration, Instant};

#[test]
fn unknown_routes_methods_and_media_types_are_problems() {
    let server = Server::start();
    server.get("/v1/nothing").expect_problem(404, "not_found");
    server.get("/v1/jobs/job_0").expect_problem(404, "not_found");
    let put = send("PUT", &server.url("/v1/jobs"), &[JSON], Some(b"{}"));
    assert!(put.header("allow").contains("POST"), "{put:?}");
    let problem = put.expect_problem(405, "method_not_allowed");
    assert_eq!(problem["instance"], "/v1/jobs");
    server.post("/v1/sessions", &[("content-type", "text/csv")], b"a").expect_problem(415, "unsupported_media_type");
    server.post("/v1/sessions", &[], b"a").expect_problem(415, "unsupported_media_type");
    server.post("/v1/jobs", &[ZIP], b"PK").expect_problem(415, "unsupported_media_type");
    let gzip = [JSON, ("content-encoding", "gzip")];
    server.post("/v1/sessions", &gzip, b"a").expect_problem(415, "unsupported_encoding");
    server.get("/healthz").expect(200);
    server.get("/readyz").expect(200);
}

#[test]
fn rejects_malformed_uploads_and_stores_nothing() {
    let server = Server::start();
    let zip = zipped(&take(10, 1));
    let mut session = take(10, 1);
    session["cameras"] = json!("none");
    for (header, body) in [
        (ZIP, &b"no zip"[..]),
        (ZIP, &zip[..zip.len() / 2]),
        (ZIP, b""),
        (JSON, b"{\"name\": "),
        (JSON, b"[1e400]"),
        (JSON, session.to_string().as_bytes()),
        (("content-type", "application/x-ndjson"), b"{}\n{}\n"),
        (FORM, b"no form"),
        (FORM, &form(&[("other", b"x")])),
        (FORM, &form(&[("session", b"no zip")])),
        (FORM, &form(&[("session", &zip)])[..zip.len()]),
        (FORM, &form(&[])),
        (("content-type", "multipart/form-data"), &form(&[("session", &zip)])),
    ] {
        let answer = server.post("/v1/sessions", &[header], body);
        assert!((400..500).contains(&answer.status), "{}: {}", header.1, answer.status);
        assert_eq!(answer.header("content-type"), "application/problem+json");
    }
    assert_eq!(server.files("sessions").len() + server.files("tmp").len(), 0);
    server.post("/v1/sessions", &[ZIP], &zip).expect(201);
}

#[test]
fn rejects_impossible_jobs_with_a_pointer() {
    let server = Server::start();
    let mut unknown = take(10, 1);
    for camera in unknown["cameras"].as_array_mut().unwrap() {
        camera.as_object_mut().unwrap().retain(|key, _| key != "R" && key != "t");
    }
    let session = server.post_json("/v1/sessions", &unknown).expect(201).json()["id"].clone();
    let ask = |body: Value| server.post_json("/v1/jobs", &body);
    let options = |options: Value| ask(json!({ "session": session, "options": options }));

    ask(json!({})).expect_problem(400, "malformed");
    ask(json!([])).expect_problem(400, "malformed");
    for list in
        [json!([session, null, null, null, {}, 0, null]), json!({ "session": session, "webhook": ["http://x"] })]
    {
        let refused = ask(list).expect_problem(400, "malformed");
        assert!(!refused["detail"].as_str().unwrap().contains("struct"), "a list was read as an object: {refused}");
    }
    ask(json!({ "session": session, "state": "succeeded" })).expect_problem(400, "malformed");
    ask(json!({ "session": "session_0" })).expect_problem(404, "session_not_found");
    let webhook = ask(json!({ "session": session, "webhook": { "url": "http://localhost" } }));
    assert_eq!(webhook.expect_problem(422, "webhook_refused")["pointer"], "/webhook/url");
    ask(json!({ "session": session, "priority": 10_000_000 })).expect_problem(400, "malformed");
    ask(json!({ "session": session, "priority": i64::MIN })).expect_problem(400, "malformed");
    ask(json!({ "session": session, "labels": { "": "x" } })).expect_problem(400, "malformed");
    let unfindable = ask(json!({ "session": session, "labels": { "take=7": "x" } })).expect_problem(400, "malformed");
    assert_eq!(unfindable["pointer"], "/labels", "a label that no filter finds was stored");
    let labels: serde_json::Map<_, _> = (0..17).map(|n| (format!("{n}"), json!("x".repeat(240)))).collect();
    let many = ask(json!({ "session": session, "labels": labels })).expect_problem(400, "malformed");
    assert_eq!(many["pointer"], "/labels");

    for (member, value, pointer, expected) in [
        ("priority", json!("high"), "/priority", "a whole number"),
        ("labels", json!({ "take": 7 }), "/labels/take", "a string"),
        ("webhook", json!({ "url": 7 }), "/webhook", "a string"),
        ("session", json!(7), "/session", "a string"),
    ] {
        let mut body = json!({ "session": session });
        body[member] = value;
        let problem = ask(body).expect_problem(400, "malformed");
        assert_eq!(problem["pointer"], pointer, "{problem}");
        let detail = problem["detail"].as_str().unwrap();
        assert!(detail.contains(&format!("expected {expected}")), "types of the program were named: {detail}");
    }

    for (asked, status, code, pointer) in [
        (json!({ "sede": 1 }), 400, "option_unknown", "/options/sede"),
        (json!({ "seed": "one" }), 400, "option_malformed", "/options/seed"),
        (json!({ "scale": { "from": "guess" } }), 400, "option_malformed", "/options/scale"),
        (json!({ "extrinsics": "fixed" }), 422, "option_impossible", "/options/extrinsics"),
        (json!({ "people": 0 }), 422, "option_impossible", "/options/people"),
        (json!({ "up_axis": "x" }), 422, "option_impossible", "/options/up_axis"),
        (json!({ "exports": ["smpl_npz", "mp3"] }), 400, "option_malformed", "/options/exports"),
        (json!({ "body": "other" }), 422, "option_impossible", "/options/body"),
        (
            json!({ "scale": { "from": "camera_distance", "cameras": ["cam0", "cam9"], "metres": 1 } }),
            422,
            "option_impossible",
            "/options/scale/cameras",
        ),
        (
            json!({ "scale": { "from": "height", "metres": -1, "who": "tallest" } }),
            422,
            "option_impossible",
            "/options/scale/metres",
        ),
    ] {
        assert_eq!(options(asked).expect_problem(status, code)["pointer"], pointer);
    }
    let malformed = options(json!({ "people": "3" })).expect_problem(400, "option_malformed");
    assert!(malformed["remedy"].as_str().unwrap().contains("1 or more"), "{malformed}");
    let key = [JSON, ("idempotency-key", "")];
    server
        .post("/v1/jobs", &key, json!({ "session": session }).to_string().as_bytes())
        .expect_problem(400, "malformed");
    for query in ["page_size=&page_token=", "state=&label=", "page_size"] {
        server.get(&format!("/v1/jobs?{query}")).expect(200);
    }
    let badly = server.get("/v1/jobs?page_size=x").expect_problem(400, "malformed");
    assert!(badly["detail"].as_str().unwrap().contains("page_size"), "{badly}");
    for query in ["state=done", "page_size=-1", "page_token=x", "sort=up"] {
        server.get(&format!("/v1/jobs?{query}")).expect_problem(400, "malformed");
    }
    assert_eq!(server.get("/v1/jobs").json()["jobs"], json!([]));
}

#[test]
fn rejects_a_session_with_a_long_name() {
    let server = Server::start();
    let mut long = take(10, 1);
    for (bytes, status) in [(257, 422), (256, 201)] {
        long["name"] = json!("x".repeat(bytes));
        let answer = server.post_json("/v1/sessions", &long);
        assert_eq!(answer.status, status, "{}", String::from_utf8_lossy(&answer.body));
    }
    assert_eq!(server.files("sessions").len() + server.files("tmp").len(), 1);
}

#[test]
fn form_with_bad_options_stores_nothing() {
    let server = Server::start();
    let zip = zipped(&take(10, 1));
    for (options, code) in [("{", "malformed"), ("[]", "malformed"), ("{\"x\": 1}", "option_unknown")] {
        let body = form(&[("session", &zip), ("options", options.as_bytes())]);
        server.post("/v1/jobs", &[FORM], &body).expect_problem(400, code);
    }
    server.post("/v1/jobs", &[FORM], &form(&[("options", b"{}")])).expect_problem(400, "malformed");
    assert_eq!(server.files("sessions").len() + server.files("tmp").len(), 0);
}

#[test]
fn rejects_early_result_and_late_cancel() {
    let server = Server::start();
    let id = server.submit(&server.upload(60, 1));
    for name in ["result", "cameras", "people", "report", "archive", "artifacts/cameras.json"] {
        server.get(&format!("/v1/jobs/{id}/{name}")).expect_problem(409, "not_ready");
    }
    server.wait_for_state(&id, "succeeded");
    server.post_json(&format!("/v1/jobs/{id}/cancel"), &Value::Null).expect_problem(409, "already_final");
    server.get(&format!("/v1/jobs/{id}/artifacts/none.json")).expect_problem(404, "not_found");
    server.post_json("/v1/jobs/job_0/cancel", &Value::Null).expect_problem(404, "not_found");
    server.get("/v1/jobs/job_0/result").expect_problem(404, "not_found");
}

#[test]
fn rejects_a_declared_too_large_body_before_reading() {
    let server = Server::start();
    let head = "POST /v1/sessions HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/zip\r\n";
    let start = Instant::now();
    let answer = send_raw(server.address(), format!("{head}Content-Length: 99999999999\r\n\r\nPK").as_bytes());
    assert!(answer.starts_with("HTTP/1.1 413") && answer.contains("\"too_large\""), "{answer}");
    assert!(start.elapsed() < Duration::from_secs(5));
    let large = vec![b' '; 3 << 20];
    server.post("/v1/jobs", &[JSON], &large).expect_problem(413, "too_large");
}

#[test]
fn malformed_http_closes_only_its_connection() {
    let server = Server::start();
    let huge = format!("GET /healthz HTTP/1.1\r\nX: {}\r\n\r\n", "x".repeat(1 << 20));
    let many = format!("GET /healthz HTTP/1.1\r\n{}\r\n", "X: y\r\n".repeat(10_000));
    let both = "POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\nContent-Length: 6\r\n\r\nhello";
    for bytes in [&b"\0\xff\r\n\r\n"[..], b"GET\r\n\r\n", huge.as_bytes(), many.as_bytes(), both.as_bytes()] {
        let answer = send_raw(server.address(), bytes);
        assert!(answer.is_empty() || answer.starts_with("HTTP/1.1 4"), "{answer}");
    }
    server.get("/healthz").expect(200);
}

#[test]
fn closes_connections_without_a_full_head_after_5_s() {
    let server = Server::start();
    for bytes in [&b""[..], b"GET /healthz HTTP/1.1\r\nHost: "] {
        let start = Instant::now();
        send_raw(server.address(), bytes);
        assert!((4..10).contains(&start.elapsed().as_secs()), "{:?}", start.elapsed());
    }
}

#[test]
fn wrong_usage_exits_with_2_and_one_line() {
    let data = tempfile::tempdir().unwrap();
    let run = |command: &mut Command| {
        let output = command.output().unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let binary = || Command::new(env!("CARGO_BIN_EXE_wandless"));
    let (code, text) = run(binary().args(["serve", "--listen", "0.0.0.0:0", "--data"]).arg(data.path()));
    assert_eq!(code, Some(2));
    assert!(text.contains("loopback"), "{text}");
    let (code, _) = run(binary().arg("serv"));
    assert_eq!(code, Some(2));
    let (code, text) = run(binary().args(["reconstruct", "/nowhere", "--out"]).arg(data.path().join("out")));
    assert_eq!(code, Some(2), "{text}");
    assert_eq!(text.trim().lines().count(), 1, "{text}");
    let (code, text) = run(binary().args(["evaluate", "/nowhere", "--truth", "/nowhere"]));
    assert_eq!(code, Some(2), "{text}");

    let server = Server::start();
    let (code, text) = run(&mut command(server.data()));
    assert_eq!(code, Some(1));
    assert!(text.contains("another wandless service"), "{text}");
}
