//! `wandless bench mistakes`: which mistakes in a recording's files a solve recognises, on sessions with ground truth.
//!
//! Every session is solved as it is, with every mistake and with some combinations of two. A case is *named* where a suspicion has
//! the right code and cameras (of both of a combination), *detected* where the verdict is worse than that of the session as it is or the solve fails, *harmless* where
//! the result is as good as without the mistake, and *silent* otherwise.

use super::evaluated::write_into;
use crate::cli::bad_input::BadInput;
use crate::cli::output_folder::make_free;
use crate::cli::solve::use_threads;
use crate::evaluation::alignment::Alignment;
use crate::evaluation::documents::read_cameras;
use crate::evaluation::{Evaluation, EvaluationOptions, evaluate};
use crate::geometry::{Rigid, rotation};
use crate::pipeline::config::Repair;
use crate::pipeline::repair::with_option;
use crate::pipeline::{Options, PipelineError, reconstruct};
use crate::progress::Progress;
use crate::session::reconstruction::Verdict;
use crate::session::upload::{UploadLimits, read_path};
use crate::session::{Reconstruction, Session, Suspicion};
use crate::simulation::mistakes::{COMBINATIONS, MISTAKES, Mistake};
use nalgebra::Vector3;
use serde::Serialize;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Arguments of `bench mistakes`.
#[derive(Debug, clap::Args)]
pub(super) struct MistakesArgs {
    /// Sessions with ground truth (SESSION/gt)
    #[arg(required = true)]
    sessions: Vec<PathBuf>,
    /// Output folder for all results, mistakes.md and mistakes.json; must be empty or not exist
    #[arg(long)]
    out: PathBuf,
    /// Only mistakes whose name contains this text; several are possible; without mistakes: `none`
    #[arg(long)]
    only: Vec<String>,
    /// Repair mistakes (`options.repair: auto`) and compare the result with that of the session as it is
    #[arg(long)]
    repair: bool,
    /// Number of solver threads; 0 uses all cores
    #[arg(long, default_value_t = 0)]
    threads: usize,
}

/// Errors from which a result counts as wrong: largest error of a camera after alignment, and mean error of the limbs.
const WRONG_ANGLE_DEG: f64 = 3.0;
const WRONG_POSITION_MM: f64 = 100.0;
const WRONG_LIMBS_MM: f64 = 60.0;

/// A result without a mistake may exceed the bounds itself, then this factor on its errors counts.
const WORSE: f64 = 1.5;

/// A repaired recording may have this many times the errors of the session as it is, but for errors below these.
const REPAIRED: f64 = 1.2;
const NEGLIGIBLE: [f64; 3] = [5.0, 0.05, 2.0];

/// One session with one mistake, solved.
#[derive(Debug, Clone, Serialize)]
struct Case {
    session: String,
    /// `None`: the session as it is.
    mistake: Option<String>,
    outcome: Outcome,
    /// Where all that was found was repaired: whether the result is as good as without the mistake.
    is_repaired: Option<bool>,
    #[serde(flatten)]
    solved: Solved,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Outcome {
    /// The session as it is, without a suspicion.
    Clean,
    /// The session as it is, with a suspicion.
    FalseAlarm,
    /// A suspicion with the right code and cameras for each mistake.
    Named,
    /// A worse verdict, or no result.
    Detected,
    /// No worse verdict, but a right result.
    Harmless,
    /// No worse verdict, and a wrong result.
    Silent,
}

/// Result of one solve.
#[derive(Debug, Clone, Default, Serialize)]
struct Solved {
    error: Option<String>,
    verdict: Option<Verdict>,
    suspicions: Vec<Suspicion>,
    reasons: Vec<String>,
    /// Largest errors over the cameras.
    position_mm: Option<f64>,
    angle_deg: Option<f64>,
    limbs_mm: Option<f64>,
    /// The same after a similarity alignment, without the error of the metric scale.
    shape_mm: Option<f64>,
    /// Largest stated standard deviation of a camera's centre.
    sigma_mm: Option<f64>,
    secs: f64,
}

pub(super) fn run(args: &MistakesArgs) -> anyhow::Result<()> {
    use_threads(args.threads);
    make_free(&args.out)?;
    let is_chosen = |i: &Injection| args.only.is_empty() || args.only.iter().any(|text| i.name.contains(text.as_str()));
    let mut cases = Vec::new();
    for (k, path) in args.sessions.iter().enumerate() {
        let loaded =
            read_path(path, &UploadLimits::default()).map_err(|e| BadInput(format!("{}: {e}", path.display())))?;
        let session = &loaded.session;
        let posed = with_true_poses(session, path)?;
        let name = path.file_name().map_or_else(|| k.to_string(), |name| name.to_string_lossy().into_owned());
        let case = |mistake: Option<String>, outcome, is_repaired, solved| {
            let session = name.clone();
            Case { session, mistake, outcome, is_repaired, solved }
        };
        let options =
            Options { repair: if args.repair { Repair::Auto } else { Repair::Suggest }, ..Options::default() };
        let solve = |session: &Session, options: &Options, turns: &Turns, n: usize| {
            solved(session, options, turns, path, &args.out.join(format!("{k}-{name}/{n}")))
        };
        let clean = solve(session, &options, &Turns::new(), 0)?;
        let outcome = if clean.suspicions.is_empty() { Outcome::Clean } else { Outcome::FalseAlarm };
        cases.push(reported(case(None, outcome, None, clean.clone())));
        for (n, injection) in injections().iter().enumerate().filter(|(_, injection)| is_chosen(injection)) {
            // Some mistakes need poses that most sessions do not give.
            let Some(changed) = injection.inject(session).or_else(|| injection.inject(&posed)) else { continue };
            let options = injection
                .mistakes
                .iter()
                .fold(options.clone(), |options, mistake| with_option(&options, mistake.options).unwrap_or(options));
            let solved = solve(&changed, &options, &injection.turns(), n + 1)?;
            let outcome = judged(&injection.mistakes, session, &clean, &solved);
            let is_repaired = is_repairable(&solved).then(|| is_as_good(&clean, &solved));
            cases.push(reported(case(Some(injection.name.clone()), outcome, is_repaired, solved)));
        }
    }
    let table = markdown(&cases);
    print!("{table}");
    std::fs::write(args.out.join("mistakes.md"), table)?;
    std::fs::write(args.out.join("mistakes.json"), serde_json::to_string_pretty(&cases)?)?;
    Ok(())
}

/// A mistake, or several at once.
struct Injection {
    name: String,
    mistakes: Vec<&'static Mistake>,
}

/// Views whose images a mistake turns, with the angles in radians.
type Turns = Vec<(usize, f64)>;

impl Injection {
    fn turns(&self) -> Turns {
        self.mistakes.iter().flat_map(|m| m.cameras.iter().map(|view| (*view, m.image_turn))).collect()
    }

    fn inject(&self, session: &Session) -> Option<Session> {
        self.mistakes.iter().try_fold(session.clone(), |session, mistake| (mistake.inject)(&session))
    }
}

/// Every mistake, then the combinations.
fn injections() -> Vec<Injection> {
    let singles = MISTAKES.iter().map(|mistake| Injection { name: mistake.name.to_owned(), mistakes: vec![mistake] });
    let combined = COMBINATIONS.iter().map(|names| Injection {
        name: names.join(", "),
        mistakes: names.iter().flat_map(|name| MISTAKES.iter().find(|mistake| mistake.name == *name)).collect(),
    });
    singles.chain(combined).collect()
}

/// The session with the true poses of its cameras.
fn with_true_poses(session: &Session, path: &Path) -> anyhow::Result<Session> {
    let truth = read_cameras(&path.join("gt/cameras.json")).map_err(|e| BadInput(e.to_string()))?;
    let mut posed = session.clone();
    posed.views.iter_mut().for_each(|view| view.camera_from_world = truth.get(&view.id).copied());
    Ok(posed)
}

/// Solves a session and compares the result with the truth of `path`.
fn solved(session: &Session, options: &Options, turns: &Turns, path: &Path, out: &Path) -> anyhow::Result<Solved> {
    let started = Instant::now();
    let mut result = match reconstruct(session, options, &Progress::silent()) {
        Ok(result) => result,
        Err(error) => {
            let message = Some(error.to_string());
            let suspicions =
                if let PipelineError::Unsolvable { suspicions, .. } = error { suspicions } else { Vec::new() };
            return Ok(Solved { error: message, suspicions, ..Solved::default() });
        }
    };
    let secs = started.elapsed().as_secs_f64();
    for (view, angle) in turns {
        let Some(pose) = result.cameras[*view].camera_from_world.as_mut() else { continue };
        let turn = rotation::exp(&Vector3::new(0.0, 0.0, -angle));
        *pose = Rigid { rotation: turn * pose.rotation, translation: turn * pose.translation };
    }
    write_into(out, session, options, "", &result)?;
    // A mistake may change which detections there are; the truth's list of identities then no longer fits.
    std::fs::remove_file(out.join("identities.json"))?;
    let errors = |align: Option<Alignment>| {
        let options = EvaluationOptions { align, ..EvaluationOptions::default() };
        evaluate(out, &path.join("gt"), &options).map_err(|e| BadInput(e.to_string()))
    };
    let shape_mm = limbs_mm(&errors(Some(Alignment::Sim3))?);
    Ok(Solved { secs, shape_mm, ..with_errors(&result, &errors(None)?) })
}

fn with_errors(result: &Reconstruction, errors: &Evaluation) -> Solved {
    let cameras = errors.cameras.as_ref().map(|cameras| &cameras.sim3);
    let worst = |of: fn(&crate::evaluation::camera_error::CameraError) -> f64| {
        cameras.and_then(|cameras| cameras.per_camera.values().map(of).reduce(f64::max))
    };
    let quality = &result.report.quality;
    Solved {
        verdict: Some(quality.verdict),
        suspicions: result.report.suspicions.clone(),
        reasons: quality.reasons.clone(),
        position_mm: worst(|camera| camera.position_mm),
        angle_deg: worst(|camera| camera.angle_deg),
        limbs_mm: limbs_mm(errors),
        sigma_mm: result.cameras.iter().filter_map(|camera| camera.sigma_position_mm).reduce(f64::max),
        ..Solved::default()
    }
}

/// Mean error of the joints of the limbs relative to the hips.
fn limbs_mm(errors: &Evaluation) -> Option<f64> {
    errors.poses.as_ref()?.mpjpe.root12
}

fn judged(mistakes: &[&Mistake], session: &Session, clean: &Solved, solved: &Solved) -> Outcome {
    let is_named = |mistake: &&Mistake| {
        let expected: BTreeSet<&str> = mistake.cameras.iter().map(|&v| session.views[v].id.as_str()).collect();
        let mut right = solved.suspicions.iter().filter(|suspicion| mistake.codes.contains(&suspicion.code)).peekable();
        let is_found = right.peek().is_some();
        let cameras: BTreeSet<&str> = right.flat_map(|s| s.cameras.iter().map(String::as_str)).collect();
        is_found && (expected.is_empty() || cameras == expected)
    };
    if mistakes.iter().all(is_named) {
        Outcome::Named
    } else if solved.verdict.is_none_or(|verdict| Some(verdict) > clean.verdict) {
        Outcome::Detected
    } else if is_wrong(clean, solved) {
        Outcome::Silent
    } else {
        Outcome::Harmless
    }
}

fn is_wrong(clean: &Solved, solved: &Solved) -> bool {
    let exceeds = |value: Option<f64>, usual: Option<f64>, bound: f64| {
        value.is_some_and(|value| value > usual.map_or(bound, |usual| bound.max(WORSE * usual)))
    };
    exceeds(solved.angle_deg, clean.angle_deg, WRONG_ANGLE_DEG)
        || exceeds(solved.position_mm, clean.position_mm, WRONG_POSITION_MM)
        || exceeds(solved.limbs_mm, clean.limbs_mm, WRONG_LIMBS_MM)
}

/// Whether all that was found could be repaired: of two mistakes at once one may be left, such as exchanged labels.
fn is_repairable(solved: &Solved) -> bool {
    !solved.suspicions.is_empty() && solved.suspicions.iter().all(|suspicion| suspicion.applied)
}

/// Whether a repaired result is as good as that of the session as it is.
fn is_as_good(clean: &Solved, solved: &Solved) -> bool {
    let errors = |of: &Solved| [of.position_mm, of.angle_deg, of.shape_mm];
    let pairs = errors(clean).into_iter().zip(errors(solved)).zip(NEGLIGIBLE);
    pairs.into_iter().all(|((usual, error), negligible)| {
        let bound = usual.map_or(negligible, |usual| negligible.max(REPAIRED * usual));
        usual.is_none() || error.is_some_and(|error| error <= bound)
    })
}

/// Prints one line per case to standard error, so that a long run can be followed.
fn reported(case: Case) -> Case {
    let number = |value: Option<f64>, decimals: usize| value.map_or("-".to_owned(), |v| format!("{v:.decimals$}"));
    let Solved { position_mm, angle_deg, limbs_mm, sigma_mm, secs, .. } = &case.solved;
    eprintln!(
        "{} | {} | {:?} | {} mm, {} deg, limbs {} mm, sigma {} mm, {secs:.1} s",
        case.session,
        case.mistake.as_deref().unwrap_or("as it is"),
        case.outcome,
        number(*position_mm, 0),
        number(*angle_deg, 2),
        number(*limbs_mm, 0),
        number(*sigma_mm, 0),
    );
    for suspicion in &case.solved.suspicions {
        eprintln!("    {}: {suspicion}", suspicion.code.name());
    }
    let lines = case.solved.error.iter().chain(&case.solved.reasons);
    lines
        .filter(|line| case.solved.suspicions.iter().all(|s| s.sentence() != **line))
        .for_each(|line| eprintln!("    - {line}"));
    case
}

/// The confusion table: a row per mistake, a column per outcome.
fn markdown(cases: &[Case]) -> String {
    const COLUMNS: [(&str, Outcome); 4] = [
        ("named", Outcome::Named),
        ("detected", Outcome::Detected),
        ("harmless", Outcome::Harmless),
        ("silent", Outcome::Silent),
    ];
    let heads: Vec<&str> = COLUMNS.iter().map(|(head, _)| *head).collect();
    let mut table = format!("| mistake | {} |\n|---|---|---|---|---|\n", heads.join(" | "));
    for Injection { name, .. } in injections() {
        let of_mistake: Vec<&Case> = cases.iter().filter(|case| case.mistake.as_ref() == Some(&name)).collect();
        if !of_mistake.is_empty() {
            let count = |outcome| of_mistake.iter().filter(|case| case.outcome == outcome).count().to_string();
            let cells: Vec<String> = COLUMNS.iter().map(|(_, outcome)| count(*outcome)).collect();
            table.push_str(&format!("| {name} | {} |\n", cells.join(" | ")));
        }
    }
    let clean: Vec<&Case> = cases.iter().filter(|case| case.mistake.is_none()).collect();
    let alarms = clean.iter().filter(|case| case.outcome == Outcome::FalseAlarm).count();
    let repaired: Vec<bool> = cases.iter().filter_map(|case| case.is_repaired).collect();
    if !repaired.is_empty() {
        let right = repaired.iter().filter(|is_right| **is_right).count();
        table.push_str(&format!("\nAs good as without the mistake: {right} of {} repaired cases.\n", repaired.len()));
    }
    table.push_str(&format!("\nFalse alarms: {alarms} of {} sessions without a mistake.\n", clean.len()));
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::arguments::arguments_of;
    use crate::session::formats::native::write_folder;
    use crate::simulation::{Preset, SimulationConfig, simulate, write_truth};

    fn args(line: &str) -> Result<MistakesArgs, clap::Error> {
        arguments_of(format!("mistakes {line}").split_whitespace().map(str::to_owned))
    }

    #[test]
    fn a_mistake_is_named_and_a_right_session_is_clean() {
        let folder = tempfile::tempdir().unwrap();
        let config = SimulationConfig { frames: 60, views: 4, ..SimulationConfig::preset(Preset::Easy) };
        let simulated = simulate(&config).unwrap();
        let session = folder.path().join("take");
        write_folder(&simulated.session, &session).unwrap();
        write_truth(&simulated, &session).unwrap();
        let out = folder.path().join("out");
        let line = format!("{} --out {} --only second", session.display(), out.display());
        run(&args(&line).unwrap()).unwrap();
        let cases: serde_json::Value =
            serde_json::from_slice(&std::fs::read(out.join("mistakes.json")).unwrap()).unwrap();
        let outcomes: Vec<_> =
            cases.as_array().unwrap().iter().map(|case| (&case["mistake"], &case["outcome"])).collect();
        let [none, copied, halved, combined] = &outcomes[..] else { panic!("{outcomes:?}") };
        assert_eq!((none.0.is_null(), none.1.as_str()), (true, Some("clean")));
        assert_eq!((copied.0.as_str(), copied.1.as_str()), (Some("keypoints of a second camera"), Some("named")));
        assert_eq!((halved.0.as_str(), halved.1.as_str()), (Some("every second frame missing"), Some("named")));
        assert_eq!(combined.0.as_str(), Some("every second frame missing, focal length +20 %"));
        assert_ne!(combined.1.as_str(), Some("silent"));
    }
}
