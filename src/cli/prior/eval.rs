//! `wandless prior eval`: evaluates a motion prior.

use super::prior_file::{Model, read_latent_prior, read_prior};
use crate::cli::bad_input::BadInput;
use crate::motion_prior::dataset::{Take, read_dataset};
use crate::motion_prior::evaluation::{GapErrors, gap_errors};
use crate::motion_prior::reconstruction::{JointErrors, ReconstructionErrors, reconstruction_errors};
use std::path::PathBuf;

/// Hides limbs in held-out motion files and prints how far their completion by the denoiser is off, beside interpolations that
/// need no network: means over joints below the hidden ones and frames, mm. Of the autoencoder the errors of the joints after
/// encoding and decoding.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder with motion files
    data: PathBuf,
    /// Network of the prior
    #[arg(long, value_enum, default_value_t = Model::Denoiser)]
    model: Model,
    /// Prior file [default: the embedded prior]
    #[arg(long)]
    prior: Option<PathBuf>,
}

pub(super) fn run(args: Args) -> anyhow::Result<()> {
    let data = read_dataset(&args.data).map_err(|error| BadInput(error.to_string()))?;
    let n_frames: usize = data.takes.iter().map(|take| take.rotations.len()).sum();
    let takes: Vec<&Take> = data.takes.iter().collect();
    println!("{} takes, {n_frames} frames at 30 Hz", takes.len());
    match args.model {
        Model::Denoiser => print_gap_errors(&args, &takes),
        Model::Latent => print_reconstruction(&args, &takes),
    }
}

fn print_reconstruction(args: &Args, takes: &[&Take]) -> anyhow::Result<()> {
    let prior = &read_latent_prior(args.prior.as_deref())?;
    println!("{:?}", prior.provenance());
    let ReconstructionErrors { network, linear, mean_square } = reconstruction_errors(prior, takes);
    println!("             mean mm  95 % mm  acceleration / recorded");
    for (name, JointErrors { mean_mm, p95_mm, acceleration }) in [("network", network), ("linear code", linear)] {
        println!("{name:11} {mean_mm:8.2} {p95_mm:8.2} {acceleration:12.3}");
    }
    println!("mean square of the codes {mean_square:.2}");
    Ok(())
}

fn print_gap_errors(args: &Args, takes: &[&Take]) -> anyhow::Result<()> {
    let prior = &read_prior(args.prior.as_deref())?;
    println!("{:?}", prior.provenance());
    let errors: Vec<GapErrors> = gap_errors(prior, takes, 1).into_iter().filter(|errors| errors.n_gaps > 0).collect();
    if errors.is_empty() {
        return Err(BadInput(format!(
            "{}: no take is long enough for a gap; give takes of 2 s or more",
            args.data.display()
        ))
        .into());
    }
    println!("hidden     frames  gaps  spherical  cubic  bridge  denoiser  / better interpolation  inside 95 %");
    for kind in &errors {
        println!(
            "{:10} {:6} {:5} {:10.1} {:6.1} {:7.1} {:9.1} {:24.2} {:10.1} %",
            kind.hidden,
            kind.n_frames,
            kind.n_gaps,
            kind.spherical_mm,
            kind.cubic_mm,
            kind.bridge_mm,
            kind.denoiser_mm,
            kind.denoiser_mm / kind.baseline_mm(),
            100.0 * kind.share_inside(1.0)
        );
    }
    let mean = |value: fn(&GapErrors) -> f64| errors.iter().map(value).sum::<f64>() / errors.len() as f64;
    let denoiser = mean(|kind| kind.denoiser_mm);
    println!(
        "mean of the rows: spherical {:.1}, cubic {:.1}, bridge {:.1}, denoiser {denoiser:.1}; denoiser / better interpolation {:.3}",
        mean(|kind| kind.spherical_mm),
        mean(|kind| kind.cubic_mm),
        mean(|kind| kind.bridge_mm),
        denoiser / mean(GapErrors::baseline_mm)
    );
    Ok(())
}
