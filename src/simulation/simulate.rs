//! Simulates a session and its truth from a configuration.

use super::config::{MotionSource, SimulationConfig};
use super::detector::record;
use super::error::SimulationError;
use super::hands::{has_details, turn_wrists};
use super::rig::{self, RigCamera};
use super::scene::{SimulatedScene, ViewRecording};
use super::skeleton::SimulatedPerson;
use super::truth::{self, Simulated, Truth};
use super::{choreography, dance, placement, running};
use crate::session::{Session, View};

/// Simulates a session and its truth.
///
/// # Errors
/// [`SimulationError`] when the configuration is out of range or a motion file cannot be read.
pub fn simulate(config: &SimulationConfig) -> Result<Simulated, SimulationError> {
    config.check()?;
    let people = simulated_people(config)?;
    let scene = SimulatedScene::new(&people, config)?;
    let cameras = rig::cameras(&config.rig, config.views, config.seed);
    let recordings: Vec<ViewRecording> =
        (0..cameras.len()).map(|view| record(&scene, view, &cameras[view], config)).collect();
    let statistics = truth::statistics(config, &scene, &recordings, &people);
    let identities = recordings.iter().map(|r| r.identities.clone()).collect();
    let hands = recordings.iter().map(|r| r.hands.clone()).collect();
    let truth = Truth {
        cameras: cameras.iter().map(|c| c.camera_from_world).collect(),
        joints: scene.joints,
        keypoints: scene.keypoints,
        details: scene.details,
        hands,
        identities,
        people,
        statistics,
    };
    Ok(Simulated { session: session(config, truth.joints.len(), cameras, recordings), truth, config: config.clone() })
}

fn simulated_people(config: &SimulationConfig) -> Result<Vec<SimulatedPerson>, SimulationError> {
    let mut people = match &config.motion {
        MotionSource::Procedural => Ok(choreography::procedural_people(config)),
        MotionSource::Dance => Ok(dance::dancing_people(config)),
        MotionSource::Running { speed } => Ok(running::running_people(config, *speed)),
        MotionSource::Prior => Ok(placement::people_from_prior(config)),
        MotionSource::Files(paths) => placement::people_from_files(paths, config),
    }?;
    if has_details(config.convention) {
        people.iter_mut().enumerate().for_each(|(i, person)| turn_wrists(&mut person.poses, config, i));
    }
    Ok(people)
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
        has_intrinsics: true,
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
        dense: config.dense.clone(),
        up_axis: None,
        start_timecode: None,
        views: cameras.into_iter().zip(recordings).map(view).collect(),
    }
}
