//! Seeded scenes with exact truth and named noise: tests, demo, benchmarks.
//!
//! In reading order:
//!
//! - [`config`], [`presets`]: what is simulated: people, cameras, noise
//! - [`skeleton`]: the simulated body, deliberately not the one that is fitted
//! - `individual`: default bodies with joints of their own, and a detector with habits
//! - [`choreography`], [`gait`]: people who walk, stop, turn, crouch, sit, reach and gesture
//! - `dance`: two people within arms' reach
//! - [`placement`]: people from motion capture (AMASS layout) or drawn from the motion prior, put on the floor
//! - [`landmarks`]: the points a detector looks for, from a posed skeleton
//! - [`rig`]: cameras around the scene
//! - [`occlusion`], [`detector`]: what each camera's detector and tracker report
//! - [`truth`]: what really was, and its files
//!
//! World: y up, metres, floor at y = 0. Every random number comes from a ChaCha8 stream keyed by the seed and by the
//! item it belongs to (camera, person), so that one more camera changes nothing of the others.

pub mod choreography;
pub mod config;
mod dance;
pub mod detector;
mod drawn;
pub mod gait;
mod individual;
pub mod landmarks;
mod mover;
mod observer;
pub mod occlusion;
pub mod placement;
pub mod presets;
mod random;
pub mod rig;
pub mod skeleton;
mod tracker;
pub mod truth;

pub use config::{Arrangement, Bodies, Lens, MotionSource, NoiseConfig, RigConfig, SimulationConfig, Tracks};
pub use presets::{Preset, random_rig_config};
pub use truth::{Simulated, Statistics, Truth, write_truth};

use crate::body::skeleton::KeypointConvention;
use crate::motion_prior::motion_file::MotionProblem;
use crate::session::{Session, View};
use detector::{Scene, ViewRecording};
use rig::RigCamera;
use skeleton::Person;
use std::path::PathBuf;

/// Why a scene cannot be simulated.
#[derive(Debug, thiserror::Error)]
pub enum SimulationError {
    /// A number of the configuration is out of its range.
    #[error("{field}: {expected} expected, found {value}")]
    Config {
        /// Name of the field.
        field: &'static str,
        /// What it held.
        value: f64,
        /// Its range.
        expected: &'static str,
    },
    /// The skeleton has no rule for a keypoint of the convention.
    #[error("{}: no rule for keypoint {keypoint}", convention.name())]
    UnknownKeypoint {
        /// The convention.
        convention: KeypointConvention,
        /// The keypoint's name.
        keypoint: &'static str,
    },
    /// There are fewer motion files than people.
    #[error("{people} people need as many motion files, found {files}")]
    TooFewMotions {
        /// People asked for.
        people: usize,
        /// Files given.
        files: usize,
    },
    /// A motion file cannot be read.
    #[error("{}: {problem}", path.display())]
    Motion {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: MotionProblem,
    },
}

/// Simulates a session and keeps its truth.
///
/// # Errors
/// [`SimulationError`] when the configuration is out of range or a motion file cannot be read.
pub fn simulate(config: &SimulationConfig) -> Result<Simulated, SimulationError> {
    config.check()?;
    let people = people_in_motion(config)?;
    let scene = Scene::new(&people, config)?;
    let cameras = rig::cameras(&config.rig, config.views, config.seed);
    let recordings: Vec<ViewRecording> =
        (0..cameras.len()).map(|view| detector::record(&scene, view, &cameras[view], config)).collect();
    let statistics = truth::statistics(config, &scene, &recordings, &people);
    let identities = recordings.iter().map(|r| r.identities.clone()).collect();
    let truth = Truth {
        cameras: cameras.iter().map(|c| c.camera_from_world).collect(),
        joints: scene.joints,
        keypoints: scene.keypoints,
        identities,
        people,
        statistics,
    };
    Ok(Simulated { session: session(config, truth.joints.len(), cameras, recordings), truth, config: config.clone() })
}

fn people_in_motion(config: &SimulationConfig) -> Result<Vec<Person>, SimulationError> {
    match &config.motion {
        MotionSource::Procedural => Ok(choreography::procedural_people(config)),
        MotionSource::Dance => Ok(dance::dancing_people(config)),
        MotionSource::Prior => Ok(placement::people_from_prior(config)),
        MotionSource::Files(paths) => placement::people_from_files(paths, config),
    }
}

fn session(
    config: &SimulationConfig,
    n_frames: usize,
    cameras: Vec<RigCamera>,
    recordings: Vec<ViewRecording>,
) -> Session {
    let view = |(camera, recording): (RigCamera, ViewRecording)| View {
        id: camera.id,
        intrinsics: camera.intrinsics,
        camera_from_world: None,
        time_offset: 0.0,
        delivered: (0..n_frames).map(crate::session::FrameIndex).collect(),
        frames: recording.frames,
    };
    Session {
        name: format!("simulated-{}", config.seed),
        fps: config.fps,
        first_frame: 0,
        n_frames,
        convention: config.convention,
        up_axis: None,
        start_timecode: None,
        views: cameras.into_iter().zip(recordings).map(view).collect(),
    }
}

#[cfg(test)]
mod tests;
