//! Cameras adjusted together with the bodies, under the errors of real detectors.

use super::{solved, worst_pair_deg};
use nalgebra::Vector3;
use wandless::geometry::Rigid;
use wandless::pipeline::config::Extrinsics;
use wandless::pipeline::{Options, reconstruct};
use wandless::progress::Progress;
use wandless::session::Reconstruction;
use wandless::session::reconstruction::Verdict;
use wandless::simulation::{Arrangement, Preset, Simulated, SimulationConfig, Tracks, simulate};

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

/// Motions had followed the errors into depth, as if angles between views were wider: people came out 2.6 % too near on average, at twice the
/// stated deviations; 1.1 % are left here. The mean over the seeds errs by 0.5 %.
#[test]
fn people_before_cameras_on_one_side_are_not_too_near() {
    let nearer = |seed: u64| {
        let mut config = SimulationConfig { views: 4, ..realistic(seed) };
        config.rig.arrangement = Arrangement::Arc { span_deg: 50.0 };
        let (simulated, found) = solved(&config);
        assert_ne!(found.report.quality.verdict, Verdict::Reject, "{:?}", found.report.quality.reasons);
        (true_distance(&simulated) / found_distance(&found)).ln()
    };
    let all: Vec<f64> = (1..=6).map(nearer).collect();
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    println!("people nearer than in truth: {all:.4?}, mean {mean:.4}");
    assert!(mean.abs() < 0.018, "{all:?}");
}

fn found_distance(found: &Reconstruction) -> f64 {
    let cameras: Vec<Rigid> = found.cameras.iter().filter_map(|camera| camera.camera_from_world).collect();
    let frames = found.motions.iter().flat_map(|motion| &motion.frames);
    relative_distance(&cameras, &frames.map(|frame| frame.joints[0]).collect::<Vec<_>>())
}

fn true_distance(simulated: &Simulated) -> f64 {
    let people = simulated.truth.joints.iter().flatten();
    relative_distance(&simulated.truth.cameras, &people.map(|joints| joints[0]).collect::<Vec<_>>())
}

/// Mean distance of pelvises from the cameras, in units of the cameras' own spread.
fn relative_distance(cameras: &[Rigid], pelvises: &[Vector3<f64>]) -> f64 {
    let centers: Vec<Vector3<f64>> = cameras.iter().map(Rigid::center).collect();
    let middle = centers.iter().sum::<Vector3<f64>>() / centers.len() as f64;
    let spread = (centers.iter().map(|c| (c - middle).norm_squared()).sum::<f64>() / centers.len() as f64).sqrt();
    let distances = pelvises.iter().flat_map(|pelvis| centers.iter().map(move |center| (pelvis - center).norm()));
    distances.sum::<f64>() / (pelvises.len() * centers.len()) as f64 / spread
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
