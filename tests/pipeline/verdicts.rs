//! Weak recordings with normal detections: the verdict names the problem and the camera or person.

use super::solved;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use wandless::pipeline::{Options, reconstruct};
use wandless::progress::Progress;
use wandless::session::reconstruction::{Quality, Verdict};
use wandless::session::{Keypoint, Session};
use wandless::simulation::{Preset, SimulationConfig, Tracks, simulate};

fn paper(people: usize, views: usize, frames: usize) -> SimulationConfig {
    SimulationConfig { people, views, frames, tracks: Tracks::None, ..SimulationConfig::preset(Preset::Paper) }
}

fn judged(session: &Session) -> Quality {
    reconstruct(session, &Options::default(), &Progress::silent()).unwrap().report.quality
}

/// Present keypoints of a session.
fn keypoints(session: &mut Session) -> impl Iterator<Item = &mut Keypoint> {
    let detections = session.views.iter_mut().flat_map(|view| view.frames.iter_mut().flatten());
    detections.flat_map(|detection| &mut detection.keypoints).filter(|keypoint| keypoint.is_present())
}

fn has_reason(quality: &Quality, words: &[&str]) -> bool {
    quality.reasons.iter().any(|reason| words.iter().all(|word| reason.contains(word)))
}

#[test]
fn two_cameras_face_to_face_get_advice() {
    let (simulated, found) = solved(&paper(2, 2, 200));
    let quality = &found.report.quality;
    assert_ne!(quality.verdict, Verdict::Pass);
    let [a, b] = [0, 1].map(|view| simulated.session.views[view].id.as_str());
    assert!(has_reason(quality, &["weak geometry", a, b, "looks across"]), "{:?}", quality.reasons);
}

#[test]
fn a_static_person_gets_advice() {
    let mut session = simulate(&paper(1, 4, 150)).unwrap().session;
    for view in &mut session.views {
        let first = view.frames.iter().find(|people| !people.is_empty()).unwrap().clone();
        view.frames.fill(first);
    }
    let noise = Normal::new(0.0, 4.0).unwrap(); // px, as the simulated detector
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for keypoint in keypoints(&mut session) {
        keypoint.pixel.iter_mut().for_each(|x| *x += noise.sample(&mut rng));
    }
    let quality = judged(&session);
    assert_ne!(quality.verdict, Verdict::Pass);
    assert!(has_reason(&quality, &["of one place", "walk through the volume"]), "{:?}", quality.reasons);
}

#[test]
fn a_recording_of_one_second_is_too_short() {
    let quality = judged(&simulate(&paper(1, 4, 30)).unwrap().session);
    assert_ne!(quality.verdict, Verdict::Pass);
    assert!(has_reason(&quality, &["short recording", "record longer"]), "{:?}", quality.reasons);
}

#[test]
fn names_a_camera_that_was_moved() {
    // 0.12 m at 4 m shows in the error; at 0.25 m no known person is found in the camera.
    for shift_px in [30.0, 60.0] {
        let mut session = simulate(&paper(2, 5, 200)).unwrap().session;
        let later = session.views[2].frames[100..].iter_mut().flatten();
        later.flat_map(|d| &mut d.keypoints).filter(|k| k.is_present()).for_each(|k| k.pixel.x += shift_px);
        let quality = judged(&session);
        let id = format!("camera {} ", session.views[2].id);
        assert!(has_reason(&quality, &[&id, "moved during the recording"]), "{shift_px} px: {:?}", quality.reasons);
        let named = quality.reasons.iter().filter(|reason| reason.contains("moved during")).count();
        assert_eq!(named, 1, "{:?}", quality.reasons);
    }
}

#[test]
fn easy_recordings_pass_without_reasons() {
    let config = SimulationConfig { frames: 150, tracks: Tracks::None, ..SimulationConfig::preset(Preset::Easy) };
    let (_, found) = solved(&config);
    assert_eq!(found.report.quality, Quality { verdict: Verdict::Pass, reasons: Vec::new() });
    for person in &found.report.people {
        let sigma = person.sigma_mm.unwrap();
        assert!(sigma.median < 20.0 && sigma.p95 >= sigma.median, "{sigma:?}");
        assert!(person.keypoints.iter().all(|k| k.n_observations > 0 && k.reprojection_mm.is_some()));
    }
}
