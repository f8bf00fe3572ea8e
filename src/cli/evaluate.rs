//! `wandless evaluate`: a result against the truth.

use crate::evaluation::alignment::Alignment;
use crate::evaluation::{EvaluationOptions, evaluate};
use crate::session::recording::UpAxis;
use anyhow::Context;
use clap::ValueEnum;
use std::path::PathBuf;

/// Errors of cameras, poses and identities against truth, as a table and as JSON.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Result folder: cameras.json, keypoints3d.json, poses3d.json, identities.json, as far as they are there
    result: PathBuf,
    /// Truth folder, beside which the session lies (SESSION/gt)
    #[arg(long)]
    truth: PathBuf,
    /// How worlds are laid over each other before poses are compared [default: rigid; rigid-pose below three cameras]
    #[arg(long, value_enum)]
    align: Option<AlignName>,
    /// Up axis of the truth's world [default: as its files say, else z]
    #[arg(long, value_enum)]
    up: Option<UpName>,
    /// Whom averages are over, separated by commas [default: everybody; on Shelf 0,1,2]
    #[arg(long, value_delimiter = ',')]
    actors: Option<Vec<String>>,
    /// Print JSON; the table goes to standard error
    #[arg(long)]
    json: bool,
    /// Write the JSON to this file too
    #[arg(long)]
    out: Option<PathBuf>,
}

/// Alignments by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[allow(missing_docs)] // clap would print them; the library says what they mean
pub(super) enum AlignName {
    Rigid,
    Sim3,
    #[value(alias = "rigid_pose")]
    RigidPose,
    None,
}

/// Axes by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[allow(missing_docs)] // as above
pub(super) enum UpName {
    X,
    Y,
    Z,
}

/// Evaluates and prints.
///
/// # Errors
/// Files that are missing or contradict each other.
pub(super) fn run(args: Args) -> anyhow::Result<()> {
    let options = EvaluationOptions {
        align: args.align.map(|name| match name {
            AlignName::Rigid => Alignment::Rigid,
            AlignName::Sim3 => Alignment::Sim3,
            AlignName::RigidPose => Alignment::RigidPose,
            AlignName::None => Alignment::None,
        }),
        up: args.up.map(|name| match name {
            UpName::X => UpAxis::X,
            UpName::Y => UpAxis::Y,
            UpName::Z => UpAxis::Z,
        }),
        actors: args.actors,
    };
    let evaluation = evaluate(&args.result, &args.truth, &options)?;
    let json = serde_json::to_string_pretty(&evaluation)?;
    if let Some(path) = &args.out {
        std::fs::write(path, format!("{json}\n")).with_context(|| format!("{}: cannot be written", path.display()))?;
    }
    if args.json {
        eprint!("{evaluation}");
        println!("{json}");
    } else {
        print!("{evaluation}");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn a_simulated_truth_is_its_own_perfect_result() {
        use crate::session::formats::native::write_folder;
        use crate::simulation::{Preset, SimulationConfig, simulate, write_truth};
        let folder = tempfile::tempdir().unwrap();
        let config = SimulationConfig { frames: 30, ..SimulationConfig::preset(Preset::Hard) };
        let simulated = simulate(&config).unwrap();
        write_folder(&simulated.session, folder.path()).unwrap();
        write_truth(&simulated, folder.path()).unwrap();
        let (gt, out) = (folder.path().join("gt"), folder.path().join("errors.json"));
        let line =
            ["evaluate", &gt.to_string_lossy(), "--truth", &gt.to_string_lossy(), "--out", &out.to_string_lossy()];
        run(Cli::try_parse_from(line).unwrap().args).unwrap();
        let errors: serde_json::Value = serde_json::from_slice(&std::fs::read(out).unwrap()).unwrap();
        assert!(errors["cameras"]["rigid"]["position_mm"].as_f64().unwrap() < 1e-6);
        assert!(errors["mpjpe"]["raw14"].as_f64().unwrap() < 1e-6);
        assert_eq!(errors["joints_from"], "poses3d.json");
        assert_eq!(errors["other_poses"]["joints_from"], "keypoints3d.json");
        assert_eq!((&errors["pcp"]["average"], &errors["identity"]["accuracy"]), (&100.0.into(), &1.0.into()));
    }

    #[test]
    fn a_missing_truth_is_named() {
        let line = ["evaluate", "no/result", "--truth", "no/truth"];
        let error = run(Cli::try_parse_from(line).unwrap().args).unwrap_err();
        assert!(error.to_string().contains("no/truth"), "{error}");
    }
}
