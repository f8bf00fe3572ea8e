//! `wandless prior`: train the motion prior, measure it, look at what it does.

mod eval;
mod motions;
mod train;

use super::BadInput;
use crate::motion_prior::MotionPrior;
use std::path::Path;

/// Arguments of `prior`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Train a prior on motion files in AMASS's layout
    Train(train::Args),
    /// Measure a prior on motion files that it was not trained on
    Eval(eval::Args),
    /// Draw a motion from the prior
    Sample(motions::SampleArgs),
    /// Pass a motion file through encoder and decoder
    Reconstruct(motions::ReconstructArgs),
    /// Lead one motion over into another in the latent space
    Interpolate(motions::InterpolateArgs),
}

/// Runs the command.
pub(super) fn run(args: Args) -> anyhow::Result<()> {
    match args.action {
        Action::Train(args) => train::run(args),
        Action::Eval(args) => eval::run(args),
        Action::Sample(args) => motions::sample(args),
        Action::Reconstruct(args) => motions::reconstruct(args),
        Action::Interpolate(args) => motions::interpolate(args),
    }
}

/// The prior of a file, or the embedded one.
fn read_prior(file: Option<&Path>) -> anyhow::Result<MotionPrior> {
    let Some(file) = file else { return Ok(MotionPrior::embedded().clone()) };
    let bad = |reason: String| BadInput(format!("{}: {reason}", file.display()));
    let bytes = std::fs::read(file).map_err(|error| bad(error.to_string()))?;
    Ok(MotionPrior::from_bytes(&bytes).map_err(|error| bad(error.to_string()))?)
}
