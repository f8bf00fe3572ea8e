//! `wandless bench rigs`: success rate of camera initialisation on random rigs, and calibration of its uncertainty.

use super::coverage::Coverages;
use crate::cli::noise::NoiseName;
use crate::evaluation::camera_error::{camera_pairs, relative_camera_error};
use crate::pipeline::{Options, reconstruct};
use crate::progress::Progress;
use crate::session::reconstruction::Verdict;
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
            "rig {seed:4}: {} views, {} people: worst pair {:8.3} deg, {}{}{}, {:.1} s",
            config.views,
            config.people,
            outcome.worst_deg,
            outcome.verdict.map_or("rejected".to_owned(), |v| format!("{v:?}").to_lowercase()),
            if failed { "  FAILED" } else { "" },
            outcome.suspicions.iter().map(|code| format!(", suspected {code}")).collect::<String>(),
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
    /// Codes of the mistakes that it was suspected of, which no rig has.
    suspicions: Vec<String>,
    coverages: Coverages,
}

/// Totals of one class of rigs.
#[derive(Default)]
struct Totals {
    n: usize,
    failed: usize,
    failed_without_warning: usize,
    warned: usize,
    suspected: usize,
    worst: Vec<f64>,
    coverages: Coverages,
}

impl Totals {
    fn add(&mut self, outcome: &RigOutcome, failed: bool) {
        let warned = outcome.verdict != Some(Verdict::Pass);
        self.n += 1;
        self.failed += usize::from(failed);
        self.failed_without_warning += usize::from(failed && !warned);
        self.warned += usize::from(warned && !failed);
        self.suspected += usize::from(!outcome.suspicions.is_empty());
        self.worst.push(outcome.worst_deg);
        self.coverages.merge(&outcome.coverages);
    }

    fn print(mut self, name: &str) {
        if self.n == 0 {
            return;
        }
        self.worst.sort_by(f64::total_cmp);
        println!(
            "{name}: {} of {} within the limit ({:.1} %); median of the worst pair {:.3} deg; failures without a warning: {}; \
             warnings on correct rigs: {}; suspected of a mistake: {}",
            self.n - self.failed,
            self.n,
            100.0 * (self.n - self.failed) as f64 / self.n as f64,
            self.worst[self.n / 2],
            self.failed_without_warning,
            self.warned,
            self.suspected
        );
        println!("{}", self.coverages);
    }
}

/// Solves a simulated rig and compares its cameras with the truth.
fn solve_rig(simulated: &Simulated, seed: u64) -> RigOutcome {
    let options = Options { seed, ..Options::default() };
    let Ok(result) = reconstruct(&simulated.session, &options, &Progress::silent()) else {
        let (suspicions, coverages) = (Vec::new(), Coverages::default());
        return RigOutcome { worst_deg: f64::INFINITY, verdict: None, suspicions, coverages };
    };
    let pairs = camera_pairs(&simulated.session, &simulated.truth.cameras, &result.cameras);
    let complete = pairs.len() == simulated.session.views.len();
    let error = relative_camera_error(&pairs).filter(|_| complete);
    let worst_deg = error.map_or(f64::INFINITY, |e| e.rotation_deg.max(e.direction_deg));
    let coverages = if complete { Coverages::of(simulated, &result, &pairs) } else { Coverages::default() };
    let suspicions = result.report.suspicions.iter().map(|suspicion| suspicion.code.name()).collect();
    RigOutcome { worst_deg, verdict: Some(result.report.quality.verdict), suspicions, coverages }
}
