//! Detections and track numbers of one camera over the whole session.

use super::config::SimulationConfig;
use super::observer::Observer;
use super::rig::RigCamera;
use super::scene::{SimulatedScene, ViewRecording};
use super::tracker::SimulatedTracker;
use crate::session::Detection;
use rand::seq::SliceRandom;

/// A camera's recording. Every person has a separate random stream in every view.
pub fn record(scene: &SimulatedScene, view: usize, camera: &RigCamera, config: &SimulationConfig) -> ViewRecording {
    let offset = config.time_offsets.get(view).copied().unwrap_or(0.0);
    let shifted = (offset != 0.0).then(|| scene.at_offset(offset));
    let scene = shifted.as_ref().unwrap_or(scene);
    let mut recording = ViewRecording::default();
    let mut tracker = SimulatedTracker::new(view, config);
    let mut observers: Vec<Observer> =
        (0..config.people).map(|person| Observer::new(scene, view, person, config)).collect();
    for frame in 0..scene.joints.len() {
        recording.tally.swaps += usize::from(tracker.step());
        let mut seen: Vec<(usize, Detection)> = Vec::with_capacity(config.people);
        for (person, observer) in observers.iter_mut().enumerate() {
            let seen_as = observer.observe(scene, frame, camera, &mut recording.tally);
            if let Some(keypoints) = seen_as.filter(|_| scene.exists[frame]) {
                seen.push((person, Detection { track_id: tracker.track_id(person), keypoints }));
            }
        }
        seen.shuffle(tracker.rng());
        let (identities, detections) = seen.into_iter().unzip();
        recording.identities.push(identities);
        recording.frames.push(detections);
    }
    recording
}
