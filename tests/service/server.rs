//! A service under test: the real binary, its own data folder, a free port.

use crate::http::{Answer, JSON, send};
use crate::store::{folder_of, program};
use crate::take::take;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Longest time for a small job on two busy cores.
const PATIENCE: Duration = Duration::from_secs(120);

pub struct Server {
    /// `None` after the process was awaited.
    process: Option<Child>,
    address: String,
    data: TempDir,
}

impl Server {
    pub fn start() -> Self {
        Self::on(tempfile::tempdir().unwrap())
    }

    /// With further arguments of `serve`.
    pub fn with(words: &[&str]) -> Self {
        let data = tempfile::tempdir().unwrap();
        let (process, address) = spawned(command(data.path()).args(words));
        Self { process: Some(process), address, data }
    }

    /// Runs a given command, which names the data folder.
    pub fn from_command(command: &mut Command) -> Self {
        let (process, address) = spawned(command);
        Self { process: Some(process), address, data: tempfile::tempdir().unwrap() }
    }

    fn on(data: TempDir) -> Self {
        let (process, address) = spawned(&mut command(data.path()));
        Self { process: Some(process), address, data }
    }

    /// Kills the service without warning, as a power failure does, and starts it again.
    pub fn killed_and_restarted(mut self) -> Self {
        let mut process = self.process.take().unwrap();
        process.kill().unwrap();
        process.wait().unwrap();
        self.restarted()
    }

    /// Stops the service with SIGTERM and starts it again.
    pub fn stopped_and_restarted(self) -> Self {
        signal(self.pid(), rustix::process::Signal::TERM);
        self.ended_and_restarted()
    }

    /// Waits for the end of a stopping service and starts it again.
    pub fn ended_and_restarted(mut self) -> Self {
        self.await_end();
        self.restarted()
    }

    /// Stops the service with SIGTERM and returns its data folder.
    pub fn stopped(mut self) -> TempDir {
        signal(self.pid(), rustix::process::Signal::TERM);
        self.await_end();
        std::mem::replace(&mut self.data, tempfile::tempdir().unwrap())
    }

    fn await_end(&mut self) {
        let start = Instant::now();
        assert!(self.process.take().unwrap().wait().unwrap().success());
        assert!(start.elapsed() < Duration::from_secs(10), "a stop took {:?}", start.elapsed());
    }

    pub fn pid(&self) -> u32 {
        self.process.as_ref().unwrap().id()
    }

    /// Its log, if the command pipes stderr.
    pub fn stderr(&mut self) -> std::process::ChildStderr {
        self.process.as_mut().unwrap().stderr.take().unwrap()
    }

    fn restarted(mut self) -> Self {
        let data = std::mem::replace(&mut self.data, tempfile::tempdir().unwrap());
        drop(self);
        Self::on(data)
    }

    pub fn address(&self) -> &str {
        &self.address
    }

    pub fn data(&self) -> &Path {
        self.data.path()
    }

    pub fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.address)
    }

    pub fn get(&self, path: &str) -> Answer {
        send("GET", &self.url(path), &[], None)
    }

    pub fn get_with(&self, path: &str, headers: &[(&str, &str)]) -> Answer {
        send("GET", &self.url(path), headers, None)
    }

    pub fn delete(&self, path: &str) -> Answer {
        send("DELETE", &self.url(path), &[], None)
    }

    pub fn post(&self, path: &str, headers: &[(&str, &str)], body: &[u8]) -> Answer {
        send("POST", &self.url(path), headers, Some(body))
    }

    pub fn post_json(&self, path: &str, body: &Value) -> Answer {
        self.post(path, &[JSON], body.to_string().as_bytes())
    }

    /// Uploads a session of `frames` frames and returns its id.
    pub fn upload(&self, frames: usize, seed: u32) -> String {
        let answer = self.post_json("/v1/sessions", &take(frames, seed));
        assert!(matches!(answer.status, 200 | 201), "{}", String::from_utf8_lossy(&answer.body));
        answer.json()["id"].as_str().unwrap().to_owned()
    }

    /// Submits a job for a session with fixed cameras.
    pub fn submit(&self, session: &str) -> String {
        let body = json!({ "session": session, "options": { "extrinsics": "fixed" } });
        self.post_json("/v1/jobs", &body).expect(202).json()["id"].as_str().unwrap().to_owned()
    }

    pub fn job(&self, id: &str) -> Value {
        self.get(&format!("/v1/jobs/{id}")).expect(200).json()
    }

    /// Follows a job until `is_reached`; checks that its fraction never falls.
    pub fn wait_until(&self, id: &str, is_reached: impl Fn(&Value) -> bool) -> Value {
        let deadline = Instant::now() + PATIENCE;
        let mut fraction = 0.0;
        loop {
            let job = self.get(&format!("/v1/jobs/{id}?wait=1")).expect(200).json();
            let next = job["progress"]["fraction"].as_f64().unwrap();
            assert!(next >= fraction, "the fraction fell from {fraction} to {next}");
            fraction = next;
            if is_reached(&job) {
                return job;
            }
            assert!(Instant::now() < deadline, "gave up waiting: {job}");
        }
    }

    pub fn wait_for_state(&self, id: &str, state: &str) -> Value {
        let is_final =
            |job: &Value| matches!(job["state"].as_str(), Some("succeeded" | "failed" | "canceled" | "dead"));
        let job = self.wait_until(id, |job| job["state"] == state || is_final(job));
        assert_eq!(job["state"], state, "{job}");
        job
    }

    /// Process ids of the children at work.
    pub fn children(&self) -> Vec<u32> {
        let entries = std::fs::read_dir("/proc").unwrap().flatten();
        let pids = entries.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
        pids.filter(|pid| parent(*pid) == Some(self.pid())).collect()
    }

    /// The child at work, once there is one. A child that has not yet begun its program is not: stopped there, it would
    /// stop the thread of the service that waits for the begin, too.
    pub fn child(&self) -> u32 {
        let deadline = Instant::now() + PATIENCE;
        let works =
            |pid: &u32| std::fs::read(format!("/proc/{pid}/cmdline")).is_ok_and(|line| has_word(&line, b"run-job"));
        loop {
            if let [pid] = self.children().into_iter().filter(works).collect::<Vec<_>>()[..] {
                return pid;
            }
            assert!(Instant::now() < deadline, "no child came up");
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// Every file below a folder of the data folder.
    pub fn files(&self, folder: &str) -> Vec<PathBuf> {
        files_below(&self.data.path().join(folder_of(folder)))
    }

    /// Number of files below a folder, as soon as it is not above `expected`: object stores remove after the client was answered.
    pub fn n_files_left(&self, folder: &str, expected: usize) -> usize {
        let deadline = Instant::now() + PATIENCE;
        while self.files(folder).len() > expected && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(10));
        }
        self.files(folder).len()
    }
}

/// Whether a command line, its words ended by zeros, has this word.
fn has_word(line: &[u8], word: &[u8]) -> bool {
    line.split(|byte| *byte == 0).any(|found| found == word)
}

impl Drop for Server {
    fn drop(&mut self) {
        if let Some(process) = &mut self.process {
            let _ = process.kill();
            let _ = process.wait();
        }
    }
}

fn spawned(command: &mut Command) -> (Child, String) {
    let mut process = command.stdout(Stdio::piped()).spawn().unwrap();
    let mut line = String::new();
    BufReader::new(process.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let address = line.trim().rsplit("http://").next().unwrap().replace("0.0.0.0", "127.0.0.1");
    assert!(address.starts_with("127.0.0.1:"), "the service said: {line}");
    (process, address)
}

/// Every file below a folder.
pub fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            if entry.path().is_dir() { folders.push(entry.path()) } else { files.push(entry.path()) }
        }
    }
    files
}

/// `wandless serve` on a data folder and a free port.
pub fn command(data: &Path) -> Command {
    let mut command = program(data);
    command.args(["serve", "--listen", "127.0.0.1:0", "--data"]).arg(data).env("WANDLESS_LOG", "warn");
    command
}

pub fn signal(pid: u32, signal: rustix::process::Signal) {
    let pid = rustix::process::Pid::from_raw(pid.try_into().unwrap()).unwrap();
    rustix::process::kill_process(pid, signal).unwrap();
}

/// The parent of a live process; zombies do not count.
fn parent(pid: u32) -> Option<u32> {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    let mut words = stat.rsplit(')').next()?.split_whitespace();
    let state = words.next()?;
    (state != "Z").then(|| words.next()?.parse().ok())?
}
