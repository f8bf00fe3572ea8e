//! Fuzzing: every reader of foreign bytes on inputs that are made from valid ones by seeded random damage.
//!
//! `cargo test --release --test fuzz` runs every seed of `checks/fuzz` and 300 damaged cases per reader. The long form runs one
//! reader: `FUZZ_TARGET=poses FUZZ_SECONDS=600 FUZZ_SEED=1 cargo test --release --test fuzz -- --ignored --nocapture`.
//!
//! A case with a new outcome becomes a seed itself, so that damage accumulates on inputs that get far. The same seed, corpus
//! and number of cases give the same cases. A panic, an accepted invalid value, a slow case or excessive memory is a
//! failure: the case is saved in `fuzz-failures` and reported. After the fix it becomes a seed.
//!
//! Why not cargo-fuzz: it needs a nightly compiler, and damage to words and numbers reaches the readers of text formats. The
//! error codes of rejected inputs replace most of the feedback that instrumentation would give.

#![allow(clippy::unwrap_used)] // a test may

mod corpus;
mod damage;
mod targets;
mod watch;

use corpus::{Input, read_seeds};
use damage::damaged;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;
use std::path::Path;
use std::time::{Duration, Instant};
use targets::{TARGETS, Target};
use watch::Watch;

/// One run of a reader.
struct Run<'a> {
    target: &'a Target,
    duration: Duration,
    /// Maximum number of cases; 0 means unlimited.
    cases: u64,
    /// Seed of the damage.
    seed: u64,
    /// Folder for the inputs of failed cases.
    failures: &'a Path,
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

/// Runs one reader, prints the totals and panics if a case failed.
fn run(run: &Run) {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("checks/fuzz");
    let mut seeds: Vec<Input> =
        read_seeds(&corpus.join(run.target.seeds)).into_iter().map(run.target.prepare).collect();
    let totals = fuzz(run, &mut seeds);
    println!(
        "{} ({}): {} cases, {} accepted, {} kinds of outcome, {} failed, longest case {:.0} ms, memory +{} MiB",
        run.target.name,
        run.target.description,
        totals.n_cases,
        totals.n_accepted,
        totals.outcomes.len(),
        totals.n_failed,
        totals.longest.as_secs_f64() * 1e3,
        totals.largest_kib >> 10,
    );
    assert_eq!(totals.n_failed, 0, "failed cases were saved in {}", run.failures.display());
}

fn fuzz(run: &Run, seeds: &mut Vec<Input>) -> Totals {
    let (target, failures) = (run.target, run.failures);
    let mut rng = ChaCha8Rng::seed_from_u64(run.seed);
    let mut totals = Totals::default();
    let watch = Watch::start(failures);
    let n_valid = seeds.len();
    for seed in seeds.clone() {
        try_case(target, seed, seeds, &watch, &mut totals, failures);
    }
    let end = Instant::now() + run.duration;
    while Instant::now() < end && (run.cases == 0 || totals.n_cases < run.cases) {
        let memory = watch::reset_peak();
        let mut batch = Vec::with_capacity(BATCH);
        for _ in 0..BATCH {
            // Half of the cases start from a valid input, because inputs that were damaged repeatedly seldom get far.
            let pool = if rng.random() { &seeds[..n_valid] } else { &seeds[..] };
            let seed = pool.choose(&mut rng).expect("a folder without seeds is rejected").clone();
            let case = damaged(seed, seeds, MAX_BYTES, &mut rng);
            batch.push(case.clone());
            try_case(target, case, seeds, &watch, &mut totals, failures);
        }
        let growth = watch::growth_kib(memory);
        totals.largest_kib = totals.largest_kib.max(growth);
        if growth > MAX_GROWTH_KIB {
            find_memory_failure(target, batch, &mut totals, failures);
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

/// Every seed of the corpus in the repository, and 300 damaged cases per reader.
#[test]
fn corpus_has_no_failures() {
    let failures = tempfile::tempdir().unwrap();
    for target in TARGETS {
        run(&Run { target, duration: Duration::from_secs(600), cases: 300, seed: 1, failures: failures.path() });
    }
}

/// The long form, on the reader that `FUZZ_TARGET` names.
#[test]
#[ignore = "runs for FUZZ_SECONDS; see the head of this file"]
fn one_reader_has_no_failures() {
    let setting = |name: &str, default: &str| std::env::var(name).unwrap_or_else(|_| default.to_owned());
    let name = setting("FUZZ_TARGET", "");
    let names: Vec<&str> = TARGETS.iter().map(|target| target.name).collect();
    let target = TARGETS.iter().find(|target| target.name == name);
    let target = target.unwrap_or_else(|| panic!("FUZZ_TARGET={name:?}: no such reader; one of {names:?}"));
    let number = |name: &str, default: &str| setting(name, default).parse().unwrap();
    let duration = Duration::from_secs(number("FUZZ_SECONDS", "60"));
    let failures = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz-failures");
    run(&Run { target, duration, cases: 0, seed: number("FUZZ_SEED", "0"), failures: &failures });
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
