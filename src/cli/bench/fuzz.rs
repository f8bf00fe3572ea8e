//! `wandless bench fuzz`: runs a file reader on inputs that are made from valid ones by seeded random damage.
//!
//! A case with a new outcome becomes a seed itself, so that damage accumulates on inputs that get far. The same seed, corpus
//! and number of cases give the same cases. A panic, an accepted invalid value, a slow case or excessive memory is a
//! failure: the case is saved and reported, and the command fails.
//!
//! Why not cargo-fuzz: it needs a nightly compiler, and damage to words and numbers reaches the readers of text formats. The
//! error codes of rejected inputs replace most of the feedback that instrumentation would give.

mod corpus;
mod damage;
mod targets;
mod watch;

use crate::cli::bad_input::BadInput;
use corpus::{Input, read_seeds};
use damage::damaged;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use targets::{TARGETS, Target};
use watch::Watch;

/// Arguments of `bench fuzz`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Reader to fuzz; `list` prints all readers
    #[arg(long)]
    target: String,
    /// Duration, seconds
    #[arg(long, default_value_t = 60)]
    seconds: u64,
    /// Maximum number of cases; 0 means unlimited
    #[arg(long, default_value_t = 0)]
    cases: u64,
    /// Seed of the damage
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Folder with one subfolder of seed inputs per kind of input
    #[arg(long, default_value = "checks/fuzz")]
    corpus: PathBuf,
    /// Folder for the inputs of failed cases
    #[arg(long, default_value = "fuzz-failures")]
    failures: PathBuf,
}

/// Time limit of a case. A case that exceeds it is repeated and timed in processor time, because the machine may be busy.
const MAX_CASE: Duration = Duration::from_secs(1);

/// Memory limit of a case beyond its input, KiB.
const MAX_GROWTH_KIB: u64 = 64 << 10;

/// Number of cases between two measurements of memory.
const BATCH: usize = 256;

/// Maximum number of seeds.
const MAX_SEEDS: usize = 4000;

/// Maximum size of an input, bytes.
const MAX_BYTES: usize = 256 << 10;

/// Totals of a run.
#[derive(Default)]
struct Totals {
    n_cases: u64,
    n_accepted: u64,
    outcomes: BTreeSet<String>,
    n_failed: u64,
    longest: Duration,
    largest_kib: u64,
}

/// Runs the command.
pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    if args.target == "list" {
        TARGETS.iter().for_each(|target| println!("{:<16} {}", target.name, target.description));
        return Ok(());
    }
    let target = TARGETS.iter().find(|target| target.name == args.target);
    let target = target.ok_or_else(|| {
        BadInput(format!("--target {}: no such reader; `--target list` prints all readers", args.target))
    })?;
    let mut seeds: Vec<Input> = read_seeds(&args.corpus.join(target.seeds))?.into_iter().map(target.prepare).collect();
    println!("target {}, {} seeds, seed {}", target.name, seeds.len(), args.seed);
    let totals = fuzz(target, &mut seeds, args);
    println!(
        "{} cases, {} accepted, {} kinds of outcome, {} failed, longest case {:.0} ms, memory +{} MiB",
        totals.n_cases,
        totals.n_accepted,
        totals.outcomes.len(),
        totals.n_failed,
        totals.longest.as_secs_f64() * 1e3,
        totals.largest_kib >> 10,
    );
    anyhow::ensure!(totals.n_failed == 0, "{} failed cases were saved in {}", totals.n_failed, args.failures.display());
    Ok(())
}

fn fuzz(target: &Target, seeds: &mut Vec<Input>, args: &Args) -> Totals {
    let mut rng = ChaCha8Rng::seed_from_u64(args.seed);
    let mut totals = Totals::default();
    let watch = Watch::start(&args.failures);
    let n_valid = seeds.len();
    for seed in seeds.clone() {
        try_case(target, seed, seeds, &watch, &mut totals, &args.failures);
    }
    let end = Instant::now() + Duration::from_secs(args.seconds);
    while Instant::now() < end && (args.cases == 0 || totals.n_cases < args.cases) {
        let memory = watch::reset_peak();
        let mut batch = Vec::with_capacity(BATCH);
        for _ in 0..BATCH {
            // Half of the cases start from a valid input, because inputs that were damaged repeatedly seldom get far.
            let pool = if rng.random() { &seeds[..n_valid] } else { &seeds[..] };
            let seed = pool.choose(&mut rng).expect("a folder without seeds is rejected").clone();
            let case = damaged(seed, seeds, MAX_BYTES, &mut rng);
            batch.push(case.clone());
            try_case(target, case, seeds, &watch, &mut totals, &args.failures);
        }
        let growth = watch::growth_kib(memory);
        totals.largest_kib = totals.largest_kib.max(growth);
        if growth > MAX_GROWTH_KIB {
            find_memory_failure(target, batch, &mut totals, &args.failures);
        }
    }
    totals
}

/// Runs one case and adds it to the seeds if its outcome is new.
fn try_case(target: &Target, case: Input, seeds: &mut Vec<Input>, watch: &Watch, totals: &mut Totals, failures: &Path) {
    let started = Instant::now();
    let outcome = watch.run(&case, || (target.read)(&case));
    let mut duration = started.elapsed();
    if duration > MAX_CASE {
        let (started, before) = (Instant::now(), watch::processor_time());
        let _ = watch.run(&case, || (target.read)(&case)); // the outcome of the first run counts
        let processor_time = before.zip(watch::processor_time()).map(|(before, after)| after.saturating_sub(before));
        duration = processor_time.unwrap_or(started.elapsed());
    }
    totals.n_cases += 1;
    totals.longest = totals.longest.max(duration);
    let outcome = match outcome {
        Ok(outcome) if duration <= MAX_CASE => outcome,
        Ok(_) => {
            return save_failure(&case, &format!("the case took {:.1} s", duration.as_secs_f64()), totals, failures);
        }
        Err(fault) => return save_failure(&case, &fault, totals, failures),
    };
    totals.n_accepted += u64::from(outcome.is_accepted);
    if totals.outcomes.insert(outcome.label) && seeds.len() < MAX_SEEDS {
        seeds.push(case);
    }
}

/// Finds the case of a batch that exceeds the memory limit.
fn find_memory_failure(target: &Target, batch: Vec<Input>, totals: &mut Totals, failures: &Path) {
    for case in batch {
        let memory = watch::reset_peak();
        let _ = (target.read)(&case); // its outcome has been recorded
        let growth = watch::growth_kib(memory);
        if growth > MAX_GROWTH_KIB {
            return save_failure(&case, &format!("the case took {} MiB", growth >> 10), totals, failures);
        }
    }
}

/// Saves the input of a failed case and reports it.
fn save_failure(case: &Input, fault: &str, totals: &mut Totals, failures: &Path) {
    totals.n_failed += 1;
    match case.write(failures) {
        Ok(path) => println!("FAILED {fault}: {}", path.display()),
        Err(error) => println!("FAILED {fault}; the input could not be saved: {error}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every seed of the corpus in the repository, and 300 damaged cases per reader.
    #[test]
    fn corpus_has_no_failures() {
        for target in TARGETS {
            let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("checks/fuzz");
            let failures = tempfile::tempdir().unwrap();
            let args = Args {
                target: target.name.to_owned(),
                seconds: 600,
                cases: 300,
                seed: 1,
                corpus,
                failures: failures.path().to_owned(),
            };
            run(&args).unwrap();
        }
    }

    #[test]
    fn reports_panics() {
        let failures = tempfile::tempdir().unwrap();
        let target = Target { read: |_| panic!("deliberate"), ..TARGETS[0] };
        let mut totals = Totals::default();
        let watch = Watch::start(failures.path());
        try_case(&target, Input::file(b"x".to_vec()), &mut Vec::new(), &watch, &mut totals, failures.path());
        assert_eq!((totals.n_failed, totals.n_cases), (1, 1));
        assert_eq!(std::fs::read_dir(failures.path()).unwrap().count(), 1);
    }
}
