//! Reconstructs detections that are already in memory, without any files.
//!
//! `cargo run --release --example in_memory`. A simulation takes the place of the cameras and of the 2D pose detector.

use std::error::Error;
use wandless::prelude::*;
use wandless::simulation::{Preset, SimulationConfig, simulate};

fn main() -> Result<(), Box<dyn Error>> {
    let config = SimulationConfig { people: 2, views: 3, frames: 60, ..SimulationConfig::preset(Preset::Easy) };
    let simulated = simulate(&config)?;

    let mut builder = SessionBuilder::new(config.fps, config.convention).name("in memory");
    for view in &simulated.session.views {
        builder = builder.camera(&view.id, &view.intrinsics, None); // None: the camera pose is unknown
        for (frame, people) in view.frames.iter().enumerate() {
            builder = builder.detections(&view.id, frame as i64, people.clone());
        }
    }
    let session = builder.build()?;

    let result = reconstruct(&session, &Options::default(), &Progress::silent())?;
    for (view, camera) in session.views.iter().zip(&result.cameras) {
        let center = camera.camera_from_world.map(|pose| pose.center());
        println!("camera {}: centre {center:?} m", view.id);
    }
    for motion in &result.motions {
        let head = JOINT_NAMES.iter().position(|name| *name == "head").ok_or("the skeleton has a head")?;
        let heights = motion.frames.iter().map(|frame| frame.joints[head].y); // y is up unless `up_axis` is z
        println!("person {}: head at most {:.2} m high", motion.person.0, heights.fold(f64::MIN, f64::max));
    }
    Ok(())
}
