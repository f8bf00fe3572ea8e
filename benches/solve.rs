//! Whole solves and their stages on a simulated session: 3 people, 5 cameras, 4 seconds.
//!
//! `cargo bench --bench solve` prints the time of a whole solve, with estimated and with given cameras, and of each stage.

use divan::Bencher;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use wandless::pipeline::config::Extrinsics;
use wandless::prelude::*;
use wandless::simulation::{Preset, SimulationConfig, simulate};

/// Number of measured solves per benchmark.
const SAMPLES: u32 = 3;

fn main() {
    if std::env::args().any(|argument| argument == "--bench") {
        print_stages();
    }
    divan::main();
}

fn session(extrinsics: Extrinsics) -> Session {
    let config = SimulationConfig { people: 3, views: 5, frames: 120, ..SimulationConfig::preset(Preset::Paper) };
    let simulated = simulate(&config).expect("the configuration is valid");
    let mut session = simulated.session;
    if extrinsics == Extrinsics::Fixed {
        for (view, camera) in session.views.iter_mut().zip(&simulated.truth.cameras) {
            view.camera_from_world = Some(*camera);
        }
    }
    session
}

/// From detections to the reconstruction, on all cores.
#[divan::bench(args = [Extrinsics::Estimate, Extrinsics::Fixed], sample_count = SAMPLES, sample_size = 1)]
fn end_to_end(bencher: Bencher, extrinsics: Extrinsics) {
    let (session, options) = (session(extrinsics), Options { extrinsics, ..Options::default() });
    bencher.bench_local(|| reconstruct(&session, &options, &Progress::silent()).expect("the session can be solved"));
}

/// Prints the mean seconds of every stage of a solve with estimated cameras.
fn print_stages() {
    let session = session(Extrinsics::Estimate);
    let seconds: Arc<Mutex<BTreeMap<(usize, &'static str), Duration>>> = Arc::default();
    for _ in 0..SAMPLES {
        let (total, last) = (seconds.clone(), Mutex::new(None::<((usize, &'static str), Instant)>));
        let record = move |event: &ProgressEvent| {
            let mut last = last.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some((stage, since)) = *last {
                *total.lock().unwrap_or_else(PoisonError::into_inner).entry(stage).or_default() += since.elapsed();
            }
            *last = Some(((event.stage_index, event.stage), Instant::now()));
        };
        reconstruct(&session, &Options::default(), &Progress::new(record, Arc::default())).expect("it can be solved");
    }
    for ((_, stage), total) in seconds.lock().unwrap_or_else(PoisonError::into_inner).iter() {
        println!("stage {stage:<20} {:8.3} s", total.as_secs_f64() / f64::from(SAMPLES));
    }
}
