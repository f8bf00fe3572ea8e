//! `wandless demo`: runs the commands `simulate`, `serve`, `submit` and `evaluate` in order.

use super::arguments::arguments_of;
use super::client::Client;
use super::noise::NoiseName;
use super::serve::StopSignals;
use super::submit::{download, submit};
use super::{evaluate, simulate};
use crate::pipeline::Options;
use crate::service::{self, Settings};
use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use tokio::runtime::Runtime;

/// Arguments of `demo`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder for all files [default: a new temporary folder, which is kept]
    #[arg(long)]
    dir: Option<PathBuf>,
    /// Seed of the simulation
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Kind of the detector's errors
    #[arg(long, value_enum, default_value_t = NoiseName::Real)]
    noise: NoiseName,
    /// Keep the service running until Ctrl-C
    #[arg(long)]
    keep: bool,
}

/// Runs the command.
pub(super) fn run(args: Args) -> anyhow::Result<()> {
    let dir = match args.dir {
        Some(dir) => dir,
        None => std::env::temp_dir().join(format!("wandless-demo-{}", uuid::Uuid::new_v4().simple())),
    };
    let session = dir.join("session");
    let result = dir.join("result");
    println!("simulating 3 people and 5 cameras: {}", session.display());
    simulate_session(&session, args.seed, args.noise)?;

    let runtime = Runtime::new()?;
    let listen = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
    let running = runtime.block_on(service::start(Settings::new(dir.join("data"), listen)?))?;
    let server = format!("http://{}", running.address);
    println!("serving {server}");
    let done = submit_and_evaluate(&server, &session, &result);
    if args.keep && done.is_ok() {
        println!("{server} keeps running; stop it with Ctrl-C");
        let hold = async {
            StopSignals::listen()?.next().await;
            std::io::Result::Ok(())
        };
        runtime.block_on(hold)?;
    }
    runtime.block_on(running.stop());
    done
}

fn submit_and_evaluate(server: &str, session: &Path, result: &Path) -> anyhow::Result<()> {
    let client = Client::new(server, None);
    let job = submit(&client, session, &serde_json::to_value(Options::default())?)?;
    println!("{server}/v1/jobs/{}: {}", job.id, job.quality.unwrap_or_default());
    download(&client, &job.id, result)?;
    println!("result: {}", result.display());
    evaluate_result(result, &session.join("gt"))
}

fn simulate_session(out: &Path, seed: u64, noise: NoiseName) -> anyhow::Result<()> {
    let seed = seed.to_string();
    let words = ["simulate", "--people", "3", "--views", "5", "--noise", noise.word(), "--seed", &seed, "--out"];
    let words = words.map(std::ffi::OsStr::new);
    simulate::run(arguments_of(words.into_iter().chain([out.as_os_str()]))?)
}

fn evaluate_result(result: &Path, truth: &Path) -> anyhow::Result<()> {
    let words = ["evaluate".as_ref(), result.as_os_str(), "--truth".as_ref(), truth.as_os_str()];
    evaluate::run(arguments_of(words)?)
}
