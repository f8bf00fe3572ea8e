//! Reconstructs a session from disk and prints its cameras and people.
//!
//! `cargo run --release --example from_folder -- SESSION`, where SESSION is a folder, a zip or a JSON document. Without
//! arguments the example simulates a small session first.

use std::error::Error;
use std::path::{Path, PathBuf};
use wandless::prelude::*;
use wandless::session::formats::native::write_folder;
use wandless::simulation::{Preset, SimulationConfig, simulate};

fn main() -> Result<(), Box<dyn Error>> {
    let temporary = tempfile::tempdir()?;
    let folder = match std::env::args_os().nth(1) {
        Some(session) => PathBuf::from(session),
        None => simulated_session(temporary.path())?,
    };
    let loaded = read_path(&folder, &UploadLimits::default())?;
    for warning in &loaded.warnings {
        eprintln!("warning: {warning}");
    }

    let show = |event: &ProgressEvent| eprintln!("{:3.0} % {} {}", 100.0 * event.fraction, event.stage, event.message);
    let progress = Progress::new(show, Default::default());
    let result = reconstruct(&loaded.session, &Options::default(), &progress)?;

    println!("verdict {:?} {:?}", result.report.quality.verdict, result.report.quality.reasons);
    for (view, camera) in loaded.session.views.iter().zip(&result.cameras) {
        match camera.camera_from_world {
            Some(pose) => println!("camera {}: centre {:.3?} m", view.id, pose.center().as_slice()),
            None => println!("camera {}: not solved", view.id),
        }
    }
    for motion in &result.motions {
        let (first, n_frames) = (loaded.session.frame_number(motion.first), motion.frames.len());
        let pelvis = motion.frames[0].joints[0];
        println!("person {}: frames {first} to {}", motion.person.0, first + n_frames as i64 - 1);
        println!("  pelvis in the first frame {:.3?} m, shape {:.2?}", pelvis.as_slice(), motion.betas);
    }
    Ok(())
}

fn simulated_session(folder: &Path) -> Result<PathBuf, Box<dyn Error>> {
    let config = SimulationConfig { people: 2, views: 3, frames: 60, ..SimulationConfig::preset(Preset::Easy) };
    write_folder(&simulate(&config)?.session, folder)?;
    Ok(folder.to_owned())
}
