//! Detections and track numbers of one camera over the whole session.

use super::config::SimulationConfig;
use super::ghosts::Ghosts;
use super::hands::{DetailDetector, SeenHands};
use super::merged_limbs::LimbMerging;
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
    let mut observers: Vec<Observer> = (0..config.people).map(|person| Observer::new(view, person, config)).collect();
    let mut real =
        config.noise.real.map(|real| (LimbMerging::new(real, view, config), Ghosts::new(real, view, config)));
    let mut details = DetailDetector::new(view, config);
    for frame in 0..scene.joints.len() {
        recording.tally.swaps += usize::from(tracker.step());
        let (mut people, mut detections) = (Vec::new(), Vec::new());
        for (person, observer) in observers.iter_mut().enumerate() {
            let mut seen_as = observer.observe(scene, frame, camera, &mut recording.tally);
            if let Some(details) = &mut details {
                details.observe(scene, frame, person, camera, seen_as.as_mut());
            }
            if let Some(keypoints) = seen_as.filter(|_| scene.exists[frame]) {
                people.push(Some(person));
                detections.push(Detection { track_id: tracker.track_id(person), keypoints });
            }
        }
        if let Some((merging, ghosts)) = &mut real {
            recording.tally.merged_limbs += merging.merge(&mut detections);
            if let Some(ghost) = ghosts.observe(scene, camera).filter(|_| scene.exists[frame]) {
                people.push(None);
                detections.push(Detection { track_id: tracker.ghost_id(ghost.index), keypoints: ghost.keypoints });
                recording.tally.ghosts += 1;
            }
        }
        let hands = match &mut details {
            Some(details) => details.swap(&people, &mut detections),
            None => vec![SeenHands::default(); detections.len()],
        };
        let mut seen: Vec<((Option<usize>, SeenHands), Detection)> =
            people.into_iter().zip(hands).zip(detections).collect();
        seen.shuffle(tracker.rng());
        let (sources, detections): (Vec<_>, Vec<_>) = seen.into_iter().unzip();
        let (identities, hands) = sources.into_iter().unzip();
        if details.is_some() {
            recording.hands.push(hands);
        }
        recording.identities.push(identities);
        recording.frames.push(detections);
    }
    recording
}
