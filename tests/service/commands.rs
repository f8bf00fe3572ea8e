//! Commands without a service: what they refuse, and what they leave behind.

use std::path::Path;
use std::process::{Command, Stdio};

#[test]
fn a_reader_that_left_made_the_program_panic() {
    let mut command = Command::new(env!("CARGO_BIN_EXE_wandless"));
    let mut child = command.arg("openapi").stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!((output.status.code(), String::from_utf8(output.stderr).unwrap().as_str()), (Some(1), ""));
}

#[test]
fn continuing_from_no_result_was_silent() {
    let folder = tempfile::tempdir().unwrap();
    let [session, result, corrections] = ["session", "result", "corrections.json"].map(|name| folder.path().join(name));
    let run = |words: &[&str], out: &Path| {
        let output = Command::new(env!("CARGO_BIN_EXE_wandless")).args(words).arg("--out").arg(out).output().unwrap();
        let text = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{text}");
        text
    };
    std::fs::write(&corrections, r#"[{"action": "rename", "person": 0, "name": "Ada"}]"#).unwrap();
    let [session_name, corrections] = [&session, &corrections].map(|path| path.to_str().unwrap());
    run(&["simulate", "--preset", "easy", "--people", "1", "--views", "3", "--frames", "60"], &session);
    let words = ["reconstruct", session_name, "--corrections", corrections, "--continue", "/nowhere"];
    let text = run(&words, &result);
    assert!(text.contains("/nowhere: no result of this session"), "{text}");
}

#[test]
fn demo_solved_before_it_refused_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("notes.txt"), "mine").unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_wandless"));
    let output = command.args(["demo", "--dir"]).arg(folder.path()).output().unwrap();
    assert_eq!((output.status.code(), output.stdout.as_slice()), (Some(2), &b""[..]));
    assert_eq!(folder.path().read_dir().unwrap().count(), 1);
}
