//! `wandless bench ablation`: what each part of the method is worth, on sessions with truth.
//!
//! Every session is solved whole and with one part left out, cameras unknown and given. The points of bundle adjustment come
//! from the whole solve: they are what its bodies are fitted to. Before them, where cameras are unknown, comes what the
//! first arrangement of cameras is worth without any adjustment: the keypoints that a solve makes of it as if it were given.

use super::table::{Column, Figures, Reference, Table, figures};
use crate::cli::BadInput;
use crate::cli::solve::use_threads;
use crate::evaluation::alignment::Alignment;
use crate::evaluation::documents::read_cameras;
use crate::evaluation::report::PoseErrors;
use crate::evaluation::{Evaluation, EvaluationOptions, evaluate};
use crate::export::{ResultContext, write_result};
use crate::pipeline::calibration::initial_cameras;
use crate::pipeline::config::Extrinsics;
use crate::pipeline::{Capture, Options, reconstruct};
use crate::progress::Progress;
use crate::session::Session;
use crate::session::upload::{UploadLimits, read_path};
use anyhow::Context;
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
/// The keypoints under the first arrangement of cameras.
const INITIAL: &str = "initial";
/// The keypoints of the whole solve.
const POINTS: &str = "bundle adjustment only";

const ARMS: [Arm; 4] = [
    Arm { name: WHOLE, options: Options::default },
    Arm { name: "without consistency", options: || Options { denoise: false, ..Options::default() } },
    Arm { name: "without motion prior", options: || Options { motion_prior: false, ..Options::default() } },
    Arm { name: "without collision", options: || Options { collision: false, ..Options::default() } },
];

const CAMERA_ANGLE: &str = "camera deg";
const ROOT12: &str = "root12 mm";

const COLUMNS: [Column; 9] = [
    ("camera mm", 2),
    (CAMERA_ANGLE, 3),
    ("PCP %", 2),
    (ROOT12, 2),
    ("raw12 mm", 2),
    ("acceleration error mm/frame^2", 2),
    ("jitter of truth", 3),
    ("identity accuracy", 4),
    ("deepest overlap mm", 1),
];

/// What every row is compared with, session by session.
const REFERENCE: Reference = Reference { arm: WHOLE, columns: &[ROOT12, CAMERA_ANGLE] };

/// One session with its cameras unknown, or given.
struct Case {
    cameras: &'static str,
    session: Session,
    extrinsics: Extrinsics,
    /// How results are laid over the truth.
    align: Alignment,
}

pub(super) fn run(args: &AblationArgs) -> anyhow::Result<()> {
    use_threads(args.threads);
    if args.out.exists() {
        return Err(BadInput(format!("{}: exists; name a folder that does not", args.out.display())).into());
    }
    let mut table = Table::new(&COLUMNS, Some(REFERENCE));
    for (k, path) in args.sessions.iter().enumerate() {
        let limits = UploadLimits::default();
        let loaded = read_path(path, &limits).map_err(|e| BadInput(format!("{}: {e}", path.display())))?;
        let truth = path.join("gt");
        for case in both_ways(loaded.session, &truth)? {
            let out = |arm: &str| args.out.join(format!("{k}-{}-{}", case.cameras, arm.replace(' ', "-")));
            if case.extrinsics == Extrinsics::Estimate {
                table.add(case.cameras, INITIAL, initial_figures(&case, &loaded.sha256, &truth, &out(INITIAL))?);
            }
            for arm in &ARMS {
                let options = Options { extrinsics: case.extrinsics, ..(arm.options)() };
                let started = Instant::now();
                let (errors, overlap_mm) = solved(&case, &options, &loaded.sha256, &truth, &out(arm.name))?;
                eprintln!("{} {} {}: {:.1} s", path.display(), case.cameras, arm.name, started.elapsed().as_secs_f64());
                if arm.name == WHOLE {
                    table.add(case.cameras, POINTS, of_errors(&errors, errors.other_poses.as_ref(), None));
                }
                table.add(case.cameras, arm.name, of_errors(&errors, errors.poses.as_ref(), Some(overlap_mm)));
            }
        }
    }
    table.publish(&args.out, "ablation")
}

/// The session without its cameras, and with the true ones.
fn both_ways(session: Session, truth: &Path) -> anyhow::Result<[Case; 2]> {
    let cameras = read_cameras(&truth.join("cameras.json")).map_err(|e| BadInput(e.to_string()))?;
    let mut given = session.clone();
    for view in &mut given.views {
        let missing = || BadInput(format!("{}: no camera {}", truth.join("cameras.json").display(), view.id));
        view.camera_from_world = Some(*cameras.get(&view.id).ok_or_else(missing)?);
    }
    let free = Case { cameras: "free", session, extrinsics: Extrinsics::Estimate, align: Alignment::Sim3 };
    Ok([free, Case { cameras: "fixed", session: given, extrinsics: Extrinsics::Fixed, align: Alignment::None }])
}

/// Figures of the first arrangement of cameras, by a solve that takes it as given; none where it does not place all of
/// them.
fn initial_figures(case: &Case, input_sha256: &str, truth: &Path, out: &Path) -> anyhow::Result<Figures> {
    let options = Options { denoise: false, collision: false, ..Options::default() };
    let cameras = initial_cameras(&Capture::new(&case.session, &options), &Progress::silent())?;
    if cameras.iter().any(Option::is_none) {
        return Ok(figures(&COLUMNS, [None; COLUMNS.len()]));
    }
    let mut session = case.session.clone();
    session.views.iter_mut().zip(cameras).for_each(|(view, camera)| view.camera_from_world = camera);
    let options = Options { extrinsics: Extrinsics::Fixed, ..options };
    let (errors, _) = solved(&Case { session, ..*case }, &options, input_sha256, truth, out)?;
    Ok(of_errors(&errors, errors.other_poses.as_ref(), None))
}

/// Solves, writes the result and compares it with the truth; beside the errors the deepest overlap of two bodies, mm.
fn solved(
    case: &Case,
    options: &Options,
    input_sha256: &str,
    truth: &Path,
    out: &Path,
) -> anyhow::Result<(Evaluation, f64)> {
    let session = &case.session;
    let found = reconstruct(session, options, &Progress::silent())?;
    let context = ResultContext {
        input_sha256,
        options: serde_json::to_value(options)?,
        solver_version: env!("CARGO_PKG_VERSION"),
        exports: &[],
    };
    std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    write_result(out, session, &context, &found)?;
    let options = EvaluationOptions { align: Some(case.align), ..EvaluationOptions::default() };
    let errors = evaluate(out, truth, &options).map_err(|e| BadInput(e.to_string()))?;
    Ok((errors, found.report.penetration.deepest.map_or(0.0, |overlap| overlap.depth_mm)))
}

fn of_errors(errors: &Evaluation, poses: Option<&PoseErrors>, overlap_mm: Option<f64>) -> Figures {
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
    figures(&COLUMNS, values)
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
        // All arms and the points for both; the first arrangement where cameras are unknown.
        assert_eq!(rows.as_array().unwrap().len(), 2 * (ARMS.len() + 1) + 1);
        for row in rows.as_array().unwrap() {
            let root = row["sessions"][0]["root12 mm"].as_f64().unwrap();
            // Twice what `easy` is known to give, bodies that are not the default one included.
            assert!(root < 40.0, "{row}");
        }
    }
}
