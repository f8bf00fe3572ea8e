//! Commands without a service: what they refuse, and what they leave behind.

use std::process::Command;

#[test]
fn demo_solved_before_it_refused_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("notes.txt"), "mine").unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_wandless"));
    let output = command.args(["demo", "--dir"]).arg(folder.path()).output().unwrap();
    assert_eq!((output.status.code(), output.stdout.as_slice()), (Some(2), &b""[..]));
    assert_eq!(folder.path().read_dir().unwrap().count(), 1);
}
