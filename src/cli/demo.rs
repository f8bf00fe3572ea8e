//! `wandless demo`: runs the commands `simulate`, `serve`, `submit` and `evaluate` in order.

use super::arguments::arguments_of;
use super::client::Client;
use super::noise::NoiseName;
use super::output_folder::require_free;
use super::serve::StopSignals;
use super::submit::{download, submit};
use super::summary::Summary;
use super::{evaluate as evaluation_command, simulate};
use crate::evaluation::alignment::Alignment;
use crate::evaluation::{Evaluation, EvaluationOptions, evaluate};
use crate::pipeline::Options;
use crate::service::{self, Settings};
use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use tokio::runtime::Runtime;

/// Arguments of `demo`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder for all files, must be empty or not exist [default: a new temporary folder, which is kept]
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
        Some(dir) => {
            require_free(&dir)?;
            dir
        }
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
    let job = submit(&client, session, &Options::default())?;
    download(&client, &job.id, result)?;
    let truth = session.join("gt");
    let figures = result.with_file_name("evaluation.json");
    evaluate_result(result, &truth, &figures)?;
    let alignment = EvaluationOptions { align: Some(Alignment::Sim3), ..EvaluationOptions::default() };
    let errors = evaluate(result, &truth, &alignment)?;
    println!("\n{}\n", in_words(&errors, Summary::of_folder(result)?.verdict()));
    println!("figures: {}", figures.display());
    println!("result: {0}; to look at it: wandless view {0}", result.display());
    println!("viewer, while the service runs: {server}/#/jobs/{}", job.id);
    Ok(())
}

/// The outcome in one paragraph. `errors`: after an alignment that removes the error of the scale.
fn in_words(errors: &Evaluation, verdict: &str) -> String {
    let mut text = String::from("From 2D poses alone, without calibration and identities:");
    if let Some(cameras) = errors.cameras.as_ref().map(|cameras| &cameras.sim3) {
        let (mm, deg) = (cameras.position_mm.unwrap_or(f64::NAN), cameras.angle_deg.unwrap_or(f64::NAN));
        text += &format!(" {} cameras within {mm:.1} mm and {deg:.2} degrees of the truth,", cameras.n_cameras);
    }
    if let Some(mm) = errors.poses.as_ref().and_then(|poses| poses.mpjpe.raw12) {
        let people = errors.identity.as_ref().map_or(0, |identity| identity.people_predicted);
        text += &format!(" {people} people within {mm:.0} mm (mean over the limb joints)");
    }
    if let Some(identity) = &errors.identity {
        text += &format!(", {:.1} % of the assigned detections given to the right person", 100.0 * identity.accuracy);
    }
    text.push('.');
    if let Some(cameras) = &errors.cameras {
        let percent = 100.0 * (1.0 / cameras.sim3.scale - 1.0);
        let direction = if percent < 0.0 { "small" } else { "large" };
        text += &format!(
            " The metric scale is {:.1} % too {direction}, and the errors above are without it: bodies alone determine the \
             scale to some 3 % in the median, a known height or camera distance (--height, --camera-distance) much better.",
            percent.abs()
        );
    }
    text + &format!(" Verdict: {verdict}.")
}

fn simulate_session(out: &Path, seed: u64, noise: NoiseName) -> anyhow::Result<()> {
    let seed = seed.to_string();
    let words = ["simulate", "--people", "3", "--views", "5", "--noise", noise.word(), "--seed", &seed, "--out"];
    let words = words.map(std::ffi::OsStr::new);
    simulate::simulate_into_folder(&arguments_of(words.into_iter().chain([out.as_os_str()]))?)?;
    Ok(())
}

fn evaluate_result(result: &Path, truth: &Path, out: &Path) -> anyhow::Result<()> {
    let words = ["evaluate".as_ref(), result.as_os_str(), "--truth".as_ref(), truth.as_os_str()];
    let words = words.into_iter().chain(["--out".as_ref(), out.as_os_str()]);
    evaluation_command::run(arguments_of(words)?)
}
