//! People at a run: in the next frame they are elsewhere, and after two seconds gone.

use super::{identity_shares, solved, worst_pair_deg};
use wandless::pipeline::{Options, PipelineError, reconstruct};
use wandless::progress::Progress;
use wandless::simulation::{MotionSource, Preset, SimulationConfig, Tracks, simulate};

fn runners(people: usize, speed: f64, fps: f64) -> SimulationConfig {
    // Through the 12 m that the cameras see.
    let frames = (12.0 / speed * fps) as usize;
    let motion = MotionSource::Running { speed };
    let mut config =
        SimulationConfig { people, views: 4, frames, fps, motion, ..SimulationConfig::preset(Preset::Paper) };
    config.tracks = Tracks::None;
    config.rig.radius = 7.0;
    config
}

/// A person who moves a fifth of a body from frame to frame was lost at every one of them: "no two cameras see the same people
/// move".
#[test]
fn a_sprinter_alone_was_lost_at_every_frame() {
    let (simulated, found) = solved(&runners(1, 8.0, 25.0));
    assert_eq!(found.motions.len(), 1);
    let worst = worst_pair_deg(&simulated, &found);
    assert!(worst < 2.0, "{worst}");
}

#[test]
fn sprinters_who_pass_each_other_keep_their_identities() {
    let (simulated, found) = solved(&runners(2, 7.0, 30.0));
    let (right, given) = identity_shares(&simulated, &found);
    assert!(right > 0.97 && given > 0.9, "{right} {given}");
    let worst = worst_pair_deg(&simulated, &found);
    assert!(worst < 2.0, "{worst}");
}

#[test]
fn cameras_without_common_frames_are_named() {
    let mut session = simulate(&runners(1, 5.0, 25.0)).unwrap().session;
    for (v, view) in session.views.iter_mut().enumerate() {
        view.frames.iter_mut().enumerate().filter(|(f, _)| f / 10 % 4 != v).for_each(|(_, people)| people.clear());
    }
    let failed = reconstruct(&session, &Options::default(), &Progress::silent()).unwrap_err();
    let PipelineError::Unsolvable { code, reason, .. } = failed else { panic!("{failed}") };
    assert_eq!(code, "cameras_unsolvable");
    assert!(reason.contains("in none of 6 camera pairs") && reason.contains("sync: estimate"), "{reason}");
}
