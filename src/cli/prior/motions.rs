//! `wandless prior sample | reconstruct`: write motions of the prior as files in the AMASS layout.

use super::prior_file::{Model, read_latent_prior, read_prior};
use crate::body::skeleton::JOINT_NAMES;
use crate::cli::bad_input::BadInput;
use crate::geometry::rotation::{exp, log};
use crate::motion_prior::dataset::GRID_FPS;
use crate::motion_prior::grid::at_rate;
use crate::motion_prior::motion_file::{MotionPose, MotionTake, read_take};
use crate::motion_prior::motion_writer::write_take;
use crate::motion_prior::observed::{DESCRIBED_JOINTS, N_DESCRIBED, ObservedMotion};
use anyhow::Context;
use nalgebra::Vector3;
use std::path::{Path, PathBuf};

/// Draws random poses that change smoothly; the pelvis position is fixed.
#[derive(Debug, clap::Args)]
pub(super) struct SampleArgs {
    /// Output file
    #[arg(long)]
    out: PathBuf,
    /// Seed of the poses
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Length in frames at 30 Hz
    #[arg(long, default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..=20_000))]
    frames: u32,
    /// Network of the prior: denoiser decodes linearly
    #[arg(long, value_enum, default_value_t = Model::Denoiser)]
    model: Model,
    /// Prior file [default: the embedded prior]
    #[arg(long)]
    prior: Option<PathBuf>,
}

/// Removes noise and completes hidden joints by the denoiser, or encodes and decodes the motion by the autoencoder; collars,
/// hands and the pelvis position are copied from the input.
#[derive(Debug, clap::Args)]
pub(super) struct ReconstructArgs {
    /// Motion file in the AMASS layout
    input: PathBuf,
    /// Output file
    #[arg(long)]
    out: PathBuf,
    /// Standard deviation of the given rotations, degrees per axis
    #[arg(long, default_value_t = 1.0)]
    noise_deg: f64,
    /// Joints that are hidden, by name and separated by commas, such as left_shoulder,left_elbow
    #[arg(long, value_delimiter = ',', requires = "from", requires = "to")]
    hide: Vec<String>,
    /// First hidden frame of the file
    #[arg(long, requires = "hide")]
    from: Option<usize>,
    /// Frame after the last hidden one
    #[arg(long, requires = "hide")]
    to: Option<usize>,
    /// Network of the prior; latent takes neither noise nor hidden joints
    #[arg(long, value_enum, default_value_t = Model::Denoiser)]
    model: Model,
    /// Prior file [default: the embedded prior]
    #[arg(long)]
    prior: Option<PathBuf>,
}

/// Height of the pelvis above the floor in drawn motions, m.
const PELVIS_HEIGHT: f64 = 0.94;

pub(super) fn sample(args: SampleArgs) -> anyhow::Result<()> {
    let (n_frames, file) = (args.frames as usize, args.prior.as_deref());
    let drawn = match args.model {
        Model::Denoiser => read_prior(file)?.drawn(n_frames, args.seed),
        Model::Latent => read_latent_prior(file)?.drawn(n_frames, args.seed),
    };
    let pose = |rotations| MotionPose { rotations, pelvis: Vector3::new(0.0, PELVIS_HEIGHT, 0.0) };
    let poses = drawn.into_iter().map(pose).collect();
    write(&args.out, &MotionTake { rest_joints: None, poses, fps: GRID_FPS })
}

pub(super) fn reconstruct(args: ReconstructArgs) -> anyhow::Result<()> {
    if !(0.0..=60.0).contains(&args.noise_deg) {
        return Err(BadInput(format!("--noise-deg {}: give 0 to 60 degrees", args.noise_deg)).into());
    }
    let mut take = read_take(&args.input).map_err(|error| BadInput(format!("{}: {error}", args.input.display())))?;
    let rotations: Vec<_> = take.poses.iter().map(|pose| pose.rotations).collect();
    let pelvis: Vec<_> = take.poses.iter().map(|pose| pose.pelvis).collect();
    let mut sigma = vec![[args.noise_deg.to_radians(); N_DESCRIBED]; rotations.len()];
    let hidden = hidden_joints(&args.hide)?;
    let frames = args.from.unwrap_or(0)..args.to.unwrap_or(0);
    if frames.start > frames.end || frames.end > rotations.len() {
        let n = rotations.len();
        return Err(BadInput(format!(
            "--from {} --to {}: {} has frames 0 to {n}",
            frames.start,
            frames.end,
            args.input.display()
        ))
        .into());
    }
    for row in &mut sigma[frames] {
        hidden.iter().for_each(|&described| row[described] = f64::INFINITY);
    }
    let file = args.prior.as_deref();
    let found = match args.model {
        Model::Denoiser => {
            let prior = read_prior(file)?;
            at_rate(&ObservedMotion { rotations, pelvis, sigma }, take.fps, |motion| prior.completed(motion)).rotations
        }
        Model::Latent if hidden.is_empty() => read_latent_prior(file)?.reconstructed(&rotations, take.fps),
        Model::Latent => return Err(BadInput("--hide: the latent prior completes no joints".to_owned()).into()),
    };
    for (pose, rotations) in take.poses.iter_mut().zip(found) {
        pose.rotations = rotations.map(|r| exp(&log(&r)));
    }
    write(&args.out, &take)
}

/// Places of named joints among those that the prior describes.
fn hidden_joints(names: &[String]) -> Result<Vec<usize>, BadInput> {
    let place = |name: &String| {
        let found = DESCRIBED_JOINTS.iter().skip(1).position(|&joint| JOINT_NAMES[joint] == *name);
        found.map(|place| place + 1).ok_or_else(|| {
            let known: Vec<&str> = DESCRIBED_JOINTS.iter().skip(1).map(|&joint| JOINT_NAMES[joint]).collect();
            BadInput(format!("--hide {name}: not a joint of the prior; use {}", known.join(", ")))
        })
    };
    names.iter().map(place).collect()
}

fn write(path: &Path, take: &MotionTake) -> anyhow::Result<()> {
    write_take(path, take).with_context(|| path.display().to_string())
}
