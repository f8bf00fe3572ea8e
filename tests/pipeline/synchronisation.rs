//! Time offsets between cameras, estimated from the motion.

use wandless::pipeline::camera_clock::CameraClock;
use wandless::pipeline::config::{IntrinsicsMode, Repair, Sync};
use wandless::pipeline::stages::time_offsets::retiming::retimed;
use wandless::pipeline::{Options, reconstruct};
use wandless::progress::Progress;
use wandless::session::{Reconstruction, SuspicionCode as Code};
use wandless::simulation::{Preset, SimulationConfig, simulate};

/// A view's offset, frames.
const OFFSETS: [f64; 4] = [0.0, 11.0, -14.0, 6.3];

fn recording(offsets: [f64; 4]) -> SimulationConfig {
    SimulationConfig {
        views: 4,
        frames: 240,
        seed: 3,
        time_offsets: offsets.to_vec(),
        ..SimulationConfig::preset(Preset::Easy)
    }
}

/// Estimates less true offsets, frames; the mean over all cameras is arbitrary.
fn errors(found: &Reconstruction, offsets: [f64; 4], fps: f64) -> Vec<f64> {
    let estimates = found.cameras.iter().map(|camera| camera.time_offset.unwrap().secs * fps);
    let errors: Vec<f64> = estimates.zip(offsets).map(|(estimate, offset)| estimate - offset).collect();
    let shared = errors.iter().sum::<f64>() / errors.len() as f64;
    errors.into_iter().map(|error| error - shared).collect()
}

/// Offsets of whole and fractional frames.
#[test]
fn offsets_are_accurate_to_a_twentieth_of_a_frame() {
    let config = recording(OFFSETS);
    let simulated = simulate(&config).unwrap();
    let options = Options { sync: Sync::Estimate, ..Options::default() };
    let found = reconstruct(&simulated.session, &options, &Progress::silent()).unwrap();
    for (error, camera) in errors(&found, OFFSETS, config.fps).iter().zip(&found.cameras) {
        assert!(error.abs() < 0.05, "{error}");
        let sigma = camera.time_offset.unwrap().sigma_secs.unwrap();
        assert!(sigma * config.fps < 0.1, "{sigma}");
    }
    // Identities refer to the recorded frames.
    let (mut right, mut n) = (0, 0);
    for (found, true_ones) in found.identities.iter().zip(&simulated.truth.identities) {
        for (found, true_ones) in found.iter().zip(true_ones) {
            assert_eq!(found.len(), true_ones.len());
            n += found.iter().flatten().count();
            right += found.iter().zip(true_ones).filter(|(f, t)| f.map(|f| f.0) == **t).count();
        }
    }
    let wrong_or_right = right.max(n - right); // two people, numbered either way
    assert!(n > 1000 && wrong_or_right as f64 > 0.98 * n as f64, "{wrong_or_right} of {n}");
}

/// Cameras started by hand, one after the other: few of them, or none, fit together before the repair.
#[test]
fn offsets_of_seconds_are_named_and_estimated() {
    let offsets = [0.0, 55.0, -40.0, 6.0];
    let config = recording(offsets);
    let session = simulate(&config).unwrap().session;
    let options = Options { repair: Repair::Auto, ..Options::default() };
    let found = reconstruct(&session, &options, &Progress::silent()).unwrap();
    let named = &found.report.suspicions;
    assert!(!named.is_empty() && named.iter().all(|s| s.code == Code::TimeOffset && s.applied), "{named:?}");
    let errors = errors(&found, offsets, config.fps);
    assert!(errors.iter().all(|error| error.abs() < 0.05), "{errors:?}");
}

/// Held to focal lengths 20 % too long, offsets of this recording came out 0.13 frames off, others half a frame.
#[test]
fn offsets_do_not_follow_wrong_focal_lengths() {
    let preset = SimulationConfig::preset(Preset::Paper);
    let config =
        SimulationConfig { people: 1, views: 4, frames: 200, seed: 4, time_offsets: OFFSETS.to_vec(), ..preset };
    let mut session = simulate(&config).unwrap().session;
    session.views.iter_mut().for_each(|view| view.intrinsics = view.intrinsics.with_focal_factor(1.2));
    let options = Options { sync: Sync::Estimate, intrinsics: IntrinsicsMode::RefineFocal, ..Options::default() };
    let found = reconstruct(&session, &options, &Progress::silent()).unwrap();
    let errors = errors(&found, OFFSETS, config.fps);
    assert!(errors.iter().all(|error| error.abs() < 0.07), "{errors:?}");
}

/// A recording of 20 s whose second camera is 0.7 % slow, four frames in all: the check names it, and with its repair the clock is
/// estimated.
#[test]
fn a_slow_clock_is_named_and_estimated() {
    let preset = SimulationConfig::preset(Preset::Easy);
    let config = SimulationConfig { views: 4, frames: 600, seed: 3, ..preset };
    let synchronous = simulate(&config).unwrap().session;
    let (right, slow) = (CameraClock::default(), CameraClock { offset: 0.0, drift: -2.0 });
    let session = retimed(&synchronous, &[right, slow, right, right]);
    let options = Options { repair: Repair::Auto, ..Options::default() };
    let found = reconstruct(&session, &options, &Progress::silent()).unwrap();
    let named: Vec<_> = found.report.suspicions.iter().map(|s| (s.code, s.cameras.clone(), s.applied)).collect();
    assert_eq!(named, [(Code::TimeOffset, vec![session.views[1].id.clone()], true)]);
    for (v, camera) in found.cameras.iter().enumerate() {
        let drift = camera.time_offset.unwrap().drift.unwrap();
        let frames = 0.5 * drift.rate * (config.frames as f64 - 1.0);
        let expected = if v == 1 { 2.0 } else { 0.0 };
        assert!(
            (frames - expected).abs() < 0.1 && drift.sigma.unwrap() * 300.0 < 0.1,
            "view {v}: {frames} frames, {drift:?}"
        );
    }
}
