//! Stand-in in this worktree only.
use std::path::PathBuf;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    result: PathBuf,
    #[arg(long)]
    truth: PathBuf,
}

/// Runs the command.
pub(super) fn run(args: Args) -> anyhow::Result<()> {
    println!("{} {}", args.result.display(), args.truth.display());
    Ok(())
}
