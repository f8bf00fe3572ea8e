//! `wandless reconstruct`: runs the pipeline without a server.

use super::bad_input::BadInput;
use super::body::read_body;
use super::output_folder::{publish, require_free, staging_folder};
use super::progress_display::ProgressDisplay;
use super::solve::{SolveError, solve, use_threads};
use crate::pipeline::config::DEFAULT_BODY;
use crate::pipeline::{Options, PipelineError};
use crate::progress::{Progress, ProgressEvent};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Arguments of `reconstruct`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Session: a folder, a zip file or a JSON document
    session: PathBuf,
    /// Result folder; must be empty or not exist
    #[arg(long)]
    out: PathBuf,
    /// JSON file with job options
    #[arg(long)]
    options: Option<PathBuf>,
    /// Body model, a SMPL .npz or .pkl file [default: the embedded model]
    #[arg(long)]
    body: Option<PathBuf>,
    /// JSON file that maps face and foot keypoints to vertices of that body model
    #[arg(long, requires = "body")]
    landmarks: Option<PathBuf>,
    /// Number of solver threads; 0 uses all cores
    #[arg(long, default_value_t = 0)]
    threads: usize,
}

/// Runs the command.
pub(super) fn run(args: Args) -> anyhow::Result<()> {
    let options = read_options(args.options.as_deref())?;
    if args.body.is_none() && options.body != DEFAULT_BODY {
        let reason = "registered body names exist in the service only; pass the body file with --body";
        return Err(BadInput(format!("/body: {reason}")).into());
    }
    let body = read_body(args.body.as_deref(), args.landmarks.as_deref())?;
    require_free(&args.out)?;
    use_threads(args.threads);
    let display = Arc::new(ProgressDisplay::new());
    let shown = display.clone();
    let show = move |event: &ProgressEvent| shown.show(event.stage, event.fraction, &event.message);
    let staging = staging_folder(&args.out)?;
    let solved = solve(&args.session, None, &options, &body, None, &staging, &Progress::new(show, Arc::default()));
    display.finish();
    let quality = publish(&staging, &args.out, solved.map_err(input_or_failure))?;
    println!("{}: {}", args.out.display(), serde_json::to_string(&quality)?);
    Ok(())
}

/// Reads options from a JSON file; without a file the defaults.
pub(super) fn read_options(file: Option<&Path>) -> anyhow::Result<Options> {
    let Some(file) = file else { return Ok(Options::default()) };
    let bad = |reason: String| {
        BadInput(format!("{}: {reason}; see `options` in the API description (`wandless openapi`)", file.display()))
    };
    let text = std::fs::read(file).map_err(|error| bad(error.to_string()))?;
    Ok(serde_json::from_slice(&text).map_err(|error| bad(error.to_string()))?)
}

/// Separates unusable input (exit code 2) from failures.
fn input_or_failure(error: SolveError) -> anyhow::Error {
    match error {
        SolveError::Upload(error) => BadInput(error.to_string()).into(),
        SolveError::Pipeline(error @ PipelineError::Option { .. }) => BadInput(error.to_string()).into(),
        other => other.into(),
    }
}
