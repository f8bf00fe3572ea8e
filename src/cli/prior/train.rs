//! `wandless prior train`: trains a motion prior.

use crate::cli::bad_input::BadInput;
use crate::cli::progress_display::ProgressDisplay;
use crate::motion_prior::checkpoint::checkpoint_bytes;
use crate::motion_prior::dataset::read_dataset;
use crate::motion_prior::training::{TrainingConfig, TrainingState, state_bytes, state_from_bytes, train};
use crate::motion_prior::{VaeForm, VaeShape};
use crate::progress::Progress;
use anyhow::Context;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Trains a prior on every `.npz` file below a folder. Each subfolder is a subject; every ninth subject is held out. The
/// same data, seed and steps give the same bytes with any number of threads.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder with one subfolder of motion files per subject
    data: PathBuf,
    /// Output file
    #[arg(long)]
    out: PathBuf,
    /// Seed of all random numbers
    #[arg(long, default_value_t = TrainingConfig::default().seed)]
    seed: u64,
    /// Number of training steps, each on about 2,000 frames
    #[arg(long, default_value_t = TrainingConfig::default().steps)]
    steps: usize,
    /// Width of the encoder layers
    #[arg(long, default_value_t = VaeShape::default().encoder_hidden)]
    encoder_width: usize,
    /// Width of the decoder layers
    #[arg(long, default_value_t = VaeShape::default().decoder_hidden)]
    decoder_width: usize,
    /// Weight of the local linearity loss
    #[arg(long, default_value_t = TrainingConfig::default().local_linear)]
    local_linear: f64,
    /// Train the variant without temporal context
    #[arg(long)]
    per_frame: bool,
    /// Train the form of the paper: 6D rotations as input and output, no frozen layers
    #[arg(long, conflicts_with = "per_frame")]
    plain: bool,
    /// Resume from the state that an interrupted run saved beside the output file
    #[arg(long)]
    resume: bool,
}

pub(super) fn run(args: Args) -> anyhow::Result<()> {
    let data = read_dataset(&args.data).map_err(|error| BadInput(error.to_string()))?;
    let form = match (args.plain, args.per_frame) {
        (true, _) => VaeForm::Plain,
        (false, true) => VaeForm::PerFrame,
        (false, false) => VaeForm::Recurrent,
    };
    let shape = VaeShape { encoder_hidden: args.encoder_width, decoder_hidden: args.decoder_width, form };
    let config = TrainingConfig { seed: args.seed, steps: args.steps, shape, local_linear: args.local_linear };
    let state_path = args.out.with_extension("state");
    let state = if args.resume { Some(read_state(&state_path)?) } else { None };
    let last_line = Arc::new(Mutex::new(String::new()));
    let display = ProgressDisplay::new();
    let lines = last_line.clone();
    let listener = move |event: &crate::progress::ProgressEvent| {
        display.show("training", event.fraction, &event.message);
        *lines.lock().unwrap_or_else(PoisonError::into_inner) = event.message.clone();
    };
    let mut saved = Ok(());
    let mut save = |state: &TrainingState| {
        let written = std::fs::write(&state_path, state_bytes(state));
        saved = std::mem::replace(&mut saved, Ok(())).and(written);
    };
    let progress = Progress::new(listener, Arc::default());
    let checkpoint = train(&data, &config, state, &progress, &mut save).map_err(|e| BadInput(e.to_string()))?;
    saved.with_context(|| state_path.display().to_string())?;
    std::fs::write(&args.out, checkpoint_bytes(&checkpoint)).with_context(|| args.out.display().to_string())?;
    let _ = std::fs::remove_file(&state_path); // only an interrupted run needs it
    println!("{}", last_line.lock().unwrap_or_else(PoisonError::into_inner));
    Ok(())
}

fn read_state(path: &Path) -> anyhow::Result<TrainingState> {
    let bytes = std::fs::read(path).map_err(|error| BadInput(format!("{}: {error}", path.display())))?;
    state_from_bytes(&bytes).map_err(|error| BadInput(format!("{}: {error}", path.display())).into())
}
