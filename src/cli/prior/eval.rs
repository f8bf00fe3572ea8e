//! `wandless prior eval`: evaluates a motion prior.

use super::prior_file::read_prior;
use crate::cli::bad_input::BadInput;
use crate::motion_prior::dataset::read_dataset;
use crate::motion_prior::evaluation::{
    DEEP, JointErrors, TaskErrors, clips_of, features_of, gap_task, latent_statistics, limb_task, noise_task,
    penetrating_share, prolonged, rate_difference_mm, reconstruction, sample_statistics,
};
use std::path::PathBuf;

/// Evaluates a prior on held-out motion files and prints a table.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder with motion files
    data: PathBuf,
    /// Prior file [default: the embedded prior]
    #[arg(long)]
    prior: Option<PathBuf>,
}

/// Length of the corrupted clips, frames: the corruption in the middle and one second before and after it.
const CLIP_FRAMES: usize = 120;

pub(super) fn run(args: Args) -> anyhow::Result<()> {
    let prior = &read_prior(args.prior.as_deref())?;
    let data = read_dataset(&args.data).map_err(|error| BadInput(error.to_string()))?;
    let takes = features_of(prior, &data.takes);
    let n_frames: usize = data.takes.iter().map(|take| take.rotations.len()).sum();
    println!("{} takes, {n_frames} frames at 30 Hz; {:?}", takes.len(), prior.provenance());

    print_errors("reconstruction", &reconstruction(prior, &takes));
    let longest = takes.iter().max_by_key(|take| take.len());
    if let Some(longest) = longest {
        print_errors("  longest take, repeated to 2,000 frames", &reconstruction(prior, &[prolonged(longest, 2000)]));
        print_errors("  longest take", &reconstruction(prior, std::slice::from_ref(longest)));
    }
    print_errors("  clips of 8 frames", &reconstruction(prior, &clips_of(&takes, 8)));
    let latent = latent_statistics(prior, &takes);
    println!(
        "z: mean square {:.2} ({:.2} to {:.2}), KL {:.2} nats per frame and dimension, second difference {:.4}",
        latent.mean_square, latent.min_square, latent.max_square, latent.kl, latent.acceleration
    );
    let clips = clips_of(&takes, CLIP_FRAMES);
    print_task("completion, 15 frames", &gap_task(prior, &clips));
    print_task("completion, a limb for 60 frames", &limb_task(prior, &clips));
    print_task("denoising, 10 deg noise on random halves of joints and frames", &noise_task(prior, &clips, false));
    print_task("denoising, 10 deg noise on half of the joints in all frames", &noise_task(prior, &clips, true));
    for fps in [25.0, 60.0] {
        let [worst, mean] = rate_difference_mm(prior, &data.takes, fps);
        println!("{fps} Hz against 30 Hz: mean {mean:.2} mm, largest {worst:.2} mm");
    }
    let samples = sample_statistics(prior, 1000, 1);
    println!(
        "1,000 samples: {:.1} % of frames within joint limits ({:.1} % with a margin of 10 deg), {:.1} % with capsules that \
         overlap by more than {:.0} cm (takes: {:.1} %), foot height spread {:.3} m",
        100.0 * samples.within_limits,
        100.0 * samples.within_limits_and_10_deg,
        100.0 * samples.penetrating,
        100.0 * DEEP,
        100.0 * penetrating_share(&data.takes),
        samples.foot_height_spread
    );
    Ok(())
}

fn print_errors(name: &str, errors: &JointErrors) {
    println!(
        "{name}: mean {:.2} mm, p95 {:.1} mm, acceleration ratio {:.3}",
        errors.mean_mm, errors.p95_mm, errors.acceleration_ratio
    );
}

fn print_task(name: &str, task: &TaskErrors) {
    print_errors(name, &task.prior);
    let smoothings = task.smoothings_mm.iter().map(|(s, error)| format!("{error:.1} ({}, {})", s.order, s.stiffness));
    println!(
        "  best smoothing {:.2} mm, AR(2) {:.2} mm; all smoothings (order, stiffness): {}",
        task.best_smoothing_mm(),
        task.autoregression_mm,
        smoothings.collect::<Vec<_>>().join(", ")
    );
}
