//! `wandless bench ablation`: what each part of the method is worth, on sessions with truth.
//!
//! Every session is solved whole and with one part left out, cameras unknown and given. The points of bundle adjustment come
//! from the whole solve: they are what its bodies are fitted to.

use crate::cli::BadInput;
use crate::cli::solve::use_threads;
use crate::evaluation::alignment::Alignment;
use crate::evaluation::documents::read_cameras;
use crate::evaluation::report::PoseErrors;
use crate::evaluation::{Evaluation, EvaluationOptions, evaluate};
use crate::export::{ResultContext, write_result};
use crate::pipeline::config::Extrinsics;
use crate::pipeline::{Options, reconstruct};
use crate::progress::Progress;
use crate::session::Session;
use crate::session::upload::{UploadLimits, read_path};
use anyhow::Context;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What is solved, and where results stay.
#[derive(Debug, clap::Args)]
pub(super) struct AblationArgs {
    /// Sessions with their truth beside them (SESSION/gt); more than one gives means and spreads
    #[arg(required = true)]
    sessions: Vec<PathBuf>,
    /// Folder for every result and for ablation.md and ablation.json; must not exist
    #[arg(long)]
    out: PathBuf,
    /// Solver threads; 0 takes all cores
    #[arg(long, default_value_t = 0)]
    threads: usize,
}

/// One way of solving.
struct Arm {
    name: &'static str,
    options: fn() -> Options,
}

const WHOLE: &str = "whole";
/// The keypoints of the whole solve.
const POINTS: &str = "bundle adjustment only";

const ARMS: [Arm; 3] = [
    Arm { name: WHOLE, options: Options::default },
    Arm { name: "without consistency", options: || Options { denoise: false, ..Options::default() } },
    Arm { name: "without collision", options: || Options { collision: false, ..Options::default() } },
];

/// Figures of one solve, in the order of the table's columns; `None` where the truth does not tell.
type Figures = BTreeMap<&'static str, Option<f64>>;

/// Columns: name, decimals.
const COLUMNS: [(&str, usize); 9] = [
    ("camera mm", 2),
    ("camera deg", 3),
    ("PCP %", 2),
    ("root12 mm", 2),
    ("raw12 mm", 2),
    ("acceleration error mm/frame^2", 2),
    ("jitter of truth", 3),
    ("identity accuracy", 4),
    ("deepest overlap mm", 1),
];

/// All sessions of one arm.
#[derive(Debug, Serialize)]
struct Row {
    cameras: &'static str,
    arm: &'static str,
    sessions: Vec<Figures>,
}

pub(super) fn run(args: &AblationArgs) -> anyhow::Result<()> {
    use_threads(args.threads);
    if args.out.exists() {
        return Err(BadInput(format!("{}: exists; name a folder that does not", args.out.display())).into());
    }
    let mut rows: Vec<Row> = Vec::new();
    for (k, path) in args.sessions.iter().enumerate() {
        let limits = UploadLimits::default();
        let loaded = read_path(path, &limits).map_err(|e| BadInput(format!("{}: {e}", path.display())))?;
        let truth = path.join("gt");
        for (cameras, session, extrinsics) in both_ways(loaded.session, &truth)? {
            for arm in &ARMS {
                let out = args.out.join(format!("{k}-{cameras}-{}", arm.name.replace(' ', "-")));
                let options = Options { extrinsics, ..(arm.options)() };
                let started = Instant::now();
                let (errors, overlap_mm) = solved(&session, &options, &loaded.sha256, &truth, &out)?;
                eprintln!("{} {cameras} {}: {:.1} s", path.display(), arm.name, started.elapsed().as_secs_f64());
                if arm.name == WHOLE {
                    add(&mut rows, cameras, POINTS, figures(&errors, errors.other_poses.as_ref(), None));
                }
                add(&mut rows, cameras, arm.name, figures(&errors, errors.poses.as_ref(), Some(overlap_mm)));
            }
        }
    }
    let table = markdown(&rows);
    print!("{table}");
    std::fs::write(args.out.join("ablation.md"), table)?;
    std::fs::write(args.out.join("ablation.json"), serde_json::to_string_pretty(&rows)?)?;
    Ok(())
}

/// The session without its cameras, and with the true ones.
fn both_ways(session: Session, truth: &Path) -> anyhow::Result<[(&'static str, Session, Extrinsics); 2]> {
    let cameras = read_cameras(&truth.join("cameras.json")).map_err(|e| BadInput(e.to_string()))?;
    let mut given = session.clone();
    for view in &mut given.views {
        let missing = || BadInput(format!("{}: no camera {}", truth.join("cameras.json").display(), view.id));
        view.camera_from_world = Some(*cameras.get(&view.id).ok_or_else(missing)?);
    }
    Ok([("free", session, Extrinsics::Estimate), ("fixed", given, Extrinsics::Fixed)])
}

/// Solves, writes the result and compares it with the truth; beside the errors the deepest overlap of two bodies, mm.
fn solved(
    session: &Session,
    options: &Options,
    input_sha256: &str,
    truth: &Path,
    out: &Path,
) -> anyhow::Result<(Evaluation, f64)> {
    let found = reconstruct(session, options, &Progress::silent())?;
    let context = ResultContext {
        input_sha256,
        options: serde_json::to_value(options)?,
        solver_version: env!("CARGO_PKG_VERSION"),
        exports: &[],
    };
    std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    write_result(out, session, &context, &found)?;
    let align = if options.extrinsics == Extrinsics::Fixed { Alignment::None } else { Alignment::Sim3 };
    let options = EvaluationOptions { align: Some(align), ..EvaluationOptions::default() };
    let errors = evaluate(out, truth, &options).map_err(|e| BadInput(e.to_string()))?;
    Ok((errors, found.report.penetration.deepest.map_or(0.0, |overlap| overlap.depth_mm)))
}

fn figures(errors: &Evaluation, poses: Option<&PoseErrors>, overlap_mm: Option<f64>) -> Figures {
    let cameras = errors.cameras.as_ref().map(|cameras| &cameras.sim3);
    let ratio = |p: &PoseErrors| Some(p.jitter.pred.m_per_s2? / p.jitter.gt.m_per_s2?);
    let values = [
        cameras.and_then(|c| c.position_mm),
        cameras.and_then(|c| c.angle_deg),
        poses.and_then(|p| p.pcp.average),
        poses.and_then(|p| p.mpjpe.root12),
        poses.and_then(|p| p.mpjpe.raw12),
        poses.and_then(|p| p.jitter.error_mm_per_frame2),
        poses.and_then(ratio),
        errors.identity.as_ref().map(|i| i.accuracy),
        overlap_mm,
    ];
    COLUMNS.iter().map(|(name, _)| *name).zip(values).collect()
}

fn add(rows: &mut Vec<Row>, cameras: &'static str, arm: &'static str, figures: Figures) {
    match rows.iter_mut().find(|row| row.cameras == cameras && row.arm == arm) {
        Some(row) => row.sessions.push(figures),
        None => rows.push(Row { cameras, arm, sessions: vec![figures] }),
    }
}

/// Means over sessions, with standard deviations where there are several.
fn markdown(rows: &[Row]) -> String {
    let names: Vec<&str> = COLUMNS.iter().map(|(name, _)| *name).collect();
    let mut table = format!("| cameras | | {} |\n|---|---|{}\n", names.join(" | "), "---|".repeat(names.len()));
    for row in rows {
        let cells = COLUMNS.map(|(name, decimals)| {
            let values: Vec<f64> = row.sessions.iter().filter_map(|figures| figures[name]).collect();
            cell(&values, decimals)
        });
        table.push_str(&format!("| {} | {} | {} |\n", row.cameras, row.arm, cells.join(" | ")));
    }
    table
}

fn cell(values: &[f64], decimals: usize) -> String {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
    match values.len() {
        0 => "-".to_owned(),
        1 => format!("{mean:.decimals$}"),
        _ => format!("{mean:.decimals$} ± {:.decimals$}", variance.sqrt()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::formats::native::write_folder;
    use crate::simulation::{Preset, SimulationConfig, simulate, write_truth};

    #[test]
    fn a_short_capture_gives_every_row_with_figures() {
        let folder = tempfile::tempdir().unwrap();
        let config = SimulationConfig { frames: 40, views: 4, ..SimulationConfig::preset(Preset::Easy) };
        let simulated = simulate(&config).unwrap();
        let session = folder.path().join("take");
        write_folder(&simulated.session, &session).unwrap();
        write_truth(&simulated, &session).unwrap();
        let out = folder.path().join("out");
        run(&AblationArgs { sessions: vec![session], out: out.clone(), threads: 0 }).unwrap();
        let rows: serde_json::Value =
            serde_json::from_slice(&std::fs::read(out.join("ablation.json")).unwrap()).unwrap();
        assert_eq!(rows.as_array().unwrap().len(), 2 * (ARMS.len() + 1));
        for row in rows.as_array().unwrap() {
            let root = row["sessions"][0]["root12 mm"].as_f64().unwrap();
            // Twice what `easy` is known to give, bodies that are not the default one included.
            assert!(root < 40.0, "{row}");
        }
    }

    #[test]
    fn cells_tell_mean_and_spread() {
        assert_eq!([cell(&[], 1), cell(&[2.0], 1), cell(&[1.0, 3.0], 1)], ["-", "2.0", "2.0 ± 1.4"]);
    }
}
