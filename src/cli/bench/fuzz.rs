//! `wandless bench fuzz`: a reader under inputs that nobody would send, made out of valid ones by seeded damage.
//!
//! A case that leads to an outcome not met before becomes a seed itself, so that damage is heaped upon what got far. The
//! same seed, corpus and number of cases make the same cases. A panic, a wrong value let through, a slow case or one that
//! takes much memory is written down, told, and makes the command fail.
//!
//! Why not cargo-fuzz: it wants another compiler; readers of text dialects are reached by damage to their words and
//! numbers, and what instrumentation would add is mostly told by the code of the refusal.

mod corpus;
mod damage;
mod targets;
mod watch;

use crate::cli::BadInput;
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
    /// What is fuzzed; `list` names all
    #[arg(long)]
    target: String,
    /// How long
    #[arg(long, default_value_t = 60)]
    seconds: u64,
    /// Ends after so many cases; 0 is without end
    #[arg(long, default_value_t = 0)]
    cases: u64,
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Folder of seeds, one folder below it for each kind
    #[arg(long, default_value = "checks/fuzz")]
    corpus: PathBuf,
    /// Where cases that found something are written
    #[arg(long, default_value = "fuzz-found")]
    found: PathBuf,
}

/// A case may take no longer; one that does is run again by the processor's clock, for a busy machine is nobody's fault.
const MAX_CASE: Duration = Duration::from_secs(1);

/// Nor more memory than this beyond its input.
const MAX_GROWTH_KIB: u64 = 64 << 10;

/// Cases between two looks at the memory.
const BATCH: usize = 256;

/// Seeds beyond this are not kept.
const MAX_SEEDS: usize = 4000;

/// Longest input: what is larger is more of the same.
const MAX_BYTES: usize = 256 << 10;

/// What has happened so far.
#[derive(Default)]
struct Tally {
    n_cases: u64,
    n_accepted: u64,
    outcomes: BTreeSet<String>,
    n_found: u64,
    longest: Duration,
    largest_kib: u64,
}

/// Runs the command.
pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    if args.target == "list" {
        TARGETS.iter().for_each(|target| println!("{:<16} {}", target.name, target.what));
        return Ok(());
    }
    let target = TARGETS.iter().find(|target| target.name == args.target);
    let target = target.ok_or_else(|| BadInput(format!("--target {}: `list` names all", args.target)))?;
    let mut seeds: Vec<Input> = read_seeds(&args.corpus.join(target.seeds))?.into_iter().map(target.prepare).collect();
    println!("target {}, {} seeds, seed {}", target.name, seeds.len(), args.seed);
    let tally = fuzz(target, &mut seeds, args);
    println!(
        "{} cases, {} accepted, {} kinds of outcome, {} found, longest {:.0} ms, memory +{} MiB",
        tally.n_cases,
        tally.n_accepted,
        tally.outcomes.len(),
        tally.n_found,
        tally.longest.as_secs_f64() * 1e3,
        tally.largest_kib >> 10,
    );
    anyhow::ensure!(tally.n_found == 0, "{} cases are kept in {}", tally.n_found, args.found.display());
    Ok(())
}

fn fuzz(target: &Target, seeds: &mut Vec<Input>, args: &Args) -> Tally {
    let mut rng = ChaCha8Rng::seed_from_u64(args.seed);
    let mut tally = Tally::default();
    let watch = Watch::start(&args.found);
    let n_valid = seeds.len();
    for seed in seeds.clone() {
        try_case(target, seed, seeds, &watch, &mut tally, &args.found);
    }
    let end = Instant::now() + Duration::from_secs(args.seconds);
    while Instant::now() < end && (args.cases == 0 || tally.n_cases < args.cases) {
        let memory = watch::forget_peak();
        let mut batch = Vec::with_capacity(BATCH);
        for _ in 0..BATCH {
            // Half of the cases begin with a valid input: what was damaged over and over seldom gets far.
            let pool = if rng.random() { &seeds[..n_valid] } else { &seeds[..] };
            let seed = pool.choose(&mut rng).expect("a folder without seeds is refused").clone();
            let case = damaged(seed, seeds, MAX_BYTES, &mut rng);
            batch.push(case.clone());
            try_case(target, case, seeds, &watch, &mut tally, &args.found);
        }
        let grown = watch::growth_kib(memory);
        tally.largest_kib = tally.largest_kib.max(grown);
        if grown > MAX_GROWTH_KIB {
            blame(target, batch, &mut tally, &args.found);
        }
    }
    tally
}

/// Runs one case and keeps it as a seed where its outcome is new.
fn try_case(target: &Target, case: Input, seeds: &mut Vec<Input>, watch: &Watch, tally: &mut Tally, found: &Path) {
    let begun = Instant::now();
    let outcome = watch.run(&case, || (target.read)(&case));
    let mut took = begun.elapsed();
    if took > MAX_CASE {
        let begun = (Instant::now(), watch::processor_time());
        let _ = watch.run(&case, || (target.read)(&case)); // the first run's outcome counts
        let worked = begun.1.zip(watch::processor_time()).map(|(before, after)| after.saturating_sub(before));
        took = worked.unwrap_or(begun.0.elapsed());
    }
    tally.n_cases += 1;
    tally.longest = tally.longest.max(took);
    let outcome = match outcome {
        Ok(outcome) if took <= MAX_CASE => outcome,
        Ok(_) => return keep(&case, &format!("it took {:.1} s", took.as_secs_f64()), tally, found),
        Err(fault) => return keep(&case, &fault, tally, found),
    };
    tally.n_accepted += u64::from(outcome.is_accepted);
    if tally.outcomes.insert(outcome.label) && seeds.len() < MAX_SEEDS {
        seeds.push(case);
    }
}

/// Finds the case of a batch that took the memory.
fn blame(target: &Target, batch: Vec<Input>, tally: &mut Tally, found: &Path) {
    for case in batch {
        let memory = watch::forget_peak();
        let _ = (target.read)(&case); // its outcome is known
        let grown = watch::growth_kib(memory);
        if grown > MAX_GROWTH_KIB {
            return keep(&case, &format!("it took {} MiB", grown >> 10), tally, found);
        }
    }
}

fn keep(case: &Input, fault: &str, tally: &mut Tally, found: &Path) {
    tally.n_found += 1;
    match case.write(found) {
        Ok(path) => println!("FOUND {fault}: {}", path.display()),
        Err(error) => println!("FOUND {fault}; it could not be kept: {error}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every seed of the corpus that is checked in, and some damage to each: nothing is found.
    #[test]
    fn the_corpus_finds_nothing() {
        for target in TARGETS {
            let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("checks/fuzz");
            let found = tempfile::tempdir().unwrap();
            let args = Args {
                target: target.name.to_owned(),
                seconds: 600,
                cases: 300,
                seed: 1,
                corpus,
                found: found.path().to_owned(),
            };
            run(&args).unwrap();
        }
    }

    #[test]
    fn what_panics_is_found() {
        let found = tempfile::tempdir().unwrap();
        let target = Target { read: |_| panic!("as planted"), ..TARGETS[0] };
        let mut tally = Tally::default();
        let watch = Watch::start(found.path());
        try_case(&target, Input::file(b"x".to_vec()), &mut Vec::new(), &watch, &mut tally, found.path());
        assert_eq!((tally.n_found, tally.n_cases), (1, 1));
        assert_eq!(std::fs::read_dir(found.path()).unwrap().count(), 1);
    }
}
