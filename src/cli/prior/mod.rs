//! `wandless prior`: trains, evaluates and samples the motion prior.

mod eval;
mod motions;
mod prior_file;
mod train;

/// Arguments of `prior`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Train a prior on motion files in the AMASS layout
    Train(train::Args),
    /// Evaluate a prior on held-out motion files
    Eval(eval::Args),
    /// Sample a motion from the prior
    Sample(motions::SampleArgs),
    /// Encode and decode a motion file
    Reconstruct(motions::ReconstructArgs),
    /// Interpolate between two motions in the latent space
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
