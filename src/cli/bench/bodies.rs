//! `wandless bench bodies`: errors of the body fit and of the metric scale on simulated people with default bodies.

use super::joint_angles::AngleErrors;
use super::solved_cameras::solved_and_true;
use crate::body::dense_landmarks::{checked_table, spread_over_skin};
use crate::body::model::Betas;
use crate::body::skeleton::{JOINT_NAMES, KeypointConvention, N_JOINTS};
use crate::body::{BodyModel, default_body};
use crate::cli::solve::use_threads;
use crate::evaluation::alignment::{Alignment, truth_from_solved};
use crate::geometry::rotation;
use crate::optim::robust::median;
use crate::pipeline::config::{Extrinsics, ScaleSource};
use crate::pipeline::{Options, reconstruct};
use crate::progress::Progress;
use crate::session::people::BodyPose;
use crate::session::{BodyMotion, Reconstruction};
use crate::simulation::skeleton::SimulatedPerson;
use crate::simulation::{Bodies, MotionSource, Preset, Simulated, SimulationConfig, simulate};
use nalgebra::Vector3;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

/// Arguments of `bench bodies`.
#[derive(Debug, clap::Args)]
pub(super) struct BodiesArgs {
    /// Number of sessions
    #[arg(long, default_value_t = 20)]
    count: u64,
    /// Seed of the first session; the others follow
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Motion files in the AMASS layout to choose from, instead of procedural motion
    #[arg(long, num_args = 1..)]
    motion: Vec<PathBuf>,
    /// Fit with 26 keypoints and with 17 and this many landmarks on the skin, and compare the errors; without the other parts
    #[arg(long)]
    landmarks: Option<usize>,
    /// Number of solver threads; 0 uses all cores
    #[arg(long, default_value_t = 0)]
    threads: usize,
}

pub(super) fn run(args: &BodiesArgs) -> anyhow::Result<()> {
    use_threads(args.threads);
    let model = default_body();
    if let Some(count) = args.landmarks {
        return compare_landmarks(args, count, &model);
    }
    println!("## Body fit: `easy` noise, true cameras, 26 keypoints");
    let (mut statures, mut distances, [mut angles, mut biases]) =
        (Vec::new(), [const { Vec::new() }; N_JOINTS], [const { [const { Vec::new() }; N_JOINTS] }; 2]);
    let mut isb = AngleErrors::none();
    for seed in args.seed..args.seed + args.count {
        for fit in fitted_people(&simulate(&fit_config(args, seed))?, &model, &mut isb)? {
            println!("session {seed:3}: {}", fit.line());
            distances.iter_mut().zip(fit.joints_mm).for_each(|(all, one)| all.push(one));
            statures.push(fit.stature_mm.abs());
            angles.iter_mut().zip(fit.angles_deg).for_each(|(all, one)| all.push(one));
            biases.iter_mut().zip(fit.biases_deg).for_each(|(all, one)| all.push(one));
        }
    }
    let [distances, angles, biases] = [distances, angles, biases].map(|all| all.map(|of_joint| mean(&of_joint)));
    println!(
        "mean errors: stature {:.1} mm; per joint position mm, angle deg, and the constant part of the angle error deg:",
        mean(&statures)
    );
    for (joint, name) in JOINT_NAMES.iter().enumerate() {
        println!("  {name:<16} {:5.2} {:5.2} {:5.2}", distances[joint], angles[joint], biases[joint]);
    }
    println!("  {:<16} {:5.2} {:5.2} {:5.2}", "mean", mean(&distances), mean(&angles), mean(&biases));

    println!("{isb}");

    println!("## Metric scale: `paper` noise, cameras unknown, 2 to 4 people");
    for source in ["body", "height", "camera distance"] {
        let (mut errors, mut n_covered) = (Vec::new(), 0);
        for seed in args.seed..args.seed + args.count {
            let simulated = simulate(&scale_config(args, seed))?;
            let outcome = scale_outcome(&simulated, given_scale(source, &simulated, &model), seed)?;
            println!("session {seed:3}: {source} {:+.2} %, truth in interval: {}", outcome.percent, outcome.is_covered);
            errors.push(outcome.percent.abs());
            n_covered += usize::from(outcome.is_covered);
        }
        let middle = median(&mut errors).unwrap_or(f64::NAN);
        println!("{source}: median {middle:.2} %, truth in the 95 % interval in {n_covered} of {}", errors.len());
    }
    Ok(())
}

/// Errors with a dense table of landmarks over those with 26 keypoints.
fn compare_landmarks(args: &BodiesArgs, count: usize, model: &BodyModel) -> anyhow::Result<()> {
    println!("## Body fit: `easy` noise, true cameras, 26 keypoints and 17 with {count} landmarks");
    let table = checked_table("skin", &spread_over_skin(model, KeypointConvention::Coco17, count, 0))?;
    let dense = table.dense.map(Arc::new);
    let mut logs: Vec<[f64; 3]> = Vec::new();
    for seed in args.seed..args.seed + args.count {
        let sparse = fit_config(args, seed);
        let with_dense = SimulationConfig { convention: table.base, dense: dense.clone(), ..sparse.clone() };
        let [few, many] = [sparse, with_dense].map(|config| -> anyhow::Result<[f64; 3]> {
            let simulated = simulate(&config)?;
            let started = Instant::now();
            let fits = fitted_people(&simulated, model, &mut AngleErrors::none())?;
            let seconds = started.elapsed().as_secs_f64();
            let of = |value: &dyn Fn(&Fit) -> f64| mean(&fits.iter().map(value).collect::<Vec<_>>());
            Ok([of(&|fit| mean(&fit.angles_deg)), of(&|fit| mean(&fit.joints_mm)), seconds])
        });
        let ([few_deg, few_mm, few_s], [deg, mm, s]) = (few?, many?);
        println!(
            "session {seed:3}: {few_deg:.2} and {deg:.2} deg, {few_mm:.2} and {mm:.2} mm, {few_s:.1} and {s:.1} s"
        );
        logs.push([(deg / few_deg).ln(), (mm / few_mm).ln(), (s / few_s).ln()]);
    }
    let ratio = |k: usize| mean(&logs.iter().map(|logs| logs[k]).collect::<Vec<_>>()).exp();
    println!("angles {:.3} times, joints {:.3} times, time {:.2} times", ratio(0), ratio(1), ratio(2));
    Ok(())
}

fn fit_config(args: &BodiesArgs, seed: u64) -> SimulationConfig {
    let preset = SimulationConfig::preset(Preset::Easy);
    SimulationConfig { convention: KeypointConvention::Halpe26, ..with_bodies_and_motions(args, seed, preset) }
}

fn scale_config(args: &BodiesArgs, seed: u64) -> SimulationConfig {
    let preset = SimulationConfig::preset(Preset::Paper);
    let people = 2 + (seed % 3) as usize;
    with_bodies_and_motions(args, seed, SimulationConfig { people, views: 5, frames: 250, ..preset })
}

/// The configuration with default bodies, and motions from files if any are given.
fn with_bodies_and_motions(args: &BodiesArgs, seed: u64, config: SimulationConfig) -> SimulationConfig {
    let n_files = args.motion.len();
    let file = |person: usize| args.motion[(seed as usize * 31 + person * 7) % n_files].clone();
    let motion = match n_files {
        0 => MotionSource::Procedural,
        _ => MotionSource::Files((0..config.people).map(file).collect()),
    };
    SimulationConfig { seed, motion, bodies: Bodies::Default, ..config }
}

/// Errors of the fit of one person.
struct Fit {
    /// Mean distance of every joint, mm.
    joints_mm: [f64; N_JOINTS],
    /// Fitted minus true stature, mm.
    stature_mm: f64,
    /// Mean angle between the fitted and the true rotation of every joint.
    angles_deg: [f64; N_JOINTS],
    /// Length of the mean rotation vector of these differences: the part of the error that is constant over time.
    biases_deg: [f64; N_JOINTS],
}

impl Fit {
    fn line(&self) -> String {
        let (joints, angle) = (mean(&self.joints_mm), mean(&self.angles_deg));
        format!("joints {joints:.2} mm, stature {:+.1} mm, angles {angle:.2} deg", self.stature_mm)
    }
}

/// The fits of all people, whose joint angles are added to `isb`.
fn fitted_people(simulated: &Simulated, model: &BodyModel, isb: &mut AngleErrors) -> anyhow::Result<Vec<Fit>> {
    let mut session = simulated.session.clone();
    session.views.iter_mut().zip(&simulated.truth.cameras).for_each(|(v, c)| v.camera_from_world = Some(*c));
    let options = Options { extrinsics: Extrinsics::Fixed, ..Options::default() };
    let result = reconstruct(&session, &options, &Progress::silent())?;
    let mut fit = |(index, person): (usize, &SimulatedPerson)| {
        let betas = person.betas?;
        let motion = result.motions.iter().min_by(|a, b| {
            let distance = |m: &BodyMotion| joint_distance_mm(m, simulated, index, 0);
            distance(a).total_cmp(&distance(b))
        })?;
        isb.add(model, motion, &betas, &person.poses);
        let stature_mm = 1e3 * (model.surface.stature(&Betas::from(motion.betas)) - model.surface.stature(&betas));
        let rotations: [_; N_JOINTS] = std::array::from_fn(|joint| rotation_errors(motion, person, joint));
        let angle =
            |errors: &Vec<Vector3<f64>>| mean(&errors.iter().map(Vector3::norm).collect::<Vec<_>>()).to_degrees();
        let bias = |errors: &Vec<Vector3<f64>>| {
            errors.iter().sum::<Vector3<f64>>().norm().to_degrees() / errors.len().max(1) as f64
        };
        Some(Fit {
            joints_mm: std::array::from_fn(|joint| joint_distance_mm(motion, simulated, index, joint)),
            stature_mm,
            angles_deg: rotations.each_ref().map(angle),
            biases_deg: rotations.each_ref().map(bias),
        })
    };
    Ok(simulated.truth.people.iter().enumerate().filter_map(&mut fit).collect())
}

/// Mean distance of a joint of the fitted motion to the joint of a true person, mm.
fn joint_distance_mm(motion: &BodyMotion, simulated: &Simulated, person: usize, joint: usize) -> f64 {
    let truth = &simulated.truth.joints;
    let of_frame = |(i, frame): (usize, &BodyPose)| {
        Some((truth.get(motion.first.0 + i)?[person][joint] - frame.joints[joint]).norm())
    };
    1e3 * mean(&motion.frames.iter().enumerate().filter_map(of_frame).collect::<Vec<_>>())
}

/// Rotation vector from the true to the fitted rotation of a joint, per frame, rad.
fn rotation_errors(motion: &BodyMotion, person: &SimulatedPerson, joint: usize) -> Vec<Vector3<f64>> {
    let error = |(i, frame): (usize, &BodyPose)| {
        let truth = person.poses.get(motion.first.0 + i)?.rotations[joint];
        Some(rotation::step(&truth, &frame.rotations[joint]))
    };
    motion.frames.iter().enumerate().filter_map(error).collect()
}

/// The scale option as a user would measure it.
fn given_scale(source: &str, simulated: &Simulated, model: &BodyModel) -> ScaleSource {
    match source {
        "height" => {
            let stature = |person: &SimulatedPerson| person.betas.map(|betas| model.surface.stature(&betas));
            let metres = simulated.truth.people.iter().filter_map(stature).fold(0.0, f64::max);
            ScaleSource::Height { metres, who: "tallest".to_owned() }
        }
        "camera distance" => {
            let [a, b] = [0, 1].map(|view| simulated.truth.cameras[view].center());
            let cameras = [0, 1].map(|view| simulated.session.views[view].id.clone());
            ScaleSource::CameraDistance { cameras, metres: (a - b).norm() }
        }
        _ => ScaleSource::Body {},
    }
}

struct ScaleOutcome {
    /// Error of the size of the result, percent.
    percent: f64,
    /// Whether the 95 % interval contains the truth.
    is_covered: bool,
}

fn scale_outcome(simulated: &Simulated, scale: ScaleSource, seed: u64) -> anyhow::Result<ScaleOutcome> {
    let options = Options { scale, seed, ..Options::default() };
    let result = reconstruct(&simulated.session, &options, &Progress::silent())?;
    let true_size = true_from_estimated_scale(&result, simulated);
    let is_covered = result.report.scale.as_ref().is_some_and(|scale| {
        let [low, high] = scale.interval95.map(|edge| edge / scale.value);
        (low..=high).contains(&true_size)
    });
    Ok(ScaleOutcome { percent: 100.0 * (1.0 / true_size - 1.0), is_covered })
}

/// Scale from the metres of the result to true metres.
fn true_from_estimated_scale(result: &Reconstruction, simulated: &Simulated) -> f64 {
    let (solved, truth) = solved_and_true(result, &simulated.truth.cameras);
    truth_from_solved(&solved, &truth, Alignment::Sim3).scale
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}
