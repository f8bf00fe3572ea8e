//! Cameras adjusted together with the bodies, under the errors of real detectors.

use super::{solved, worst_pair_deg};
use wandless::pipeline::config::Extrinsics;
use wandless::pipeline::{Options, reconstruct};
use wandless::progress::Progress;
use wandless::simulation::{Preset, SimulationConfig, Tracks, simulate};

fn realistic(seed: u64) -> SimulationConfig {
    let preset = SimulationConfig::preset(Preset::Paper);
    SimulationConfig { noise: preset.noise.with_real_errors(), seed, frames: 200, tracks: Tracks::None, ..preset }
}

/// Three sessions together, since one may be lucky: the sum falls by a third on larger samples.
#[test]
fn slow_errors_cost_less_with_cameras_and_bodies_together() {
    let (mut together, mut apart) = (0.0, 0.0);
    for seed in 1..=3 {
        let (simulated, found) = solved(&realistic(seed));
        together += worst_pair_deg(&simulated, &found);
        let options = Options { adjust_with_bodies: false, ..Options::default() };
        let found = reconstruct(&simulated.session, &options, &Progress::silent()).unwrap();
        apart += worst_pair_deg(&simulated, &found);
    }
    assert!(together < 0.9 * apart, "{together} degrees together, {apart} apart");
}

/// Bodies take part in the adjustment only where cameras may move.
#[test]
fn fixed_cameras_stay_as_given() {
    let simulated = simulate(&realistic(4)).unwrap();
    let mut session = simulated.session.clone();
    for (view, camera) in session.views.iter_mut().zip(&simulated.truth.cameras) {
        view.camera_from_world = Some(*camera);
    }
    let options = Options { extrinsics: Extrinsics::Fixed, ..Options::default() };
    let found = reconstruct(&session, &options, &Progress::silent()).unwrap();
    for (camera, truth) in found.cameras.iter().zip(&simulated.truth.cameras) {
        assert_eq!(camera.camera_from_world, Some(*truth));
    }
}
