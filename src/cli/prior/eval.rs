//! `wandless prior eval`.

use super::read_prior;
use crate::cli::BadInput;
use crate::motion_prior::MotionPrior;
use crate::motion_prior::basis::LATENT_DIM;
use crate::motion_prior::chart::N_FEATURES;
use crate::motion_prior::dataset::read_dataset;
use crate::motion_prior::evaluation::{
    DEEP, JointErrors, TaskErrors, clips_of, features_of, gap_task, latent_statistics, limb_task, noise_task,
    penetrating_share, prolonged, rate_difference_mm, reconstruction, sample_statistics,
};
use std::path::PathBuf;
use std::time::Instant;

/// Measures a prior on motion files that it was not trained on; prints a table.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Args {
    /// Folder with motion files
    data: PathBuf,
    /// The prior; the embedded one without it
    #[arg(long)]
    prior: Option<PathBuf>,
}

/// Length of the clips that are damaged, frames: the damage in the middle, a second around it.
const CLIP_FRAMES: usize = 120;
/// People and frames of the timed gradient.
const TIMED: (usize, usize) = (4, 300);

pub(in crate::cli) fn run(args: Args) -> anyhow::Result<()> {
    let prior = &read_prior(args.prior.as_deref())?;
    let data = read_dataset(&args.data).map_err(|error| BadInput(error.to_string()))?;
    let takes = features_of(prior, &data.takes);
    let n_frames: usize = data.takes.iter().map(|take| take.rotations.len()).sum();
    println!("{} takes, {n_frames} frames at 30 Hz; {:?}", takes.len(), prior.provenance());

    print_errors("reconstruction", &reconstruction(prior, &takes));
    let longest = takes.iter().max_by_key(|take| take.len());
    if let Some(longest) = longest {
        print_errors("  2,000 frames", &reconstruction(prior, &[prolonged(longest, 2000)]));
        print_errors("  the same, its own length", &reconstruction(prior, std::slice::from_ref(longest)));
    }
    print_errors("  8 frames each", &reconstruction(prior, &clips_of(&takes, 8)));
    let latent = latent_statistics(prior, &takes);
    println!(
        "z: mean square {:.2} ({:.2} to {:.2}), KL {:.2} nats a frame and dimension, second difference {:.4}",
        latent.mean_square, latent.min_square, latent.max_square, latent.kl, latent.acceleration
    );
    let clips = clips_of(&takes, CLIP_FRAMES);
    print_task("completion, 15 frames", &gap_task(prior, &clips));
    print_task("completion, a limb for 60 frames", &limb_task(prior, &clips));
    print_task("denoising, 10 deg on half of all joints and frames", &noise_task(prior, &clips, false));
    print_task("denoising, 10 deg on half of the joints throughout", &noise_task(prior, &clips, true));
    for fps in [25.0, 60.0] {
        let [worst, mean] = rate_difference_mm(prior, &data.takes, fps);
        println!("{fps} Hz against 30 Hz: mean {mean:.2} mm, largest {worst:.2} mm");
    }
    let samples = sample_statistics(prior, 1000, 1);
    println!(
        "1,000 samples: {:.1} % of frames within joint limits ({:.1} % with 10 deg to spare), {:.1} % with capsules more than \
         {:.0} cm inside each other (the takes: {:.1} %), foot height spread {:.3} m",
        100.0 * samples.within_limits,
        100.0 * samples.within_limits_and_10_deg,
        100.0 * samples.penetrating,
        100.0 * DEEP,
        100.0 * penetrating_share(&data.takes),
        samples.foot_height_spread
    );
    println!("gradient of {} people x {} frames on one thread: {:.3} s", TIMED.0, TIMED.1, gradient_secs(prior)?);
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
    let each = task.smoothings_mm.iter().map(|(s, error)| format!("{error:.1} ({}, {})", s.order, s.stiffness));
    println!(
        "  best smoothing {:.2} mm, AR(2) {:.2} mm; each (order, stiffness): {}",
        task.best_smoothing_mm(),
        task.autoregression_mm,
        each.collect::<Vec<_>>().join(", ")
    );
}

/// The quickest of five decodings with gradient.
fn gradient_secs(prior: &MotionPrior) -> anyhow::Result<f64> {
    let (people, frames) = TIMED;
    let codes = vec![vec![0.1; frames * LATENT_DIM]; people];
    let pulls = vec![vec![1.0; frames * N_FEATURES]; people];
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let once = || {
        let start = Instant::now();
        let motions = prior.decode_for_gradient(&codes);
        std::hint::black_box(prior.pull_back(&motions, &pulls));
        start.elapsed().as_secs_f64()
    };
    Ok(pool.install(|| (0..5).map(|_| once()).fold(f64::INFINITY, f64::min)))
}
