//! Crashes of the service and of child processes, and the commands that use the service.

use crate::server::{Server, signal};
use crate::store::is_of_sqlite_alone;
use crate::take::{LONG, take};
use rustix::process::Signal;
use std::process::Command;
use std::time::{Duration, Instant};

#[test]
fn child_ends_with_killed_service_and_job_resumes() {
    let mut server = Server::start();
    let id = server.submit(&server.upload(LONG, 1));
    let queued = server.submit(&server.upload(10, 2));
    for _ in 0..2 {
        let child = server.child();
        server = server.killed_and_restarted();
        let deadline = Instant::now() + Duration::from_secs(2);
        while std::fs::read_to_string(format!("/proc/{child}/stat")).is_ok_and(|stat| !stat.contains(") Z")) {
            assert!(Instant::now() < deadline, "the child outlived its service");
        }
    }
    let job = server.wait_for_state(&id, "succeeded");
    assert_eq!(job["attempt"], 1, "a crash of the service does not count as an attempt");
    server.wait_for_state(&queued, "succeeded");
    server.get(&format!("/v1/jobs/{id}/result")).expect(200);
}

#[test]
fn resumed_job_gives_the_same_bytes() {
    if is_of_sqlite_alone("checkpoints in the data folder") {
        return;
    }
    let data = tempfile::tempdir().unwrap();
    let start = || {
        let mut serve = crate::server::command(data.path());
        Server::from_command(serve.env("WANDLESS_LOG", "info").stderr(std::process::Stdio::piped()))
    };
    let server = start();
    let id = server.submit(&server.upload(LONG, 1));
    server.wait_until(&id, |job| job["progress"]["stage"] == "body_fit");
    let kept = crate::server::files_below(&data.path().join("checkpoints"));
    // Every pass before the body fit that this job runs: cameras, repair, held-out check, trajectories, check of the recording, scale.
    assert_eq!(kept.len(), 6, "{kept:?}");
    drop(server); // killed
    let mut server = start();
    let log = server.stderr();
    server.wait_for_state(&id, "succeeded");
    assert_eq!(crate::server::files_below(&data.path().join("checkpoints")).len(), 0);
    let session = server.job(&id)["session"].as_str().unwrap().to_owned();
    let whole = server.submit(&session);
    server.wait_for_state(&whole, "succeeded");
    let result = |id: &str| server.get(&format!("/v1/jobs/{id}/result")).expect(200).body;
    assert_eq!(result(&id), result(&whole));
    drop(server);
    let log = std::io::read_to_string(log).unwrap();
    assert_eq!(log.matches("resumed from its checkpoint").count(), 6, "{log}");
}

#[test]
fn stopped_service_requeues_its_job() {
    let server = Server::start();
    let id = server.submit(&server.upload(LONG, 1));
    server.wait_for_state(&id, "running");
    let server = server.stopped_and_restarted();
    assert_eq!(server.wait_for_state(&id, "succeeded")["attempt"], 1);
}

#[test]
fn job_is_dead_after_three_crashes_of_its_child() {
    let server = Server::start();
    let poison = server.submit(&server.upload(LONG, 1));
    let other = server.submit(&server.upload(10, 2));
    for _ in 0..3 {
        let child = server.child();
        signal(child, Signal::KILL);
        while server.children().contains(&child) {}
    }
    let job = server.wait_for_state(&poison, "dead");
    assert_eq!((&job["attempt"], &job["error"]["code"]), (&3.into(), &"child_died".into()));
    server.wait_for_state(&other, "succeeded");
}

#[test]
fn job_fails_if_its_session_file_is_missing() {
    if is_of_sqlite_alone("the cache has another copy") {
        return;
    }
    let server = Server::start();
    let busy = server.submit(&server.upload(LONG, 1));
    let id = server.submit(&server.upload(10, 2));
    let job = server.job(&id);
    std::fs::remove_file(server.data().join("sessions").join(job["session"].as_str().unwrap())).unwrap();
    server.delete(&format!("/v1/jobs/{busy}")).expect(204);
    let failed = server.wait_for_state(&id, "failed");
    assert!(failed["error"]["code"].is_string() && failed["error"]["detail"].is_string(), "{failed}");
}

#[test]
fn idle_service_stops_on_interrupt() {
    let data = tempfile::tempdir().unwrap();
    let mut process = crate::server::command(data.path()).stdout(std::process::Stdio::null()).spawn().unwrap();
    std::thread::sleep(Duration::from_millis(500));
    signal(process.id(), Signal::INT);
    let start = Instant::now();
    assert!(process.wait().unwrap().success());
    assert!(start.elapsed() < Duration::from_secs(10));
}

#[test]
fn submit_and_reconstruct_give_the_same_result() {
    let server = Server::start();
    let folder = tempfile::tempdir().unwrap();
    let (session, options) = (folder.path().join("take.json"), folder.path().join("options.json"));
    std::fs::write(&session, take(20, 1).to_string()).unwrap();
    std::fs::write(&options, r#"{"extrinsics": "fixed"}"#).unwrap();
    let run = |words: &[&str], out: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_wandless"));
        command.args(words).arg(&session).arg("--options").arg(&options).arg("--out").arg(folder.path().join(out));
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    };
    run(&["submit", "--server", &server.url("")], "submitted");
    run(&["reconstruct", "--threads", "1"], "reconstructed");
    for name in ["manifest.json", "cameras.json", "people.json", "report.json"] {
        let bytes = |out: &str| std::fs::read(folder.path().join(out).join(name)).unwrap();
        assert_eq!(bytes("submitted"), bytes("reconstructed"), "{name}");
    }
}
