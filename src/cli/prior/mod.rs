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
    /// Draw a motion from the prior
    Sample(motions::SampleArgs),
    /// Denoise a motion file and complete hidden joints
    Reconstruct(motions::ReconstructArgs),
}

/// Runs the command.
pub(super) fn run(args: Args) -> anyhow::Result<()> {
    match args.action {
        Action::Train(args) => train::run(args),
        Action::Eval(args) => eval::run(args),
        Action::Sample(args) => motions::sample(args),
        Action::Reconstruct(args) => motions::reconstruct(args),
    }
}
