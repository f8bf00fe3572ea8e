//! `wandless prior sample | reconstruct | interpolate`: write motions of the prior as files in the AMASS layout.

use super::prior_file::read_prior;
use crate::cli::bad_input::BadInput;
use crate::motion_prior::MotionPrior;
use crate::motion_prior::chart::LocalRotations;
use crate::motion_prior::dataset::GRID_FPS;
use crate::motion_prior::evaluation::random_code;
use crate::motion_prior::motion_file::{MotionPose, MotionTake, read_take};
use crate::motion_prior::motion_writer::write_take;
use anyhow::Context;
use nalgebra::Vector3;
use std::path::{Path, PathBuf};

/// Samples a latent code from N(0, I), smooths it in time and decodes it; the pelvis position is fixed.
#[derive(Debug, clap::Args)]
pub(super) struct SampleArgs {
    /// Output file
    #[arg(long)]
    out: PathBuf,
    /// Seed of the latent code
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Length in frames at 30 Hz
    #[arg(long, default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..=20_000))]
    frames: u32,
    /// Prior file [default: the embedded prior]
    #[arg(long)]
    prior: Option<PathBuf>,
}

/// Encodes and decodes a motion; rotations of pelvis, collars and hands are copied from the input.
#[derive(Debug, clap::Args)]
pub(super) struct ReconstructArgs {
    /// Motion file in the AMASS layout
    input: PathBuf,
    /// Output file
    #[arg(long)]
    out: PathBuf,
    /// Prior file [default: the embedded prior]
    #[arg(long)]
    prior: Option<PathBuf>,
}

/// Interpolates linearly from the latent codes of one motion to those of another over the length of the shorter one.
#[derive(Debug, clap::Args)]
pub(super) struct InterpolateArgs {
    /// Motion file of the start
    from: PathBuf,
    /// Motion file of the end
    to: PathBuf,
    /// Output file
    #[arg(long)]
    out: PathBuf,
    /// Prior file [default: the embedded prior]
    #[arg(long)]
    prior: Option<PathBuf>,
}

/// Height of the pelvis above the floor in generated motions, m.
const PELVIS_HEIGHT: f64 = 0.94;

pub(super) fn sample(args: SampleArgs) -> anyhow::Result<()> {
    let prior = read_prior(args.prior.as_deref())?;
    write(&args.out, &in_place(&prior, &[random_code(args.frames as usize, args.seed)]))
}

pub(super) fn reconstruct(args: ReconstructArgs) -> anyhow::Result<()> {
    let prior = read_prior(args.prior.as_deref())?;
    let mut take = read(&args.input)?;
    let rotations: Vec<_> = take.poses.iter().map(|pose| pose.rotations).collect();
    for (pose, rotations) in take.poses.iter_mut().zip(prior.reconstructed(&rotations, None, take.fps)) {
        pose.rotations = rotations;
    }
    write(&args.out, &take)
}

pub(super) fn interpolate(args: InterpolateArgs) -> anyhow::Result<()> {
    let prior = read_prior(args.prior.as_deref())?;
    let observed = |path: &Path| -> anyhow::Result<_> {
        let take = read(path)?;
        let rotations: Vec<_> = take.poses.iter().map(|pose| pose.rotations).collect();
        Ok(prior.observed(&rotations, None, take.fps))
    };
    let codes = prior.encode(&[observed(&args.from)?, observed(&args.to)?]);
    let n = codes[0].mean.len().min(codes[1].mean.len());
    let pairs = codes[0].mean[..n].iter().zip(&codes[1].mean[..n]);
    let blend = |(i, (a, b)): (usize, (&f32, &f32))| a + (b - a) * (i as f32 / n as f32);
    write(&args.out, &in_place(&prior, &[pairs.enumerate().map(blend).collect()]))
}

fn read(path: &Path) -> anyhow::Result<MotionTake> {
    Ok(read_take(path).map_err(|error| BadInput(format!("{}: {error}", path.display())))?)
}

fn write(path: &Path, take: &MotionTake) -> anyhow::Result<()> {
    write_take(path, take).with_context(|| path.display().to_string())
}

/// Decodes latent codes to a motion with a fixed pelvis position.
fn in_place(prior: &MotionPrior, codes: &[Vec<f32>]) -> MotionTake {
    let features = prior.decode(codes);
    let pose = |rotations: LocalRotations| MotionPose { rotations, pelvis: Vector3::new(0.0, PELVIS_HEIGHT, 0.0) };
    let poses = features.iter().flat_map(|f| prior.rotations(f)).map(pose).collect();
    MotionTake { rest_joints: None, poses, fps: GRID_FPS }
}
