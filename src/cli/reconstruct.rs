//! `wandless reconstruct`: the pipeline without a server.

use super::BadInput;
use super::body::read_body;
use super::meter::Meter;
use super::solve::{SolveError, solve, use_threads};
use crate::pipeline::config::DEFAULT_BODY;
use crate::pipeline::{Options, PipelineError};
use crate::progress::{Progress, ProgressEvent};
use anyhow::Context;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Arguments of `reconstruct`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Session: a folder, a zip or a JSON document
    session: PathBuf,
    /// Folder for the result; must not exist, or be empty
    #[arg(long)]
    out: PathBuf,
    /// JSON file with options
    #[arg(long)]
    options: Option<PathBuf>,
    /// Body model: a SMPL .npz or .pkl file of yours; the embedded one is the default
    #[arg(long)]
    body: Option<PathBuf>,
    /// JSON file that says where keypoints of face and feet lie on that body
    #[arg(long, requires = "body")]
    landmarks: Option<PathBuf>,
    /// Solver threads; 0 takes all cores
    #[arg(long, default_value_t = 0)]
    threads: usize,
}

/// Runs the command.
pub(super) fn run(args: Args) -> anyhow::Result<()> {
    let options = read_options(args.options.as_deref())?;
    if args.body.is_none() && options.body != DEFAULT_BODY {
        let reason = "names of bodies are the service's; give the file itself with --body";
        return Err(BadInput(format!("/body: {reason}")).into());
    }
    let body = read_body(args.body.as_deref(), args.landmarks.as_deref())?;
    require_free(&args.out)?;
    use_threads(args.threads);
    let meter = Arc::new(Meter::new());
    let shown = meter.clone();
    let show = move |event: &ProgressEvent| shown.show(event.stage, event.fraction, &event.message);
    let staging = staging_folder(&args.out)?;
    let solved = solve(&args.session, None, &options, &body, None, &staging, &Progress::new(show, Arc::default()));
    meter.finish();
    if solved.is_err() {
        let _ = std::fs::remove_dir_all(&staging); // half a result helps nobody
    }
    let quality = solved.map_err(explain)?;
    std::fs::rename(&staging, &args.out).with_context(|| args.out.display().to_string())?;
    println!("{}: {}", args.out.display(), serde_json::to_string(&quality)?);
    Ok(())
}

/// Options from a JSON file, or the defaults.
pub(super) fn read_options(file: Option<&Path>) -> anyhow::Result<Options> {
    let Some(file) = file else { return Ok(Options::default()) };
    let bad = |reason: String| BadInput(format!("{}: {reason}; see the list of options", file.display()));
    let text = std::fs::read(file).map_err(|error| bad(error.to_string()))?;
    Ok(serde_json::from_slice(&text).map_err(|error| bad(error.to_string()))?)
}

/// A result is never mixed with other files.
pub(super) fn require_free(out: &Path) -> anyhow::Result<()> {
    let is_taken = match std::fs::read_dir(out) {
        Ok(mut entries) => entries.next().is_some(),
        Err(_) => out.exists(),
    };
    if is_taken {
        let remedy = "name a folder that does not exist, or an empty one";
        return Err(BadInput(format!("{}: the folder is not empty; {remedy}", out.display())).into());
    }
    Ok(())
}

/// `<out>.tmp` beside the result to be: whoever sees the result sees all of it.
pub(super) fn staging_folder(out: &Path) -> anyhow::Result<PathBuf> {
    let mut name = out.file_name().map(ToOwned::to_owned).unwrap_or_default();
    name.push(".tmp");
    let staging = out.with_file_name(name);
    if staging.exists() {
        std::fs::remove_dir_all(&staging).with_context(|| staging.display().to_string())?;
    }
    std::fs::create_dir_all(&staging).with_context(|| staging.display().to_string())?;
    Ok(staging)
}

fn explain(error: SolveError) -> anyhow::Error {
    match error {
        SolveError::Upload(error) => BadInput(error.to_string()).into(),
        SolveError::Pipeline(error @ PipelineError::Option { .. }) => BadInput(error.to_string()).into(),
        other => other.into(),
    }
}
