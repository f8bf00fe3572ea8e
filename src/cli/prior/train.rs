//! `wandless prior train`: trains a motion prior.

use super::prior_file::Model;
use crate::cli::bad_input::BadInput;
use crate::cli::progress_display::ProgressDisplay;
use crate::motion_prior::dataset::read_dataset;
use crate::motion_prior::training::{TrainingConfig, train};
use crate::motion_prior::weights::Weights;
use crate::progress::{Progress, ProgressEvent};
use anyhow::Context;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Trains a prior on every `.npz` file below a folder. Each subfolder is a subject; every ninth subject is held out. The
/// same data, seed and steps give the same bytes with any number of threads.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder with one subfolder of motion files per subject
    data: PathBuf,
    /// Output file; it holds the best weights so far while the training runs
    #[arg(long)]
    out: PathBuf,
    /// Network: denoiser completes hidden joints, latent is an autoencoder of motions
    #[arg(long, value_enum, default_value_t = Model::Denoiser)]
    model: Model,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of training steps, each on about 2,000 frames of the denoiser and 1,000 of the autoencoder; with 0 the denoiser's
    /// correction stays zero and only its uncertainty is calibrated, and the autoencoder is a linear code [default: 4000, 1000]
    #[arg(long)]
    steps: Option<usize>,
    /// Width of the network's layers [default: 48, 64]
    #[arg(long, value_parser = width)]
    width: Option<usize>,
}

/// A width that the prior's file may have.
fn width(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|width| (8..=1024).contains(width)).ok_or_else(|| "give 8 to 1024".to_owned())
}

/// Refuses an output file that could not be written, before hours of training.
fn require_place(out: &Path) -> Result<(), BadInput> {
    let folder = out.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let problem = match (out.is_dir(), folder.is_dir()) {
        (true, _) => "is a folder; add the name of a file",
        (_, false) => "has no folder to be written in; make it first",
        _ => return Ok(()),
    };
    Err(BadInput(format!("{}: the output file {problem}", out.display())))
}

pub(super) fn run(args: Args) -> anyhow::Result<()> {
    require_place(&args.out)?;
    let data = read_dataset(&args.data).map_err(|error| BadInput(error.to_string()))?;
    let defaults = TrainingConfig::of(args.model.kind());
    let (steps, width) = (args.steps.unwrap_or(defaults.steps), args.width.unwrap_or(defaults.width));
    let config = TrainingConfig { seed: args.seed, steps, width, ..defaults };
    let last_line = Arc::new(Mutex::new(String::new()));
    let display = ProgressDisplay::new();
    let lines = last_line.clone();
    let listener = move |event: &ProgressEvent| {
        display.show("training", event.fraction, &event.message);
        lines.lock().unwrap_or_else(PoisonError::into_inner).clone_from(&event.message);
    };
    let progress = Progress::new(listener, Arc::default());
    let write = |weights: &Weights| -> anyhow::Result<()> {
        std::fs::write(&args.out, weights.to_bytes()?).with_context(|| args.out.display().to_string())
    };
    let mut kept = Ok(());
    let mut keep = |weights: &Weights| kept = write(weights);
    let weights = train(&data, &config, &progress, &mut keep).map_err(|error| BadInput(error.to_string()))?;
    kept?;
    write(&weights)?;
    println!("{}", last_line.lock().unwrap_or_else(PoisonError::into_inner));
    println!("{:?}", weights.provenance);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_output_folder_was_found_after_the_training() {
        let place = tempfile::tempdir().unwrap();
        for (out, remedy) in [("none/prior.bin", "make it first"), ("", "name of a file")] {
            let error = require_place(&place.path().join(out)).unwrap_err();
            assert!(error.to_string().contains(remedy), "{error}");
        }
        assert!(
            require_place(&place.path().join("prior.bin")).is_ok() && require_place(Path::new("prior.bin")).is_ok()
        );
    }
}
