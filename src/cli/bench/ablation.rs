//! `wandless bench ablation`: contribution of each part of the method, on sessions with ground truth.
//!
//! Sessions are given, or simulated with the noise of a real detector. Every session is solved with the full method and with one part left out, with unknown and with given cameras. The row of
//! bundle adjustment evaluates the keypoints of the full solve, to which its bodies are fitted. With unknown cameras, a
//! further row evaluates camera initialisation alone: the keypoints of a solve that keeps the initial cameras fixed.

use super::evaluated::{Evaluated, evaluated};
use super::table::{Column, Reference, Statistics, Table, statistics};
use crate::cli::bad_input::BadInput;
use crate::cli::noise::NoiseName;
use crate::cli::output_folder::make_free;
use crate::cli::solve::use_threads;
use crate::evaluation::Evaluation;
use crate::evaluation::alignment::Alignment;
use crate::evaluation::documents::read_cameras;
use crate::evaluation::report::PoseErrors;
use crate::pipeline::Options;
use crate::pipeline::capture::Capture;
use crate::pipeline::config::{Extrinsics, MotionPriorMode};
use crate::pipeline::passes::cameras::initial_cameras;
use crate::progress::Progress;
use crate::session::Session;
use crate::session::formats::native::write_folder;
use crate::session::upload::{UploadLimits, read_path};
use crate::simulation::{MotionSource, Preset, SimulationConfig, Tracks, simulate, write_truth};
use anyhow::Context;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Arguments of `bench ablation`.
#[derive(Debug, clap::Args)]
pub(super) struct AblationArgs {
    /// Sessions with ground truth (SESSION/gt) instead of simulated ones; several give means and standard deviations
    #[arg(conflicts_with_all = ["count", "seed", "noise"])]
    sessions: Vec<PathBuf>,
    /// Output folder for simulated sessions, all results, ablation.md and ablation.json; must be empty or not exist
    #[arg(long)]
    out: PathBuf,
    /// Number of simulated sessions, each with 2 people and 6 cameras
    #[arg(long, default_value_t = 3)]
    count: u64,
    /// Seed of the first simulated session; the others follow
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Kind of the simulated detector's errors; their rates are those of the preset `paper`
    #[arg(long, value_enum, default_value_t = NoiseName::Real)]
    noise: NoiseName,
    /// Number of solver threads; 0 uses all cores
    #[arg(long, default_value_t = 0)]
    threads: usize,
}

/// One variant of the method.
struct Arm {
    name: &'static str,
    options: fn() -> Options,
}

const FULL: &str = "full";
/// Keypoints triangulated with the initial cameras.
const INITIAL: &str = "initial";
/// Keypoints of the full solve.
const POINTS: &str = "bundle adjustment only";

const ARMS: [Arm; 7] = [
    Arm { name: FULL, options: Options::default },
    Arm {
        name: "cameras held at bundle adjustment",
        options: || Options { adjust_with_bodies: false, ..Options::default() },
    },
    Arm { name: "without consistency", options: || Options { denoise: false, ..Options::default() } },
    Arm {
        name: "latent motion prior",
        options: || Options { motion_prior: MotionPriorMode::Latent, ..Options::default() },
    },
    Arm {
        name: "motion prior of single poses",
        options: || Options { motion_prior: MotionPriorMode::Pose, ..Options::default() },
    },
    Arm {
        name: "without motion prior",
        options: || Options { motion_prior: MotionPriorMode::None, ..Options::default() },
    },
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

/// The row that all others are compared with, session by session.
const REFERENCE: Reference = Reference { arm: FULL, columns: &[ROOT12, CAMERA_ANGLE] };

/// One session with unknown or with given cameras.
struct Case {
    cameras: &'static str,
    session: Session,
    extrinsics: Extrinsics,
    /// Alignment of results with the ground truth.
    align: Alignment,
}

pub(super) fn run(args: &AblationArgs) -> anyhow::Result<()> {
    use_threads(args.threads);
    make_free(&args.out)?;
    let mut table = Table::new(&COLUMNS, Some(REFERENCE));
    for (k, path) in sessions(args)?.iter().enumerate() {
        let limits = UploadLimits::default();
        let loaded = read_path(path, &limits).map_err(|e| BadInput(format!("{}: {e}", path.display())))?;
        let truth = path.join("gt");
        for case in with_unknown_and_given_cameras(loaded.session, &truth)? {
            let out = |arm: &str| args.out.join(format!("{k}-{}-{}", case.cameras, arm.replace(' ', "-")));
            if case.extrinsics == Extrinsics::Estimate {
                table.add(case.cameras, INITIAL, initial_statistics(&case, &loaded.sha256, &truth, &out(INITIAL))?);
            }
            for arm in &ARMS {
                let options = Options { extrinsics: case.extrinsics, ..(arm.options)() };
                let started = Instant::now();
                let (errors, overlap_mm) = solve_and_evaluate(&case, &options, &loaded.sha256, &truth, &out(arm.name))?;
                eprintln!("{} {} {}: {:.1} s", path.display(), case.cameras, arm.name, started.elapsed().as_secs_f64());
                if arm.name == FULL {
                    table.add(case.cameras, POINTS, statistics_of(&errors, errors.other_poses.as_ref(), None));
                }
                table.add(case.cameras, arm.name, statistics_of(&errors, errors.poses.as_ref(), Some(overlap_mm)));
            }
        }
    }
    table.publish(&args.out, "ablation")
}

/// The given sessions, or simulated ones in `OUT/sessions`. Procedural motion, because motion drawn from the motion prior
/// would favour the solves with this prior.
fn sessions(args: &AblationArgs) -> anyhow::Result<Vec<PathBuf>> {
    if !args.sessions.is_empty() {
        return Ok(args.sessions.clone());
    }
    let simulated = |seed: u64| {
        let preset = SimulationConfig::preset(Preset::Paper);
        let simulated = simulate(&SimulationConfig {
            seed,
            tracks: Tracks::None,
            noise: args.noise.of(preset.noise),
            motion: MotionSource::Procedural,
            ..preset
        })?;
        let folder = args.out.join(format!("sessions/{seed}"));
        let written = write_folder(&simulated.session, &folder).and_then(|()| write_truth(&simulated, &folder));
        written.with_context(|| folder.display().to_string())?;
        Ok(folder)
    };
    (args.seed..args.seed + args.count).map(simulated).collect()
}

/// The session with unknown cameras, and with the true ones.
fn with_unknown_and_given_cameras(session: Session, truth: &Path) -> anyhow::Result<[Case; 2]> {
    let cameras = read_cameras(&truth.join("cameras.json")).map_err(|e| BadInput(e.to_string()))?;
    let mut given = session.clone();
    for view in &mut given.views {
        let missing = || BadInput(format!("{}: no camera {}", truth.join("cameras.json").display(), view.id));
        view.camera_from_world = Some(*cameras.get(&view.id).ok_or_else(missing)?);
    }
    let free = Case { cameras: "free", session, extrinsics: Extrinsics::Estimate, align: Alignment::Sim3 };
    Ok([free, Case { cameras: "fixed", session: given, extrinsics: Extrinsics::Fixed, align: Alignment::None }])
}

/// Statistics of camera initialisation, from a solve with the initial cameras fixed; empty if a camera was not
/// initialised.
fn initial_statistics(case: &Case, input_sha256: &str, truth: &Path, out: &Path) -> anyhow::Result<Statistics> {
    let options = Options { denoise: false, collision: false, ..Options::default() };
    let cameras = initial_cameras(&Capture::new(&case.session, &options), &Progress::silent())?;
    if cameras.iter().any(Option::is_none) {
        return Ok(statistics(&COLUMNS, [None; COLUMNS.len()]));
    }
    let mut session = case.session.clone();
    session.views.iter_mut().zip(cameras).for_each(|(view, camera)| view.camera_from_world = camera);
    let options = Options { extrinsics: Extrinsics::Fixed, ..options };
    let (errors, _) = solve_and_evaluate(&Case { session, ..*case }, &options, input_sha256, truth, out)?;
    Ok(statistics_of(&errors, errors.other_poses.as_ref(), None))
}

/// Solves, writes the result and evaluates it. Returns the errors and the deepest overlap of two bodies, mm.
fn solve_and_evaluate(
    case: &Case,
    options: &Options,
    input_sha256: &str,
    truth: &Path,
    out: &Path,
) -> anyhow::Result<(Evaluation, f64)> {
    let session = &case.session;
    let Evaluated { errors, result } = evaluated(session, options, input_sha256, truth, case.align, out)?;
    Ok((errors, result.report.penetration.deepest.map_or(0.0, |overlap| overlap.depth_mm)))
}

/// Selects the columns of the table from an evaluation.
fn statistics_of(errors: &Evaluation, poses: Option<&PoseErrors>, overlap_mm: Option<f64>) -> Statistics {
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
    statistics(&COLUMNS, values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::arguments::arguments_of;

    fn args(line: &str) -> Result<AblationArgs, clap::Error> {
        arguments_of(format!("ablation {line}").split_whitespace().map(str::to_owned))
    }

    #[test]
    fn sessions_are_given_or_simulated_with_real_noise() {
        assert!(args("take --out x --noise real").is_err() && args("take --out x --count 2").is_err());
        assert_eq!(sessions(&args("take --out x").unwrap()).unwrap(), [PathBuf::from("take")]);
        let folder = tempfile::tempdir().unwrap();
        let read = |noise: &str| {
            let mut args = args(&format!("--out x --count 1 --seed 7 {noise}")).unwrap();
            args.out = folder.path().join(args.noise.word());
            let paths = sessions(&args).unwrap();
            assert_eq!(paths, [args.out.join("sessions/7")]);
            read_cameras(&paths[0].join("gt/cameras.json")).unwrap();
            read_path(&paths[0], &UploadLimits::default()).unwrap().session
        };
        let [real, preset] = ["", "--noise presets"].map(read);
        assert_eq!((real.views.len(), preset.views.len()), (6, 6));
        assert_ne!(real, preset);
    }

    #[test]
    fn short_session_fills_every_row() {
        let folder = tempfile::tempdir().unwrap();
        let config = SimulationConfig { frames: 40, views: 4, ..SimulationConfig::preset(Preset::Easy) };
        let simulated = simulate(&config).unwrap();
        let session = folder.path().join("take");
        write_folder(&simulated.session, &session).unwrap();
        write_truth(&simulated, &session).unwrap();
        let out = folder.path().join("out");
        let given = format!("{} --out {}", session.display(), out.display());
        run(&args(&given).unwrap()).unwrap();
        let rows: serde_json::Value =
            serde_json::from_slice(&std::fs::read(out.join("ablation.json")).unwrap()).unwrap();
        // All variants and bundle adjustment for both kinds of cameras; initialisation for unknown cameras.
        assert_eq!(rows.as_array().unwrap().len(), 2 * (ARMS.len() + 1) + 1);
        for row in rows.as_array().unwrap() {
            let root = row["sessions"][0]["root12 mm"].as_f64().unwrap();
            // Twice the known error on `easy`, which includes the error of bodies that differ from the default one.
            assert!(root < 40.0, "{row}");
        }
    }
}
