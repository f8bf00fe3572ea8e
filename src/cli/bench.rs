//! `wandless bench`: accuracy on simulated and real sessions, and speed.

mod ablation;
mod bodies;
mod covariances;
mod coverage;
mod evaluated;
mod hands;
mod joint_angles;
mod markers;
mod mistakes;
mod rigs;
mod solved_cameras;
mod speed;
mod table;

use super::noise::NoiseName;
use super::solve::use_threads;

/// Arguments of `bench`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(subcommand)]
    bench: Bench,
}

#[derive(Debug, clap::Subcommand)]
enum Bench {
    /// Camera initialisation on random simulated rigs: share of rigs in which every camera pair is correct, and of truths in the
    /// stated 95 % intervals
    Rigs {
        /// Number of rigs
        #[arg(long, default_value_t = 200)]
        count: u64,
        /// Seed of the first rig; the others follow
        #[arg(long, default_value_t = 0)]
        seed: u64,
        /// A rig fails if the error of any camera pair exceeds this, degrees
        #[arg(long, default_value_t = 5.0)]
        limit_deg: f64,
        /// Kind of the detector's errors; their rates are those of the preset `paper`
        #[arg(long, value_enum, default_value_t = NoiseName::Real)]
        noise: NoiseName,
        /// Number of solver threads; 0 uses all cores
        #[arg(long, default_value_t = 0)]
        threads: usize,
    },
    /// Errors of body shape, joint angles and metric scale on simulated people with default bodies
    Bodies(bodies::BodiesArgs),
    /// Errors of fingers, wrists, cameras and bodies on simulated sessions with 133 points, against 17 points of the same detections
    Hands(hands::HandsArgs),
    /// What the covariances that a detector states are worth: errors with them, with wrong ones and without, on simulated sessions
    Covariances(covariances::CovariancesArgs),
    /// Ablation study on given or simulated sessions with ground truth; a table as Markdown and as JSON
    Ablation(ablation::AblationArgs),
    /// Errors of virtual skin markers on two dancing people with 1 to 12 cameras; a table as Markdown and as JSON
    Markers(markers::MarkersArgs),
    /// Mistakes in the files of sessions with ground truth: which are named, detected, harmless or silent; a table as Markdown and as JSON
    Mistakes(mistakes::MistakesArgs),
    /// Seconds per stage on one session, and throughput in frames x views x people per second and core
    Speed(speed::SpeedArgs),
}

/// Runs the command.
pub(super) fn run(args: Args) -> anyhow::Result<()> {
    match args.bench {
        Bench::Rigs { count, seed, limit_deg, noise, threads } => {
            use_threads(threads);
            rigs::run(seed..seed + count, limit_deg, noise)
        }
        Bench::Bodies(args) => bodies::run(&args),
        Bench::Hands(args) => hands::run(&args),
        Bench::Covariances(args) => covariances::run(&args),
        Bench::Ablation(args) => ablation::run(&args),
        Bench::Markers(args) => markers::run(&args),
        Bench::Mistakes(args) => mistakes::run(&args),
        Bench::Speed(args) => speed::run(&args),
    }
}
