//! Keys and tenants: access needs a valid key, and tenants cannot see each other's resources.

use crate::http::{Answer, JSON, send, send_raw};
use crate::server::Server;
use crate::store::program;
use crate::take::take;
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

/// Creates a key of the service under test.
pub fn key(server: &Server, words: &[&str]) -> String {
    let output =
        program(server.data()).args(["key", "create"]).args(words).arg("--data").arg(server.data()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap().trim().to_owned()
}

/// Sends a request with a key.
pub fn ask(server: &Server, method: &str, path: &str, key: &str, body: Option<&Value>) -> Answer {
    let bearer = format!("Bearer {key}");
    let mut headers = vec![("authorization", bearer.as_str())];
    headers.extend(body.map(|_| JSON));
    send(method, &server.url(path), &headers, body.map(|body| body.to_string()).as_deref().map(str::as_bytes))
}

#[test]
fn resources_of_other_tenants_are_not_found() {
    let server = Server::with(&["--set", "limits.bad_keys_per_s=1000"]);
    let [a, b, reader] = [
        key(&server, &["--tenant", "a"]),
        key(&server, &["--tenant", "b"]),
        key(&server, &["--tenant", "a", "--scopes", "read"]),
    ];
    let session = ask(&server, "POST", "/v1/sessions", &a, Some(&take(10, 1))).expect(201).json();
    let session = session["id"].as_str().unwrap();
    let asked = json!({ "session": session, "options": { "extrinsics": "fixed" } });
    let job = ask(&server, "POST", "/v1/jobs", &a, Some(&asked)).expect(202).json();
    let job = job["id"].as_str().unwrap();

    let description = server.get("/openapi.json").expect(200).json();
    let unknown =
        |path: &str| path.replace(session, &format!("session_{:032}", 0)).replace(job, &format!("job_{:032}", 0));
    let mut n_routes = 0;
    for (path, methods) in description["paths"].as_object().unwrap() {
        if !path.contains("{id}") {
            continue;
        }
        let id = if path.starts_with("/v1/sessions") { session } else { job };
        let delivery = format!("delivery_{:032}", 0);
        let path = path.replace("{id}", id).replace("{name}", "cameras.json").replace("{delivery}", &delivery);
        for method in methods.as_object().unwrap().keys() {
            n_routes += 1;
            let method = method.to_uppercase();
            let foreign = ask(&server, &method, &path, &b, None);
            let none = ask(&server, &method, &unknown(&path), &b, None);
            assert_eq!((foreign.status, none.status), (404, 404), "{method} {path}");
            let body = |answer: &Answer, path: &str| {
                let text = String::from_utf8(answer.body.clone()).unwrap();
                text.replace(path, "").replace(job, "").replace(session, "").replace(&unknown(job), "")
            };
            assert_eq!(body(&foreign, &path), body(&none, &unknown(&path)), "{method} {path}");
            for wrong in ["", "wl_0_0", &a[..a.len() - 1]] {
                ask(&server, &method, &path, wrong, None).expect_problem(401, "unauthorized");
            }
            if method != "GET" {
                ask(&server, &method, &path, &reader, None).expect_problem(403, "scope_missing");
            }
        }
    }
    assert!(n_routes >= 14, "{n_routes}");
    assert_eq!(ask(&server, "GET", "/v1/jobs", &b, None).expect(200).json()["jobs"], json!([]));
    assert_eq!(ask(&server, "GET", "/v1/sessions", &b, None).expect(200).json()["sessions"], json!([]));
    ask(&server, "POST", "/v1/jobs", &b, Some(&asked)).expect_problem(404, "session_not_found");
    ask(&server, "GET", &format!("/v1/jobs/{job}"), &reader, None).expect(200);
    ask(&server, "GET", "/metrics", &a, None).expect_problem(403, "scope_missing");
    let own = ask(&server, "POST", "/v1/sessions", &b, Some(&take(10, 1))).expect(201).json();
    assert_ne!(own["id"], session, "sessions of two tenants are separate");
}

#[test]
fn revoked_key_is_refused_and_its_job_continues() {
    let server = Server::start();
    let (old, new) = (key(&server, &["--tenant", "a"]), key(&server, &["--tenant", "a"]));
    let session = ask(&server, "POST", "/v1/sessions", &old, Some(&take(60, 1))).expect(201).json();
    let asked = json!({ "session": session["id"], "options": { "extrinsics": "fixed" } });
    let job = ask(&server, "POST", "/v1/jobs", &old, Some(&asked)).expect(202).json();
    let id = old.split('_').nth(1).unwrap();
    let revoke = || {
        let mut command = program(server.data());
        command.args(["key", "revoke", id, "--data"]).arg(server.data()).output().unwrap().status.code()
    };
    assert_eq!(revoke(), Some(0));
    let path = format!("/v1/jobs/{}", job["id"].as_str().unwrap());
    ask(&server, "GET", &path, &old, None).expect_problem(401, "unauthorized");
    assert_eq!(revoke(), Some(2), "the key is already revoked");
    let deadline = Instant::now() + Duration::from_secs(120);
    while ask(&server, "GET", &format!("{path}?wait=5"), &new, None).expect(200).json()["state"] != "succeeded" {
        assert!(Instant::now() < deadline);
    }
}

#[test]
fn only_wrong_keys_are_rate_limited() {
    let server = Server::start();
    let right = key(&server, &[]);
    let refused: Vec<u16> =
        (0..60).map(|i| ask(&server, "GET", "/v1/jobs", &format!("wl_{i}_0"), None).status).collect();
    assert!(refused.contains(&429) && refused.iter().all(|status| matches!(status, 401 | 429)), "{refused:?}");
    ask(&server, "GET", "/v1/jobs", &right, None).expect(200);
}

#[test]
fn pages_of_other_sites_cannot_change_anything() {
    let server = Server::start();
    let foreign = [JSON, ("sec-fetch-site", "cross-site"), ("origin", "https://elsewhere.example")];
    server.post("/v1/sessions", &foreign, b"{}").expect_problem(403, "foreign_page");
    let own = [JSON, ("sec-fetch-site", "same-origin")];
    assert_eq!(server.post("/v1/sessions", &own, b"{}").status, 400);
    let answer = server.get_with("/v1/jobs", &[("origin", "https://elsewhere.example")]).expect(200);
    assert_eq!(answer.header("access-control-allow-origin"), "");

    let listed = Server::with(&["--set", "cors_origins=[\"https://studio.example\"]"]);
    let preflight = [("origin", "https://studio.example"), ("access-control-request-method", "POST")];
    let answer = send("OPTIONS", &listed.url("/v1/jobs"), &preflight, None).expect(200);
    assert_eq!(answer.header("access-control-allow-origin"), "https://studio.example");
    let answer = listed.get_with("/v1/jobs", &[("origin", "https://elsewhere.example")]).expect(200);
    assert_eq!(answer.header("access-control-allow-origin"), "");
}

#[test]
fn quotas_are_exact_and_released_on_delete() {
    let text = take(10, 1).to_string();
    let server = Server::with(&["--set", &format!("tenants.max_bytes={}", text.len())]);
    let session = server.post("/v1/sessions", &[JSON], text.as_bytes()).expect(201).json();
    server.post("/v1/sessions", &[JSON], take(11, 1).to_string().as_bytes()).expect_problem(507, "quota_exceeded");
    server.delete(&format!("/v1/sessions/{}", session["id"].as_str().unwrap())).expect(204);
    server.post("/v1/sessions", &[JSON], text.as_bytes()).expect(201);

    let id = server.get("/v1/sessions").expect(200).json()["sessions"][0]["id"].clone();
    server.post_json("/v1/jobs", &json!({ "session": id })).expect_problem(507, "quota_exceeded");

    let server = Server::with(&["--set", "tenants.max_bytes=1000"]);
    let unfinished = [700, 400].map(|length| {
        let mut stream = TcpStream::connect(server.address()).unwrap();
        let head = "POST /v1/sessions HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n";
        write!(stream, "{head}Content-Length: {length}\r\n\r\n{{").unwrap();
        std::thread::sleep(Duration::from_millis(300));
        stream
    });
    let mut answer = [0; 12];
    (&unfinished[1]).read_exact(&mut answer).unwrap();
    assert_eq!(&answer, b"HTTP/1.1 507", "the announced bytes of both uploads exceed the quota");

    let server = Server::with(&["--set", "tenants.max_queued=2"]);
    let busy = server.submit(&server.upload(crate::take::LONG, 1));
    server.wait_for_state(&busy, "running");
    let session = server.upload(10, 2);
    let jobs = [server.submit(&session), server.submit(&session)];
    server.post_json("/v1/jobs", &json!({ "session": session })).expect_problem(429, "queue_full");
    server.delete(&format!("/v1/jobs/{}", jobs[0])).expect(204);
    server.submit(&session);
}

#[test]
fn public_address_requires_a_key() {
    let data = tempfile::tempdir().unwrap();
    let run = |words: &[&str]| {
        let mut command = program(data.path());
        command.args(words).arg("--data").arg(data.path()).output().unwrap()
    };
    assert_eq!(run(&["serve", "--listen", "0.0.0.0:0"]).status.code(), Some(2));
    let token = String::from_utf8(run(&["key", "create"]).stdout).unwrap();
    let listed = String::from_utf8(run(&["key", "list"]).stdout).unwrap();
    assert!(!listed.contains(token.trim().rsplit('_').next().unwrap()), "{listed}");
    let mut serve = program(data.path());
    serve.args(["serve", "--listen", "0.0.0.0:0", "--data"]).arg(data.path()).env("WANDLESS_LOG", "warn");
    let server = Server::from_command(&mut serve);
    let address = server.address().to_owned();
    let answer = send_raw(&address, b"GET /v1/jobs HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n");
    assert!(answer.starts_with("HTTP/1.1 401"), "{answer}");
    ask(&server, "GET", "/v1/jobs", token.trim(), None).expect(200);
}
