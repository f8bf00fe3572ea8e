//! `wandless bench rigs`: success rate of camera initialisation on random rigs, and calibration of its uncertainty.

use crate::cli::noise::NoiseName;
use crate::evaluation::alignment::Alignment;
use crate::evaluation::camera_error::{CameraPair, camera_errors, camera_pairs, relative_camera_error};
use crate::optim::robust::INTERVAL_95;
use crate::pipeline::{Options, reconstruct};
use crate::progress::Progress;
use crate::session::reconstruction::{SolvedCamera, Verdict};
use crate::simulation::{Simulated, random_rig_config, simulate};
use std::time::Instant;

/// Solves one rig per seed and prints one line per rig, then the totals.
pub(super) fn run(seeds: std::ops::Range<u64>, limit_deg: f64, noise: NoiseName) -> anyhow::Result<()> {
    let (mut large, mut small) = (Totals::default(), Totals::default());
    for seed in seeds {
        let mut config = random_rig_config(seed);
        config.noise = noise.of(config.noise);
        let started = Instant::now();
        let outcome = solve_rig(&simulate(&config)?, seed);
        let failed = outcome.worst_deg > limit_deg;
        println!(
            "rig {seed:4}: {} views, {} people: worst pair {:8.3} deg, {}{}, {:.1} s",
            config.views,
            config.people,
            outcome.worst_deg,
            outcome.verdict.map_or("rejected".to_owned(), |v| format!("{v:?}").to_lowercase()),
            if failed { "  FAILED" } else { "" },
            started.elapsed().as_secs_f64()
        );
        let totals = if config.views >= 3 && config.people >= 2 { &mut large } else { &mut small };
        totals.add(&outcome, failed);
    }
    large.print("at least 3 views and 2 people");
    small.print("fewer views or people");
    Ok(())
}

/// Outcome of one rig.
struct RigOutcome {
    /// Largest error over all camera pairs, degrees; infinite if a camera is missing.
    worst_deg: f64,
    /// Verdict; `None` if the session was rejected as unsolvable.
    verdict: Option<Verdict>,
    coverage: Coverage,
}

/// Number of estimated 95 % intervals of camera positions and orientations that contain the truth, after Sim(3) alignment.
#[derive(Debug, Clone, Copy, Default)]
struct Coverage {
    n: usize,
    positions: usize,
    orientations: usize,
}

/// Totals of one class of rigs.
#[derive(Default)]
struct Totals {
    n: usize,
    failed: usize,
    failed_without_warning: usize,
    warned: usize,
    worst: Vec<f64>,
    coverage: Coverage,
}

impl Totals {
    fn add(&mut self, outcome: &RigOutcome, failed: bool) {
        let warned = outcome.verdict != Some(Verdict::Pass);
        self.n += 1;
        self.failed += usize::from(failed);
        self.failed_without_warning += usize::from(failed && !warned);
        self.warned += usize::from(warned && !failed);
        self.worst.push(outcome.worst_deg);
        self.coverage.n += outcome.coverage.n;
        self.coverage.positions += outcome.coverage.positions;
        self.coverage.orientations += outcome.coverage.orientations;
    }

    fn print(mut self, name: &str) {
        if self.n == 0 {
            return;
        }
        self.worst.sort_by(f64::total_cmp);
        println!(
            "{name}: {} of {} within the limit ({:.1} %); median of the worst pair {:.3} deg; failures without a warning: {}; \
             warnings on correct rigs: {}",
            self.n - self.failed,
            self.n,
            100.0 * (self.n - self.failed) as f64 / self.n as f64,
            self.worst[self.n / 2],
            self.failed_without_warning,
            self.warned
        );
        let Coverage { n, positions, orientations } = self.coverage;
        let percent = |count: usize| 100.0 * count as f64 / n.max(1) as f64;
        println!(
            "  95 % intervals of {n} cameras contain {:.1} % of the positions and {:.1} % of the orientations",
            percent(positions),
            percent(orientations)
        );
    }
}

/// Solves a simulated rig and compares its cameras with the truth.
fn solve_rig(simulated: &Simulated, seed: u64) -> RigOutcome {
    let options = Options { seed, ..Options::default() };
    let Ok(result) = reconstruct(&simulated.session, &options, &Progress::silent()) else {
        return RigOutcome { worst_deg: f64::INFINITY, verdict: None, coverage: Coverage::default() };
    };
    let pairs = camera_pairs(&simulated.session, &simulated.truth.cameras, &result.cameras);
    let complete = pairs.len() == simulated.session.views.len();
    let error = relative_camera_error(&pairs).filter(|_| complete);
    let worst_deg = error.map_or(f64::INFINITY, |e| e.rotation_deg.max(e.direction_deg));
    let coverage = if complete { coverage(&pairs, &result.cameras) } else { Coverage::default() };
    RigOutcome { worst_deg, verdict: Some(result.report.quality.verdict), coverage }
}

fn coverage(pairs: &[CameraPair], solved: &[SolvedCamera]) -> Coverage {
    let errors = camera_errors(pairs, &[], Alignment::Sim3);
    let mut coverage = Coverage::default();
    for (pair, camera) in pairs.iter().zip(solved) {
        let error = &errors.per_camera[&pair.id];
        let (Some(position), Some(angle)) = (camera.sigma_position_mm, camera.sigma_angle_deg) else { continue };
        coverage.n += 1;
        coverage.positions += usize::from(error.position_mm <= INTERVAL_95 * position);
        coverage.orientations += usize::from(error.angle_deg <= INTERVAL_95 * angle);
    }
    coverage
}
