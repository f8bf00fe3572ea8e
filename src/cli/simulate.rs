//! Stand-in in this worktree only.
use std::path::PathBuf;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[arg(long)]
    out: PathBuf,
    #[arg(long, default_value_t = 2)]
    people: usize,
    #[arg(long, default_value_t = 4)]
    views: usize,
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

/// Runs the command.
pub(super) fn run(args: Args) -> anyhow::Result<()> {
    let _ = (args.people, args.views, args.seed);
    std::fs::create_dir_all(args.out.join("poses"))?;
    std::fs::create_dir_all(args.out.join("gt"))?;
    std::fs::write(
        args.out.join("session.json"),
        r#"{"name":"s","fps":25,"n_frames":40,"keypoint_convention":"coco17","cameras":[{"id":"a","width":640,"height":480,"K":[[500,0,320],[0,500,240],[0,0,1]],"dist":[0,0,0,0,0]}]}"#,
    )?;
    std::fs::write(args.out.join("poses/a.json"), r#"{"frames":[]}"#)?;
    Ok(())
}
