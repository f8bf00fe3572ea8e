//! `wandless bench`: how often cameras are found on random rigs, how fast a capture is solved, what damaged input does.

mod ablation;
mod bodies;
mod fuzz;
mod kinematics;
mod markers;
mod rigs;
mod table;

use super::BadInput;
use super::solve::use_threads;
use crate::geometry::Rigid;
use crate::pipeline::{Options, PipelineError, reconstruct};
use crate::progress::{Progress, ProgressEvent};
use crate::session::Reconstruction;
use crate::session::upload::{UploadLimits, read_path};
use kinematics::poses_a_second;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Instant;

/// Arguments of `bench`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(subcommand)]
    bench: Bench,
}

#[derive(Debug, clap::Subcommand)]
enum Bench {
    /// Cameras from nothing on random simulated rigs: the share in which every pair of cameras is right
    Rigs {
        /// How many rigs
        #[arg(long, default_value_t = 200)]
        count: u64,
        /// Seed of the first rig; the others follow
        #[arg(long, default_value_t = 0)]
        seed: u64,
        /// A rig fails when some pair of cameras is off by more than this, degrees
        #[arg(long, default_value_t = 5.0)]
        limit_deg: f64,
        /// Solver threads; 0 takes all cores
        #[arg(long, default_value_t = 0)]
        threads: usize,
    },
    /// Bodies, joint angles and metric scale on captures of people who are default bodies
    Bodies(bodies::BodiesArgs),
    /// What each part of the method is worth on sessions with truth: a table as Markdown and as JSON
    Ablation(ablation::AblationArgs),
    /// Markers on the true and the fitted skin of two people who dance, with 1 to 12 cameras: a table as Markdown and as JSON
    Markers(markers::MarkersArgs),
    /// Seconds per stage on one session, frames x views x people a second and core, and the rates of fit and kinematics
    Speed {
        /// Session: a folder, a zip or a JSON document
        session: PathBuf,
        /// Solver threads; 0 takes all cores
        #[arg(long, default_value_t = 0)]
        threads: usize,
    },
    /// Damaged input of one kind for some time: panics, hangs, memory, and what should not have been accepted
    Fuzz(fuzz::Args),
}

/// Runs the command.
pub(super) fn run(args: Args) -> anyhow::Result<()> {
    match args.bench {
        Bench::Rigs { count, seed, limit_deg, threads } => {
            use_threads(threads);
            rigs::run(seed..seed + count, limit_deg)
        }
        Bench::Bodies(args) => {
            use_threads(args.threads);
            bodies::run(&args)
        }
        Bench::Ablation(args) => ablation::run(&args),
        Bench::Markers(args) => markers::run(&args),
        Bench::Speed { session, threads } => {
            use_threads(threads);
            speed(session)
        }
        Bench::Fuzz(args) => fuzz::run(&args),
    }
}

fn speed(session: PathBuf) -> anyhow::Result<()> {
    let started = Instant::now();
    let loaded = read_path(&session, &UploadLimits::default()).map_err(|e| BadInput(e.to_string()))?;
    println!("{:<20} {:8.3} s", "read", started.elapsed().as_secs_f64());
    let marks: Arc<Mutex<Vec<(&'static str, Instant)>>> = Arc::default();
    let heard = marks.clone();
    let listen = move |event: &ProgressEvent| {
        let Ok(mut marks) = heard.lock() else { return };
        if marks.last().is_none_or(|(stage, _)| *stage != event.stage) {
            marks.push((event.stage, Instant::now()));
        }
    };
    let begun = Instant::now();
    let result = reconstruct(&loaded.session, &Options::default(), &Progress::new(listen, Arc::default()));
    let ended = Instant::now();
    let found = match result {
        Ok(found) => found,
        Err(PipelineError::Option { option, reason }) => return Err(BadInput(format!("{option}: {reason}")).into()),
        Err(error) => return Err(error.into()),
    };
    let marks = marks.lock().map(|m| m.clone()).unwrap_or_default();
    let mut fit_seconds = 0.0;
    for (i, (stage, from)) in marks.iter().enumerate() {
        let until = marks.get(i + 1).map_or(ended, |next| next.1);
        println!("{stage:<20} {:8.3} s", (until - *from).as_secs_f64());
        if *stage == "body_fit" {
            fit_seconds += (until - *from).as_secs_f64();
        }
    }
    let seconds = (ended - begun).as_secs_f64();
    let cores = rayon::current_num_threads();
    let work = loaded.session.n_frames * loaded.session.views.len() * found.motions.len();
    println!("{:<20} {seconds:8.3} s", "whole solve");
    println!(
        "{} frames x {} views x {} people on {cores} threads: {:.0} a second and core",
        loaded.session.n_frames,
        loaded.session.views.len(),
        found.motions.len(),
        work as f64 / seconds / cores as f64
    );
    let fitted: usize = found.motions.iter().map(|motion| motion.frames.len()).sum();
    println!("body fit: {:.0} person-frames a second and core", fitted as f64 / fit_seconds / cores as f64);
    println!("kinematics with 26 landmarks and derivatives: {:.0} poses a second and core", poses_a_second());
    Ok(())
}

/// The cameras that were found, and the true ones of the same views; `camera_from_world`.
fn paired_cameras(found: &Reconstruction, truth: &[Rigid]) -> (Vec<Rigid>, Vec<Rigid>) {
    let pairs = found.cameras.iter().zip(truth);
    pairs.filter_map(|(solved, truth)| Some((solved.camera_from_world?, *truth))).unzip()
}
