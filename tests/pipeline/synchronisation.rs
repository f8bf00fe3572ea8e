//! Time offsets between cameras, estimated from the motion.

use wandless::pipeline::config::Sync;
use wandless::pipeline::{Options, reconstruct};
use wandless::progress::Progress;
use wandless::simulation::{Preset, SimulationConfig, simulate};

/// Offsets of whole and fractional frames. The mean over all cameras is arbitrary.
#[test]
fn offsets_are_accurate_to_a_twentieth_of_a_frame() {
    let offsets = [0.0, 11.0, -14.0, 6.3];
    let config = SimulationConfig {
        views: 4,
        frames: 240,
        seed: 3,
        time_offsets: offsets.to_vec(),
        ..SimulationConfig::preset(Preset::Easy)
    };
    let simulated = simulate(&config).unwrap();
    let options = Options { sync: Sync::Estimate, ..Options::default() };
    let found = reconstruct(&simulated.session, &options, &Progress::silent()).unwrap();
    let estimates: Vec<_> = found.cameras.iter().map(|camera| camera.time_offset.unwrap()).collect();
    let errors: Vec<f64> =
        estimates.iter().zip(offsets).map(|(estimate, offset)| estimate.secs * config.fps - offset).collect();
    let shared = errors.iter().sum::<f64>() / errors.len() as f64;
    for (error, estimate) in errors.iter().zip(&estimates) {
        assert!((error - shared).abs() < 0.05, "{errors:?}");
        assert!(estimate.sigma_secs.unwrap() * config.fps < 0.1, "{estimate:?}");
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
