//! Converts the output of a 2D pose detector to an animated glTF file (`.glb`) with cameras and people.
//!
//! `cargo run --release --example detections_to_gltf -- DETECTIONS OUT`. DETECTIONS is a folder with the frame rate, a
//! calibration file and one folder of detections per camera, in the OpenPose format or any other that the README lists.
//! Without arguments the example writes simulated OpenPose output first.

use serde_json::json;
use std::error::Error;
use std::path::{Path, PathBuf};
use wandless::prelude::*;
use wandless::simulation::{Preset, SimulationConfig, simulate};

fn main() -> Result<(), Box<dyn Error>> {
    let temporary = tempfile::tempdir()?;
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let (detections, out) = match (arguments.next(), arguments.next()) {
        (Some(detections), Some(out)) => (detections, out),
        _ => {
            let detections = temporary.path().join("detections");
            write_openpose(&detections)?;
            (detections, temporary.path().join("result"))
        }
    };
    let loaded = read_path(&detections, &UploadLimits::default())?;
    println!("{}: {} cameras, {} frames", loaded.format, loaded.session.views.len(), loaded.session.n_frames);

    let options = Options { exports: vec![ExportFormat::Glb], ..Options::default() };
    let result = reconstruct(&loaded.session, &options, &Progress::silent())?;
    let context = ResultContext {
        input_sha256: &loaded.sha256,
        options: serde_json::to_value(&options)?,
        solver_version: env!("CARGO_PKG_VERSION"),
        exports: &options.exports,
        continuation: None,
    };
    // The session as the result has it: without the keypoints and mistakes that the solve has left out or repaired.
    let session = as_solved(&loaded.session, &options, &result);
    write_result(&out, &session, &context, &result)?;
    let manifest: serde_json::Value = serde_json::from_slice(&std::fs::read(out.join("manifest.json"))?)?;
    for file in manifest["files"].as_array().into_iter().flatten() {
        println!("{} ({} bytes)", out.join(file["name"].as_str().unwrap_or_default()).display(), file["bytes"]);
    }
    Ok(())
}

/// Writes a simulated session as a detector would: per camera and frame one JSON file, and a calibration in TOML.
fn write_openpose(folder: &Path) -> Result<(), Box<dyn Error>> {
    let config = SimulationConfig {
        people: 2,
        views: 3,
        frames: 60,
        convention: KeypointConvention::Body25,
        ..SimulationConfig::preset(Preset::Easy)
    };
    let session = simulate(&config)?.session;
    let mut calibration = String::new();
    for (i, view) in session.views.iter().enumerate() {
        let k = &view.intrinsics;
        calibration += &format!(
            "[cam_{i}]\nname = \"{}\"\nsize = [{:.1}, {:.1}]\nmatrix = [[{:?}, 0.0, {:?}], [0.0, {:?}, {:?}], \
             [0.0, 0.0, 1.0]]\ndistortions = [0.0, 0.0, 0.0, 0.0]\nfisheye = false\n",
            view.id, k.width, k.height, k.fx, k.cx, k.fy, k.cy
        );
        let camera = folder.join(&view.id);
        std::fs::create_dir_all(&camera)?;
        for (frame, people) in view.frames.iter().enumerate() {
            let points = |person: &Detection| -> Vec<f64> {
                person.keypoints.iter().flat_map(|k| [k.pixel.x, k.pixel.y, k.confidence]).collect()
            };
            let people: Vec<_> = people.iter().map(|person| json!({ "pose_keypoints_2d": points(person) })).collect();
            let name = format!("{}_{frame:012}_keypoints.json", view.id);
            std::fs::write(camera.join(name), json!({ "people": people }).to_string())?;
        }
    }
    std::fs::write(folder.join("Calib.toml"), calibration)?;
    std::fs::write(folder.join("session.json"), json!({ "fps": session.fps }).to_string())?;
    Ok(())
}
