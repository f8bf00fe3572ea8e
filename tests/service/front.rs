//! The HTTP front: connections, hosts and origins, conditional requests, keys of running answers, the command `submit`.

use crate::http::{JSON, send_raw};
use crate::server::{Server, command};
use crate::store::{is_of_sqlite_alone, program};
use crate::take::{LONG, take};
use crate::tenants::{ask, key};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Status of a GET with this `Host`.
fn status_for_host(server: &Server, path: &str, host: &str) -> String {
    let request = format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
    let answer = send_raw(server.address(), request.as_bytes());
    answer.split(' ').nth(1).unwrap_or_default().to_owned()
}

#[test]
fn without_keys_only_known_hosts_are_served() {
    let server = Server::with(&["--set", "allowed_hosts=[\"studio.example\"]"]);
    for host in ["localhost:8700", "127.0.0.1", "[::1]:8700", "studio.example"] {
        assert_eq!(status_for_host(&server, "/v1/jobs", host), "200", "{host}");
    }
    for path in ["/v1/jobs", "/v1/webhook-secret", "/metrics"] {
        for host in ["evil.example:8700", "localhost.evil.example", "10.0.0.1", ""] {
            assert_eq!(status_for_host(&server, path, host), "403", "{path} {host}");
        }
    }
    assert_eq!(status_for_host(&server, "/healthz", "evil.example"), "200");
    key(&server, &[]);
    assert_eq!(status_for_host(&server, "/v1/jobs", "evil.example"), "401", "keys protect under any name");
}

#[test]
fn without_sec_fetch_site_the_origin_decides() {
    let server = Server::with(&["--set", "cors_origins=[\"https://studio.example\"]"]);
    let own = server.url("");
    let status = |origin: &str| server.post("/v1/sessions", &[JSON, ("origin", origin)], b"{}");
    for foreign in ["http://evil.example", "null", "http://127.0.0.1:1"] {
        status(foreign).expect_problem(403, "foreign_page");
    }
    for allowed in [own.as_str(), "https://studio.example"] {
        assert_eq!(status(allowed).status, 400, "{allowed}");
    }
}

/// A connection that has received one answer and stays open.
fn idle_connection(server: &Server) -> TcpStream {
    let mut stream = TcpStream::connect(server.address()).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    stream.write_all(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
    let mut start = [0; 15];
    stream.read_exact(&mut start).unwrap();
    assert_eq!(&start, b"HTTP/1.1 200 OK");
    stream
}

#[test]
fn idle_connections_without_key_do_not_lock_out_others() {
    let server = Server::with(&["--set", "limits.max_connections=8"]);
    let key = key(&server, &[]);
    let start = Instant::now();
    let idle: Vec<TcpStream> = (0..16).map(|_| idle_connection(&server)).collect();
    ask(&server, "GET", "/v1/jobs", &key, None).expect(200);
    assert!(start.elapsed() < Duration::from_secs(5), "{:?}", start.elapsed());
    drop(idle);
}

#[test]
fn idle_connections_without_key_are_closed_soon() {
    let server = Server::with(&["--set", "limits.max_connections_per_address=2"]);
    let mut connections: Vec<TcpStream> = (0..4).map(|_| idle_connection(&server)).collect();
    let start = Instant::now();
    let mut ends: Vec<u64> = Vec::new();
    for connection in &mut connections {
        let _ = connection.read_to_end(&mut Vec::new()); // a reset ends the connection, too
        ends.push(start.elapsed().as_secs());
    }
    assert!(ends[1] < 5 && (4..10).contains(&ends[3]), "two at once, two after the keep-alive: {ends:?}");
}

#[test]
fn inspection_is_not_computed_again() {
    let server = Server::start();
    let path = format!("/v1/sessions/{}/inspection", server.upload(50, 1));
    let first = server.get(&path).expect(200);
    assert_eq!(first.header("content-type"), "application/json");
    let tag = first.header("etag").to_owned();
    assert_eq!(server.get(&path).expect(200).body, first.body);
    assert!(server.get_with(&path, &[("if-none-match", &tag)]).expect(304).body.is_empty());
    server.get_with(&path, &[("if-match", "\"other\"")]).expect_problem(412, "precondition_failed");
}

#[test]
fn parts_of_a_damaged_file_are_an_error() {
    if is_of_sqlite_alone("a damaged copy is fetched again") {
        return;
    }
    let server = Server::start();
    let id = server.submit(&server.upload(20, 1));
    server.wait_for_state(&id, "succeeded");
    let path = format!("/v1/jobs/{id}/report");
    let part = || server.get_with(&path, &[("range", "bytes=0-1")]);
    assert_eq!(part().expect(206).body, part().expect(206).body);
    let file = server.files("results").into_iter().find(|file| file.ends_with("report.json")).unwrap();
    let mut bytes = std::fs::read(&file).unwrap();
    bytes[3] ^= 1;
    std::fs::write(&file, bytes).unwrap();
    part().expect_problem(500, "corrupt");
}

#[test]
fn if_match_guards_results_and_changes() {
    let server = Server::start();
    let id = server.submit(&server.upload(20, 1));
    server.wait_for_state(&id, "succeeded");
    let (job, report) = (format!("/v1/jobs/{id}"), format!("/v1/jobs/{id}/report"));
    let send =
        |method: &str, path: &str, tag: &str| crate::http::send(method, &server.url(path), &[("if-match", tag)], None);
    let tags = [&job, &report].map(|path| server.get(path).expect(200).header("etag").to_owned());
    send("GET", &report, &tags[1]).expect(200);
    for (method, path) in [("GET", &report), ("GET", &job), ("DELETE", &job)] {
        send(method, path, "\"other\"").expect_problem(412, "precondition_failed");
    }
    send("DELETE", &job, &tags[0]).expect(204);
}

#[test]
fn every_answer_forbids_guessing_the_media_type() {
    let server = Server::start();
    for path in ["/", "/docs", "/healthz", "/metrics", "/v1/jobs", "/v1/nothing", "/openapi.json"] {
        assert_eq!(server.get(path).header("x-content-type-options"), "nosniff", "{path}");
    }
}

#[test]
fn webhook_secret_needs_write_and_can_be_replaced() {
    let server = Server::start();
    let (reader, writer) = (key(&server, &["--scopes", "read"]), key(&server, &[]));
    ask(&server, "GET", "/v1/webhook-secret", &reader, None).expect_problem(403, "scope_missing");
    let secret = |method: &str| {
        let answer = ask(&server, method, "/v1/webhook-secret", &writer, None).expect(200);
        answer.json()["secret"].as_str().unwrap().to_owned()
    };
    let first = secret("GET");
    assert_eq!(secret("GET"), first);
    let second = secret("POST");
    assert_ne!(first, second);
    assert_eq!(secret("GET"), second);
}

#[test]
fn running_answers_end_with_their_key() {
    let server = Server::start();
    let token = key(&server, &[]);
    let session = ask(&server, "POST", "/v1/sessions", &token, Some(&take(LONG, 1))).expect(201).json();
    let asked = json!({ "session": session["id"], "options": { "extrinsics": "fixed" } });
    let job = ask(&server, "POST", "/v1/jobs", &token, Some(&asked)).expect(202).json();
    let path = format!("/v1/jobs/{}/events", job["id"].as_str().unwrap());
    let mut stream = TcpStream::connect(server.address()).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let head =
        format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {token}\r\nConnection: close\r\n\r\n");
    stream.write_all(head.as_bytes()).unwrap();
    let mut lines = BufReader::new(stream).lines().map_while(Result::ok);
    assert_eq!(lines.next().as_deref(), Some("HTTP/1.1 200 OK"));
    let id = token.split('_').nth(1).unwrap();
    let mut revoke = program(server.data());
    let revoked = revoke.args(["key", "revoke", id, "--data"]).arg(server.data()).status().unwrap();
    assert!(revoked.success());
    let start = Instant::now();
    let rest: Vec<String> = lines.collect();
    assert!(start.elapsed() < Duration::from_secs(10), "{:?}", start.elapsed());
    assert!(rest.last().is_some_and(|line| line.is_empty()), "the stream ends properly: {:?}", rest.last());
}

#[test]
fn rejects_values_at_the_ends_of_their_types() {
    let server = Server::start();
    let session = server.upload(10, 1);
    for priority in [i64::MIN, i64::MAX, -1001] {
        let problem = server.post_json("/v1/jobs", &json!({ "session": session, "priority": priority }));
        assert_eq!(problem.expect_problem(400, "malformed")["pointer"], "/priority");
    }
    let mut long = take(10, 2);
    let name = "x".repeat(4000);
    long["cameras"][0]["id"] = json!(name);
    let answer = server.post_json("/v1/sessions", &long);
    assert!((400..500).contains(&answer.status), "{}", answer.status);
    assert_eq!(answer.json()["code"], "camera_id_invalid");
    for setting in ["limits.bad_keys_per_s=-1.0", "tenants.requests_per_s=0.0"] {
        let data = tempfile::tempdir().unwrap();
        let output = command(data.path()).args(["--set", setting]).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{setting}");
    }
}

#[test]
fn log_names_tenant_key_and_job_of_a_request() {
    let data = tempfile::tempdir().unwrap();
    let mut create = program(data.path());
    let made = create.args(["key", "create", "--tenant", "a", "--data"]).arg(data.path()).output().unwrap();
    let token = String::from_utf8(made.stdout).unwrap().trim().to_owned();
    let mut serve = command(data.path());
    serve.args(["--log-format", "json"]).env("WANDLESS_LOG", "info").stderr(Stdio::piped());
    let mut server = Server::from_command(&mut serve);
    let log = server.stderr();
    let session = ask(&server, "POST", "/v1/sessions", &token, Some(&take(10, 1))).expect(201).json();
    let job = ask(&server, "POST", "/v1/jobs", &token, Some(&json!({ "session": session["id"] }))).expect(202).json();
    let path = format!("/v1/jobs/{}", job["id"].as_str().unwrap());
    ask(&server, "DELETE", &path, &token, None).expect(204);
    drop(server);
    let lines: Vec<Value> =
        BufReader::new(log).lines().map(|line| serde_json::from_str(&line.unwrap()).unwrap()).collect();
    let spans = lines.iter().map(|line| &line["span"]);
    let of_job: Vec<&Value> = spans.filter(|span| span["job.id"] == job["id"]).collect();
    for method in ["POST", "DELETE"] {
        let span = of_job.iter().find(|span| span["method"] == method).unwrap();
        assert_eq!((&span["tenant"], &span["key.id"]), (&json!("a"), &json!(token.split('_').nth(1))), "{span}");
    }
}

#[test]
fn submit_sends_the_key_and_never_prints_it() {
    let server = Server::start();
    let token = key(&server, &[]);
    let folder = tempfile::tempdir().unwrap();
    let session = folder.path().join("take.json");
    std::fs::write(&session, take(10, 1).to_string()).unwrap();
    let options = folder.path().join("options.json");
    std::fs::write(&options, "{\"extrinsics\": \"fixed\"}").unwrap();
    let submit = |url: &str, words: &[&str], environment: Option<&str>| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_wandless"));
        command
            .arg("submit")
            .arg(&session)
            .arg("--options")
            .arg(&options)
            .args(["--server", url])
            .args(words)
            .env_remove("WANDLESS_KEY");
        let output = command.envs(environment.map(|key| ("WANDLESS_KEY", key))).output().unwrap();
        let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
        assert!(!text.contains(&token) && !text.contains("pass-word"), "{text}");
        (output.status.code(), text)
    };
    let url = server.url("");
    let with_password = |password: &str| url.replace("http://", &format!("http://x:{password}@"));
    let (code, text) = submit(&url, &["--key", &token], None);
    assert_eq!(code, Some(0), "{text}");
    let (code, text) = submit(&url, &[], Some(&token));
    assert_eq!(code, Some(0), "{text}");
    let (code, text) = submit(&with_password(&token), &[], None);
    assert!(code == Some(0) && text.contains(&format!("{url}/v1/jobs/")), "{text}");
    let (code, text) = submit(&url, &[], None);
    assert!(code == Some(1) && text.contains("unauthorized"), "{text}");
    assert_eq!(submit(&with_password("pass-word"), &[], None).0, Some(1));
}
