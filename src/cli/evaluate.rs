//! `wandless evaluate`: compares a result with the ground truth.

use super::bad_input::BadInput;
use crate::evaluation::alignment::Alignment;
use crate::evaluation::{EvaluationOptions, evaluate};
use crate::session::recording::UpAxis;
use anyhow::Context;
use clap::ValueEnum;
use std::path::PathBuf;

/// Compares a result with the ground truth: errors of cameras, poses and identities, as a table and as JSON.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Result folder with any of cameras.json, keypoints3d.json, poses3d.json and identities.json
    result: PathBuf,
    /// Ground truth folder inside the session folder (SESSION/gt)
    #[arg(long)]
    truth: PathBuf,
    /// Alignment of the two worlds before poses are compared [default: rigid; rigid-pose with fewer than three cameras]
    #[arg(long, value_enum)]
    align: Option<AlignName>,
    /// Up axis of the ground truth [default: read from its files, otherwise z]
    #[arg(long, value_enum)]
    up: Option<UpName>,
    /// People to average over, separated by commas [default: all; on Shelf 0,1,2]
    #[arg(long, value_delimiter = ',')]
    actors: Option<Vec<String>>,
    /// Print JSON to standard output and the table to standard error
    #[arg(long)]
    json: bool,
    /// Also write the JSON to this file
    #[arg(long)]
    out: Option<PathBuf>,
}

/// Values of `--align`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[allow(missing_docs)] // clap would print them; `Alignment` documents them
pub(super) enum AlignName {
    Rigid,
    Sim3,
    #[value(alias = "rigid_pose")]
    RigidPose,
    None,
}

/// Values of `--up`.
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
/// [`BadInput`] for missing or contradictory files.
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
    let evaluation = evaluate(&args.result, &args.truth, &options).map_err(|error| BadInput(error.to_string()))?;
    let json = serde_json::to_string_pretty(&evaluation)?;
    if let Some(path) = &args.out {
        std::fs::write(path, format!("{json}\n")).with_context(|| format!("cannot write {}", path.display()))?;
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
    use crate::cli::arguments::arguments_of;

    #[test]
    fn truth_compared_with_itself_has_no_error() {
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
        run(arguments_of(line).unwrap()).unwrap();
        let errors: serde_json::Value = serde_json::from_slice(&std::fs::read(&out).unwrap()).unwrap();
        assert!(errors["cameras"]["rigid"]["position_mm"].as_f64().unwrap() < 1e-6);
        assert!(errors["mpjpe"]["raw14"].as_f64().unwrap() < 1e-6);
        assert_eq!(errors["joints_from"], "poses3d.json");
        assert_eq!(errors["other_poses"]["joints_from"], "keypoints3d.json");
        assert_eq!((&errors["pcp"]["average"], &errors["identity"]["accuracy"]), (&100.0.into(), &1.0.into()));
        let unknown = run(arguments_of(line.into_iter().chain(["--actors", "0,9"])).unwrap()).unwrap_err();
        assert!(unknown.is::<BadInput>() && unknown.to_string().contains("no person \"9\""), "{unknown}");
    }

    #[test]
    fn names_missing_truth_folder() {
        let line = ["evaluate", "no/result", "--truth", "no/truth"];
        let error = run(arguments_of(line).unwrap()).unwrap_err();
        assert!(error.is::<BadInput>() && error.to_string().contains("no/truth"), "{error}");
    }
}
