//! Operation: settings, metrics, logs, shutdown, backup, restore, verify, memory, events, webhooks, client.

use crate::http::{JSON, send};
use crate::server::{Server, command, signal};
use crate::store::is_of_sqlite_alone;
use crate::take::{LONG, take};
use rustix::process::Signal;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

fn wandless(words: &[&str], paths: &[&Path]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_wandless")).args(words).args(paths).output().unwrap()
}

#[test]
fn metrics_count_jobs_requests_and_refusals() {
    let server = Server::start();
    let id = server.submit(&server.upload(10, 1));
    server.wait_for_state(&id, "succeeded");
    server.get("/v1/jobs/job_0").expect(404);
    std::thread::sleep(Duration::from_millis(500)); // the end is counted after its row is written
    let page = server.get("/metrics").expect(200);
    assert!(page.header("content-type").starts_with("application/openmetrics-text"));
    let page = String::from_utf8(page.body).unwrap();
    for line in [
        "wandless_jobs{state=\"succeeded\"} 1",
        "wandless_jobs_running_without_live_worker 0",
        "wandless_claims_ended_total{state=\"succeeded\"} 1",
        "wandless_refused_total{code=\"not_found\"} 1",
        "wandless_child_crashes_total 0",
    ] {
        assert!(page.lines().any(|l| l == line), "{line}\n{page}");
    }
    for name in [
        "wandless_stage_seconds_sum{",
        "wandless_wal_bytes ",
        "wandless_disk_free_bytes ",
        "_bucket{le=\"0.005\",method=\"POST\"",
    ] {
        assert!(page.contains(name), "{name}");
    }
}

#[test]
fn log_has_request_ids_and_no_keys() {
    let data = tempfile::tempdir().unwrap();
    let mut serve = command(data.path());
    serve.args(["--log-format", "json"]).env("WANDLESS_LOG", "info").stderr(Stdio::piped());
    let mut server = Server::from_command(&mut serve);
    let log = server.stderr();
    let answer =
        server.get_with("/v1/jobs/job_0", &[("x-request-id", "take-7"), ("authorization", "Bearer wl_a_secret")]);
    assert_eq!(answer.header("x-request-id"), "take-7");
    assert_eq!(server.get("/healthz").header("x-request-id").len(), 36);
    let id = server.submit(&server.upload(10, 1));
    server.wait_for_state(&id, "succeeded");
    drop(server);
    let mut text = String::new();
    BufReader::new(log).read_to_string(&mut text).unwrap();
    let lines: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert!(lines.iter().any(|line| line["span"]["request.id"] == "take-7" && line["status"] == 404), "{text}");
    assert!(lines.iter().any(|line| line["span"]["job.id"] == id.as_str()), "{text}");
    assert!(!text.contains("wl_a_secret"));
}

#[test]
fn log_says_why_a_job_failed_and_whose_it_is() {
    let data = tempfile::tempdir().unwrap();
    let mut serve = command(data.path());
    serve.args(["--log-format", "json", "--set", "jobs.memory_bytes=90000000"]).stderr(Stdio::piped());
    let mut server = Server::from_command(&mut serve);
    let log = server.stderr();
    let asked = json!({ "session": server.upload(LONG, 1), "options": { "extrinsics": "fixed" } }).to_string();
    let headers = [JSON, ("x-request-id", "submission-7")];
    let job = server.post("/v1/jobs", &headers, asked.as_bytes()).expect(202).json();
    let id = job["id"].as_str().unwrap();
    server.wait_for_state(id, "failed");
    std::thread::sleep(Duration::from_millis(200)); // the line is written after the row
    drop(server);
    let mut text = String::new();
    BufReader::new(log).read_to_string(&mut text).unwrap();
    let lines: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let ended = lines.iter().find(|line| line["message"] == "job ended").unwrap();
    assert_eq!((&ended["state"], &ended["code"]), (&json!("failed"), &json!("out_of_memory")), "{text}");
    assert!(ended["detail"].as_str().unwrap().contains("85 MiB"), "{ended}");
    let span = &ended["span"];
    assert_eq!((&span["job.id"], &span["tenant"]), (&json!(id), &json!("default")), "{ended}");
    assert_eq!(span["request.id"], "submission-7", "{ended}");
    let crash = lines.iter().find(|line| line["message"] == "the job's process crashed").unwrap();
    assert_eq!((&crash["signal"], &crash["span"]["job.id"]), (&json!(6), &json!(id)), "{crash}");
    assert!(!text.contains('\u{1b}') && !text.contains("\\u001b"), "colour codes: {text}");
}

#[test]
fn upload_over_its_memory_limit_is_refused() {
    let server = Server::with(&["--set", "limits.validation_memory_bytes=90000000"]);
    server.upload(10, 1);
    // A hundred people of 17 keypoints in each frame: 35 MB of text, 90 MB in memory.
    let person = json!({ "track_id": null, "keypoints": vec![[1, 1, 1]; 17] }).to_string();
    let people = vec![person.as_str(); 100].join(",");
    let frame = |n: usize| format!(r#"{{"frame": {n}, "people": [{people}]}}"#);
    let frames: Vec<String> = (0..2000).map(frame).collect();
    let mut session = take(10, 2);
    session["n_frames"] = json!(2000);
    session["poses"]["cam0"]["frames"] = json!("FRAMES");
    let text = session.to_string().replace("\"FRAMES\"", &format!("[{}]", frames.join(",")));
    let refused = server.post("/v1/sessions", &[JSON], text.as_bytes()).expect_problem(413, "too_large");
    let text = refused.to_string();
    assert!(text.contains("85 MiB") && text.contains("validation_memory_bytes"), "{text}");
    server.upload(10, 3);
    assert!(server.files("tmp").is_empty());
}

#[test]
fn job_over_its_memory_limit_fails_as_out_of_memory() {
    let server = Server::with(&["--set", "jobs.memory_bytes=90000000"]);
    let id = server.submit(&server.upload(LONG, 1));
    let job = server.wait_until(&id, |job| matches!(job["state"].as_str(), Some("failed" | "dead" | "succeeded")));
    assert_eq!((&job["state"], &job["error"]["code"]), (&json!("failed"), &json!("out_of_memory")), "{job}");
    server.get("/readyz").expect(200);
}

#[test]
fn event_stream_ends_with_the_job() {
    let server = Server::start();
    let id = server.submit(&server.upload(60, 1));
    let stream = server.get(&format!("/v1/jobs/{id}/events")).expect(200);
    assert_eq!(stream.header("content-type"), "text/event-stream");
    let text = String::from_utf8(stream.body).unwrap();
    let states: Vec<Value> = text
        .split("\n\n")
        .filter(|event| event.contains("event: state"))
        .map(|event| serde_json::from_str(event.lines().find_map(|line| line.strip_prefix("data: ")).unwrap()).unwrap())
        .collect();
    assert_eq!(states.last().unwrap()["state"], "succeeded");
    assert!(text.starts_with("event: state"), "a client learns of the job before its progress: {text}");
    assert!(text.contains("event: progress") && text.contains("id: "), "{text}");
    server.get("/v1/jobs/job_0/events").expect_problem(404, "not_found");
}

#[test]
fn cameras_and_points_are_shown_while_a_job_runs() {
    let server = Server::start();
    let id = server.submit(&server.upload(LONG, 1));
    let path = format!("/v1/jobs/{id}/scene");
    let answer = loop {
        let answer = server.get(&path);
        if answer.status == 200 {
            break answer;
        }
        assert_eq!((answer.status, &answer.json()["code"]), (409, &json!("not_ready")));
        assert_eq!(server.job(&id)["finished_at"], Value::Null, "the job ended without a scene");
        std::thread::sleep(Duration::from_millis(20));
    };
    let tag = answer.header("etag").to_owned();
    let scene = answer.json();
    assert_eq!((scene["units"].as_str(), scene["stage"].as_str()), (Some("m"), Some("cameras")));
    let cameras = scene["cameras"].as_array().unwrap();
    assert!(cameras.len() == 4 && cameras.iter().all(|camera| camera["K"].is_array() && camera["position"].is_array()));
    let points = scene["people"][0]["points"].as_array().unwrap();
    assert_eq!(points.len(), scene["frames"].as_array().unwrap().len());
    let known = points.iter().find(|frame| frame.is_array()).expect("no frame shows the person");
    assert_eq!(known.as_array().unwrap().len(), scene["keypoint_names"].as_array().unwrap().len());
    assert!(matches!(server.get_with(&path, &[("If-None-Match", &tag)]).status, 304 | 200));
    let stream = TcpStream::connect(server.address()).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let request = format!("GET /v1/jobs/{id}/events HTTP/1.1\r\nHost: localhost\r\n\r\n");
    (&stream).write_all(request.as_bytes()).unwrap();
    let mut lines = BufReader::new(stream).lines().map_while(Result::ok);
    assert!(lines.any(|line| line == "event: scene"), "a client that comes later does not hear of the scene");
    server.post(&format!("/v1/jobs/{id}/cancel"), &[], b"").expect(202);
    server.wait_for_state(&id, "canceled");
    server.get(&path).expect_problem(409, "not_ready");
    server.get("/v1/jobs/job_0/scene").expect_problem(404, "not_found");
}

#[test]
fn inspection_estimates_the_accuracy() {
    let server = Server::start();
    let id = server.upload(100, 1);
    let inspection = server.get(&format!("/v1/sessions/{id}/inspection")).expect(200).json();
    assert_eq!(inspection["groups"].as_array().unwrap().len(), 1);
    assert_eq!(inspection["pairs"].as_array().unwrap().len(), 6);
    assert!(inspection["expected"]["joint_error_mm"].as_f64().unwrap() > 0.0);
    server.get("/v1/sessions/session_0/inspection").expect_problem(404, "not_found");
}

/// A webhook receiver that answers each connection with the next status; returns the received requests.
fn receiver(statuses: &'static [u16]) -> (String, std::thread::JoinHandle<Vec<String>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}/hook", listener.local_addr().unwrap());
    let received = std::thread::spawn(move || {
        let serve = |status: &u16| {
            let (mut stream, _) = listener.accept().unwrap();
            let mut reader = BufReader::new(stream.try_clone().unwrap());
            let (mut text, mut length) = (String::new(), 0);
            loop {
                let mut line = String::new();
                reader.read_line(&mut line).unwrap();
                let lower = line.to_ascii_lowercase();
                length = lower.strip_prefix("content-length:").map_or(length, |n| n.trim().parse().unwrap());
                text.push_str(&line);
                if line == "\r\n" {
                    break;
                }
            }
            let mut body = vec![0; length];
            reader.read_exact(&mut body).unwrap();
            let head = format!(
                "HTTP/1.1 {status} X\r\nLocation: http://127.0.0.1:1/\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
            );
            stream.write_all(head.as_bytes()).unwrap();
            text + &String::from_utf8(body).unwrap()
        };
        statuses.iter().map(serve).collect()
    });
    (url, received)
}

#[test]
fn webhook_is_signed_and_repeated_without_redirects() {
    let server =
        Server::with(&["--set", "webhooks.allowed_networks=[\"127.0.0.1\"]", "--set", "webhooks.first_wait_s=0"]);
    let secret = server.get("/v1/webhook-secret").expect(200).json()["secret"].as_str().unwrap().to_owned();
    let (url, received) = receiver(&[500, 302, 204, 204]);
    let asked =
        json!({ "session": server.upload(10, 1), "options": { "extrinsics": "fixed" }, "webhook": { "url": url } });
    let id = server.post_json("/v1/jobs", &asked).expect(202).json()["id"].as_str().unwrap().to_owned();
    server.wait_for_state(&id, "succeeded");
    let path = format!("/v1/jobs/{id}/deliveries");
    let deadline = Instant::now() + Duration::from_secs(60);
    let delivered = loop {
        let list = server.get(&path).expect(200).json()["deliveries"].as_array().unwrap().clone();
        assert_eq!(list.len(), 1);
        if list[0]["state"] == "delivered" {
            break list[0].clone();
        }
        assert!(Instant::now() < deadline, "{list:?}");
        std::thread::sleep(Duration::from_millis(100));
    };
    assert_eq!((&delivered["tries"], &delivered["last_status"]), (&json!(3), &json!(204)));
    let again = format!("{path}/{}/redeliver", delivered["id"].as_str().unwrap());
    server.post_json(&again, &Value::Null).expect(202);
    for request in received.join().unwrap() {
        let (head, body) = request.split_once("\r\n\r\n").unwrap();
        let header = |name: &str| {
            let mut lines = head.lines().filter_map(|line| line.split_once(": "));
            lines.find(|(key, _)| key.eq_ignore_ascii_case(name)).unwrap().1.to_owned()
        };
        let (id_, time) = (header("webhook-id"), header("webhook-timestamp").parse().unwrap());
        assert_eq!(id_, delivered["id"].as_str().unwrap());
        let signed = wandless::service::webhooks::signature(&secret, &id_, time, body.as_bytes());
        assert_eq!(Some(header("webhook-signature")), signed);
        let event: Value = serde_json::from_str(body).unwrap();
        assert_eq!((&event["type"], &event["data"]["id"]), (&json!("job.succeeded"), &json!(id)));
    }
}

#[test]
fn restored_backup_of_a_busy_service_continues() {
    if is_of_sqlite_alone("backup") {
        return;
    }
    let server = Server::start();
    let done = server.submit(&server.upload(10, 1));
    server.wait_for_state(&done, "succeeded");
    let running = server.submit(&server.upload(LONG, 2));
    server.wait_for_state(&running, "running");
    let place = tempfile::tempdir().unwrap();
    let (backup, restored) = (place.path().join("backup"), place.path().join("restored"));
    let data = server.data().to_owned();
    let made = wandless(&["backup", "--data"], &[&data, &backup]);
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    assert!(wandless(&["verify"], &[&backup]).status.success());
    assert_eq!(
        wandless(&["backup", "--data"], &[&data, &backup]).status.code(),
        Some(1),
        "a backup is never overwritten"
    );
    assert!(wandless(&["restore", "--data"], &[&restored, &backup]).status.success());
    drop(server);
    let server = Server::from_command(&mut command(&restored));
    server.get(&format!("/v1/jobs/{done}/cameras")).expect(200);
    server.wait_for_state(&running, "succeeded");
}

#[test]
fn commands_beside_a_service_read_its_data_folder() {
    let place = tempfile::tempdir().unwrap();
    let data = place.path().join("data");
    std::fs::write(place.path().join("wandless.toml"), format!("data = {:?}\n", data.to_str().unwrap())).unwrap();
    let run = |words: &[&str], data: Option<&Path>| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_wandless"));
        let output = command.current_dir(place.path()).args(words).envs(data.map(|data| ("WANDLESS_DATA", data)));
        let output = output.output().unwrap();
        assert!(output.status.success(), "{words:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    run(&["body", "export", "--out", "body.npz"], None);
    run(&["body", "add", "studio", "body.npz"], Some(&data));
    let listed = [
        run(&["body", "list"], Some(&data)),
        run(&["body", "list", "--config", "wandless.toml"], None),
        run(&["body", "list", "--data", "data"], Some(Path::new("elsewhere"))),
    ];
    assert!(listed.iter().all(|bodies| bodies.starts_with("studio: ")), "{listed:?}");
    assert!(!place.path().join("wandless-data").exists(), "another folder was made");
}

/// A nightly backup without the lost session would pass for complete.
#[test]
fn backup_names_a_lost_file_and_a_folder_without_database() {
    if is_of_sqlite_alone("backup") {
        return;
    }
    let (server, place) = (Server::start(), tempfile::tempdir().unwrap());
    server.upload(10, 1);
    std::fs::remove_file(server.files("sessions").remove(0)).unwrap();
    let back_up = |data: &Path| {
        let output = wandless(&["backup", "--data"], &[data, &place.path().join("nightly")]);
        assert_eq!(output.status.code(), Some(1));
        String::from_utf8(output.stderr).unwrap()
    };
    let lost = back_up(server.data());
    assert!(lost.contains("sessions/session_") && lost.contains("missing or damaged"), "{lost}");
    let none = back_up(&server.data().join("tmp"));
    assert!(none.contains("wandless.db"), "{none}");
    assert!(!place.path().join("nightly").exists());
    let mistyped = place.path().join("mistyped");
    let output = wandless(&["key", "list", "--data"], &[&mistyped]);
    assert_eq!((output.status.code(), mistyped.exists()), (Some(2), false), "a folder was made");
}

#[test]
fn backup_takes_relative_names_and_includes_bodies() {
    if is_of_sqlite_alone("backup") {
        return;
    }
    let server = Server::start();
    let id = server.submit(&server.upload(10, 1));
    server.wait_for_state(&id, "succeeded");
    let data = server.data().to_owned();
    let place = tempfile::tempdir().unwrap();
    let body = place.path().join("body.npz");
    assert!(wandless(&["body", "export", "--out"], &[&body]).status.success());
    assert!(wandless(&["body", "add", "--data"], &[&data, Path::new("studio"), &body]).status.success());
    std::fs::create_dir(place.path().join("nightly.tmp")).unwrap();
    std::fs::write(place.path().join("nightly.tmp/notes"), b"of another program").unwrap();
    let run = |words: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_wandless"));
        let output = command.current_dir(place.path()).args(words).output().unwrap();
        assert!(output.status.success(), "{words:?}: {}", String::from_utf8_lossy(&output.stderr));
    };
    run(&["backup", "nightly.2026-11-22", "--data", data.to_str().unwrap()]);
    run(&["restore", "nightly.2026-11-22", "--data", "restored"]);
    run(&["verify", "nightly.2026-11-22"]);
    for folder in ["nightly.2026-11-22", "restored"] {
        let folder = place.path().join(folder);
        let bodies = crate::server::files_below(&folder.join("bodies"));
        assert_eq!(bodies.len(), 2, "{bodies:?}");
        let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
        assert_eq!((mode(&folder), mode(&folder.join("wandless.db")), mode(&bodies[0])), (0o700, 0o600, 0o600));
    }
    let body = &crate::server::files_below(&place.path().join("nightly.2026-11-22/bodies"))[0];
    std::fs::write(body, b"damaged").unwrap();
    assert_eq!(wandless(&["verify"], &[&place.path().join("nightly.2026-11-22")]).status.code(), Some(1));
}

#[test]
fn verify_finds_every_flipped_bit() {
    if is_of_sqlite_alone("verify") {
        return;
    }
    let server = Server::start();
    let id = server.submit(&server.upload(10, 1));
    server.wait_for_state(&id, "succeeded");
    let data = server.stopped();
    assert!(wandless(&["verify"], &[data.path()]).status.success());
    let mut files: Vec<std::path::PathBuf> = vec![data.path().join("wandless.db")];
    for folder in ["sessions", "results"] {
        files.extend(crate::server::files_below(&data.path().join(folder)));
    }
    for (i, path) in files.iter().enumerate() {
        let whole = std::fs::read(path).unwrap();
        let mut bytes = whole.clone();
        let at = (7919 * (i + 1)) % bytes.len();
        bytes[at] ^= 1;
        std::fs::write(path, bytes).unwrap();
        let output = wandless(&["verify"], &[data.path()]);
        let text = String::from_utf8(output.stdout).unwrap();
        let name = path.strip_prefix(data.path()).unwrap().to_str().unwrap();
        assert!(output.status.code() == Some(1) && text.contains(&format!("damaged: {name}")), "{name}: {text}");
        std::fs::write(path, whole).unwrap();
    }
}

#[test]
fn busy_service_stops_quickly_without_an_attempt() {
    let server = Server::start();
    let id = server.submit(&server.upload(LONG, 1));
    server.wait_for_state(&id, "running");
    let idle: Vec<_> = (0..50).map(|_| std::net::TcpStream::connect(server.address()).unwrap()).collect();
    let address = server.address().to_owned();
    let waiting = std::thread::spawn({
        let url = server.url(&format!("/v1/jobs/{id}?wait=60"));
        let tag = server.get(&format!("/v1/jobs/{id}")).header("etag").to_owned();
        move || send("GET", &url, &[("if-none-match", &tag)], None).status
    });
    std::thread::sleep(Duration::from_millis(200));
    signal(server.pid(), Signal::TERM);
    std::thread::sleep(Duration::from_millis(100));
    assert!(std::net::TcpStream::connect(address).is_err(), "a stopping service accepts no connections");
    let start = Instant::now();
    let server = server.ended_and_restarted();
    assert!(start.elapsed() < Duration::from_secs(10));
    assert!(matches!(waiting.join().unwrap(), 200 | 304));
    drop(idle);
    assert_eq!(server.wait_for_state(&id, "succeeded")["attempt"], 1);
}

#[test]
fn prints_settings_and_names_unknown_ones() {
    let printed = wandless(&["serve", "--print-settings", "--set", "limits.max_wait_s=7"], &[]);
    let text = String::from_utf8(printed.stdout).unwrap();
    assert!(text.contains("max_wait_s = 7.0") && text.contains("max_crashes = 3"), "{text}");
    let refused = wandless(&["serve", "--set", "limits.max_wiat_s=7"], &[]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(String::from_utf8(refused.stderr).unwrap().contains("max_wiat_s"));
}

#[test]
fn briefly_locked_database_loses_no_request() {
    if is_of_sqlite_alone("locks the database file") {
        return;
    }
    let server = Server::start();
    let session = server.upload(10, 1);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(server.data().join("wandless.db"));
    let holder = runtime.block_on(sqlx::SqlitePool::connect_with(options)).unwrap();
    let held = runtime.block_on(holder.begin_with("BEGIN IMMEDIATE")).unwrap();
    let id = std::thread::scope(|scope| {
        let asked = scope.spawn(|| server.submit(&session));
        std::thread::sleep(Duration::from_secs(1));
        server.get("/v1/jobs").expect(200);
        runtime.block_on(held.rollback()).unwrap();
        asked.join().unwrap()
    });
    server.wait_for_state(&id, "succeeded");
}
