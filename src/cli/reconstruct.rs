//! `wandless reconstruct`: runs the pipeline without a server.

use super::bad_input::BadInput;
use super::body::read_body;
use super::option_flags::OptionArgs;
use super::output_folder::{publish, require_free, staging_folder};
use super::progress_display::ProgressDisplay;
use super::solve::{SolveError, SolveFiles, solve, use_threads};
use super::summary::Summary;
use crate::pipeline::config::DEFAULT_BODY;
use crate::pipeline::provisional::Watcher;
use crate::pipeline::{Options, PipelineError};
use crate::progress::{Progress, ProgressEvent};
use std::path::PathBuf;
use std::sync::Arc;

/// Arguments of `reconstruct`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Session: a folder, a zip file or a JSON document
    session: PathBuf,
    /// Result folder; must be empty or not exist
    #[arg(long)]
    out: PathBuf,
    /// Result folder of the same session with the same options, from which a solve with --corrections continues
    #[arg(long, value_name = "RESULT", requires = "corrections")]
    r#continue: Option<PathBuf>,
    /// JSON file that maps face and foot keypoints to vertices of the body model of --body
    #[arg(long, requires = "body")]
    landmarks: Option<PathBuf>,
    /// Number of solver threads; 0 uses all cores
    #[arg(long, default_value_t = 0)]
    threads: usize,
    #[command(flatten)]
    options: OptionArgs,
}

/// Runs the command.
///
/// # Errors
/// [`BadInput`] for an unusable session or option; [`RejectedResult`](super::summary::RejectedResult) after the result was
/// written, if its verdict is `reject`.
pub(super) fn run(args: Args) -> anyhow::Result<()> {
    let mut options = args.options.read()?;
    let body = body_file(&args.options, &mut options)?;
    let body = read_body(body.as_deref(), args.landmarks.as_deref())?;
    require_free(&args.out)?;
    use_threads(args.threads);
    let display = Arc::new(ProgressDisplay::new());
    let shown = display.clone();
    let show = move |event: &ProgressEvent| shown.show(event.stage, event.fraction, &event.message);
    let staging = staging_folder(&args.out)?;
    let earlier = Vec::from_iter(args.r#continue);
    let files =
        SolveFiles { session: &args.session, sha256: None, checkpoints: None, earlier: &earlier, out: &staging };
    let solved = solve(&files, &options, &body, &Watcher::none(), &Progress::new(show, Arc::default()));
    display.finish();
    publish(&staging, &args.out, solved.map_err(input_or_failure))?;
    let summary = Summary::of_folder(&args.out)?;
    print!("{summary}");
    println!("result: {0}; to look at it: wandless view {0}", args.out.display());
    summary.accepted()
}

/// The body model's file from the flag `--body`, which in this command names a file.
fn body_file(given: &OptionArgs, options: &mut Options) -> Result<Option<PathBuf>, BadInput> {
    if options.body == DEFAULT_BODY {
        return Ok(None);
    }
    if !given.has_flag("body") {
        let reason = "registered body names exist in the service only; pass the body file with --body";
        return Err(BadInput(format!("/body: {reason}")));
    }
    Ok(Some(PathBuf::from(std::mem::replace(&mut options.body, DEFAULT_BODY.to_owned()))))
}

/// Separates unusable input (exit code 2) from failures.
fn input_or_failure(error: SolveError) -> anyhow::Error {
    match error {
        SolveError::Upload(error) => BadInput(error.to_string()).into(),
        SolveError::Pipeline(error @ PipelineError::Option { .. }) => BadInput(error.to_string()).into(),
        other => other.into(),
    }
}
