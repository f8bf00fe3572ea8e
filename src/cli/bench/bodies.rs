//! `wandless bench bodies`: people who are default bodies, and what the fit and the metric scale make of them.

use super::paired_cameras;
use crate::body::model::Betas;
use crate::body::skeleton::{JOINT_NAMES, KeypointConvention, N_JOINTS};
use crate::body::{BodyModel, default_body};
use crate::evaluation::alignment::{Alignment, truth_from_solved};
use crate::geometry::rotation;
use crate::optim::robust::median;
use crate::pipeline::config::{Extrinsics, ScaleSource};
use crate::pipeline::{Options, reconstruct};
use crate::progress::Progress;
use crate::session::people::BodyPose;
use crate::session::{BodyMotion, Reconstruction};
use crate::simulation::skeleton::Person;
use crate::simulation::{Bodies, MotionSource, Preset, Simulated, SimulationConfig, simulate};
use nalgebra::Vector3;
use std::path::PathBuf;

/// What is solved.
#[derive(Debug, clap::Args)]
pub(super) struct BodiesArgs {
    /// How many captures
    #[arg(long, default_value_t = 20)]
    count: u64,
    /// Seed of the first capture; the others follow
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Motion files in AMASS's layout to draw from, instead of procedural motion
    #[arg(long, num_args = 1..)]
    motion: Vec<PathBuf>,
    /// Solver threads; 0 takes all cores
    #[arg(long, default_value_t = 0)]
    pub threads: usize,
}

pub(super) fn run(args: &BodiesArgs) -> anyhow::Result<()> {
    let model = default_body();
    println!("## Fit: `easy` noise, true cameras, 26 keypoints");
    let (mut statures, mut places, [mut angles, mut steady]) =
        (Vec::new(), [const { Vec::new() }; N_JOINTS], [const { [const { Vec::new() }; N_JOINTS] }; 2]);
    for seed in args.seed..args.seed + args.count {
        for fit in fitted_people(&simulate(&fit_config(args, seed))?, &model)? {
            println!("capture {seed:3}: {}", fit.line());
            places.iter_mut().zip(fit.joints_mm).for_each(|(all, own)| all.push(own));
            statures.push(fit.stature_mm.abs());
            angles.iter_mut().zip(fit.angles_deg).for_each(|(all, own)| all.push(own));
            steady.iter_mut().zip(fit.steady_deg).for_each(|(all, own)| all.push(own));
        }
    }
    let [places, angles, steady] = [places, angles, steady].map(|all| all.map(|of_joint| mean(&of_joint)));
    println!(
        "stature {:.1} mm; joints in mm, their angles in degrees, and how much of those does not change:",
        mean(&statures)
    );
    for (joint, name) in JOINT_NAMES.iter().enumerate() {
        println!("  {name:<16} {:5.2} {:5.2} {:5.2}", places[joint], angles[joint], steady[joint]);
    }
    println!("  {:<16} {:5.2} {:5.2} {:5.2}", "mean", mean(&places), mean(&angles), mean(&steady));

    println!("## Metric scale: `paper` noise, cameras unknown, 2 to 4 people");
    for source in ["body", "height", "camera distance"] {
        let (mut errors, mut n_covered) = (Vec::new(), 0);
        for seed in args.seed..args.seed + args.count {
            let simulated = simulate(&scale_config(args, seed))?;
            let outcome = scale_outcome(&simulated, given_scale(source, &simulated, &model), seed)?;
            println!("capture {seed:3}: {source} {:+.2} %, interval {}", outcome.percent, outcome.holds);
            errors.push(outcome.percent.abs());
            n_covered += usize::from(outcome.holds);
        }
        let middle = median(&mut errors).unwrap_or(f64::NAN);
        println!("{source}: median {middle:.2} %, interval holds in {n_covered} of {}", errors.len());
    }
    Ok(())
}

fn fit_config(args: &BodiesArgs, seed: u64) -> SimulationConfig {
    let preset = SimulationConfig::preset(Preset::Easy);
    SimulationConfig { convention: KeypointConvention::Halpe26, ..drawn(args, seed, preset) }
}

fn scale_config(args: &BodiesArgs, seed: u64) -> SimulationConfig {
    let preset = SimulationConfig::preset(Preset::Paper);
    let people = 2 + (seed % 3) as usize;
    drawn(args, seed, SimulationConfig { people, views: 5, frames: 250, ..preset })
}

/// The configuration with default bodies, and motions from the files where there are some.
fn drawn(args: &BodiesArgs, seed: u64, config: SimulationConfig) -> SimulationConfig {
    let n_files = args.motion.len();
    let file = |person: usize| args.motion[(seed as usize * 31 + person * 7) % n_files].clone();
    let motion = match n_files {
        0 => MotionSource::Procedural,
        _ => MotionSource::Files((0..config.people).map(file).collect()),
    };
    SimulationConfig { seed, motion, bodies: Bodies::Default, ..config }
}

/// One person's fit against the truth.
struct Fit {
    /// Mean distance of every joint.
    joints_mm: [f64; N_JOINTS],
    stature_mm: f64,
    /// Mean angle between the fitted and the true turn of every joint.
    angles_deg: [f64; N_JOINTS],
    /// Length of the mean of their rotation vectors: what of them is the same in every frame.
    steady_deg: [f64; N_JOINTS],
}

impl Fit {
    fn line(&self) -> String {
        let (joints, angle) = (mean(&self.joints_mm), mean(&self.angles_deg));
        format!("joints {joints:.2} mm, stature {:+.1} mm, angles {angle:.2} deg", self.stature_mm)
    }
}

fn fitted_people(simulated: &Simulated, model: &BodyModel) -> anyhow::Result<Vec<Fit>> {
    let mut session = simulated.session.clone();
    session.views.iter_mut().zip(&simulated.truth.cameras).for_each(|(v, c)| v.camera_from_world = Some(*c));
    let options = Options { extrinsics: Extrinsics::Fixed, ..Options::default() };
    let found = reconstruct(&session, &options, &Progress::silent())?;
    let fit = |(index, person): (usize, &Person)| {
        let betas = person.betas?;
        let motion = found.motions.iter().min_by(|a, b| {
            let distance = |m: &BodyMotion| joint_distance_mm(m, simulated, index, 0);
            distance(a).total_cmp(&distance(b))
        })?;
        let stature_mm = 1e3 * (model.surface.stature(&Betas::from(motion.betas)) - model.surface.stature(&betas));
        let turns: [_; N_JOINTS] = std::array::from_fn(|joint| off_turns(motion, person, joint));
        let angle = |turns: &Vec<Vector3<f64>>| mean(&turns.iter().map(Vector3::norm).collect::<Vec<_>>()).to_degrees();
        let steady = |turns: &Vec<Vector3<f64>>| {
            turns.iter().sum::<Vector3<f64>>().norm().to_degrees() / turns.len().max(1) as f64
        };
        Some(Fit {
            joints_mm: std::array::from_fn(|joint| joint_distance_mm(motion, simulated, index, joint)),
            stature_mm,
            angles_deg: turns.each_ref().map(angle),
            steady_deg: turns.each_ref().map(steady),
        })
    };
    Ok(simulated.truth.people.iter().enumerate().filter_map(fit).collect())
}

fn joint_distance_mm(motion: &BodyMotion, simulated: &Simulated, person: usize, joint: usize) -> f64 {
    let truth = &simulated.truth.joints;
    let of_frame = |(i, frame): (usize, &BodyPose)| {
        Some((truth.get(motion.first.0 + i)?[person][joint] - frame.joints[joint]).norm())
    };
    1e3 * mean(&motion.frames.iter().enumerate().filter_map(of_frame).collect::<Vec<_>>())
}

/// From the true to the fitted turn of a joint, frame by frame, rad.
fn off_turns(motion: &BodyMotion, person: &Person, joint: usize) -> Vec<Vector3<f64>> {
    let turn = |(i, frame): (usize, &BodyPose)| {
        let truth = person.poses.get(motion.first.0 + i)?.rotations[joint];
        Some(rotation::log(&(truth.transpose() * frame.rotations[joint])))
    };
    motion.frames.iter().enumerate().filter_map(turn).collect()
}

/// What a user would measure.
fn given_scale(source: &str, simulated: &Simulated, model: &BodyModel) -> ScaleSource {
    match source {
        "height" => {
            let stature = |person: &Person| person.betas.map(|betas| model.surface.stature(&betas));
            let metres = simulated.truth.people.iter().filter_map(stature).fold(0.0, f64::max);
            ScaleSource::Height { metres, who: "tallest".to_owned() }
        }
        "camera distance" => {
            let [a, b] = [0, 1].map(|view| simulated.truth.cameras[view].center());
            let cameras = [0, 1].map(|view| simulated.session.views[view].id.clone());
            ScaleSource::CameraDistance { cameras, metres: (a - b).norm() }
        }
        _ => ScaleSource::Body,
    }
}

struct ScaleOutcome {
    /// Of the result's size against the true one.
    percent: f64,
    /// Whether the stated interval holds the truth.
    holds: bool,
}

fn scale_outcome(simulated: &Simulated, scale: ScaleSource, seed: u64) -> anyhow::Result<ScaleOutcome> {
    let options = Options { scale, seed, ..Options::default() };
    let found = reconstruct(&simulated.session, &options, &Progress::silent())?;
    let true_size = true_from_stated(&found, simulated);
    let holds = found.report.scale.as_ref().is_some_and(|told| {
        let [low, high] = told.interval95.map(|edge| edge / told.value);
        (low..=high).contains(&true_size)
    });
    Ok(ScaleOutcome { percent: 100.0 * (1.0 / true_size - 1.0), holds })
}

/// Factor from the result's metres to true ones.
fn true_from_stated(found: &Reconstruction, simulated: &Simulated) -> f64 {
    let (solved, truth) = paired_cameras(found, &simulated.truth.cameras);
    truth_from_solved(&solved, &truth, Alignment::Sim3).scale
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}
