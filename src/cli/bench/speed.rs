//! `wandless bench speed`: seconds per stage on one session. Kernels are timed in `benches/`.

use crate::cli::bad_input::BadInput;
use crate::cli::solve::use_threads;
use crate::pipeline::{Options, PipelineError, reconstruct};
use crate::progress::{Progress, ProgressEvent};
use crate::session::upload::{UploadLimits, read_path};
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Instant;

/// Arguments of `bench speed`.
#[derive(Debug, clap::Args)]
pub(super) struct SpeedArgs {
    /// Session: a folder, a zip file or a JSON document
    session: PathBuf,
    /// Number of solver threads; 0 uses all cores
    #[arg(long, default_value_t = 0)]
    threads: usize,
}

/// Solves the session once and prints the time of every stage.
pub(super) fn run(args: &SpeedArgs) -> anyhow::Result<()> {
    use_threads(args.threads);
    let started = Instant::now();
    let loaded = read_path(&args.session, &UploadLimits::default()).map_err(|e| BadInput(e.to_string()))?;
    print_seconds("read", started, Instant::now());
    let starts: Arc<Mutex<Vec<(&'static str, Instant)>>> = Arc::default();
    let recorded = starts.clone();
    let record = move |event: &ProgressEvent| {
        let Ok(mut starts) = recorded.lock() else { return };
        if starts.last().is_none_or(|(stage, _)| *stage != event.stage) {
            starts.push((event.stage, Instant::now()));
        }
    };
    let started = Instant::now();
    let result = reconstruct(&loaded.session, &Options::default(), &Progress::new(record, Arc::default()));
    let ended = Instant::now();
    let result = match result {
        Ok(result) => result,
        Err(PipelineError::Option { option, reason }) => return Err(BadInput(format!("{option}: {reason}")).into()),
        Err(error) => return Err(error.into()),
    };
    let starts = starts.lock().map(|starts| starts.clone()).unwrap_or_default();
    for (i, (stage, start)) in starts.iter().enumerate() {
        print_seconds(stage, *start, starts.get(i + 1).map_or(ended, |next| next.1));
    }
    print_seconds("total", started, ended);
    let (frames, views, people) = (loaded.session.n_frames, loaded.session.views.len(), result.motions.len());
    let n_threads = rayon::current_num_threads();
    println!(
        "{frames} frames x {views} views x {people} people on {n_threads} threads: {:.0} per second and core",
        (frames * views * people) as f64 / (ended - started).as_secs_f64() / n_threads as f64
    );
    Ok(())
}

fn print_seconds(name: &str, start: Instant, end: Instant) {
    println!("{name:<20} {:8.3} s", (end - start).as_secs_f64());
}
