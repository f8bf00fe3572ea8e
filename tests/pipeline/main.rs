//! End-to-end tests on seeded synthetic sessions with known truth.
#![allow(clippy::unwrap_used)] // an unexpected value fails the test

mod corrections;
mod detailed_input;
mod edge_cases;
mod fast_people;
mod joint_adjustment;
mod mistakes;
mod monocular;
mod presets;
mod progress;
mod scale;
mod synchronisation;
mod unknown_lenses;
mod verdicts;

use wandless::evaluation::camera_error::{camera_pairs, relative_camera_error};
use wandless::pipeline::{Options, reconstruct};
use wandless::progress::Progress;
use wandless::session::Reconstruction;
use wandless::simulation::{Simulated, SimulationConfig, simulate};

/// Simulates and solves with default options.
fn solved(config: &SimulationConfig) -> (Simulated, Reconstruction) {
    let simulated = simulate(config).unwrap();
    let found = reconstruct(&simulated.session, &Options::default(), &Progress::silent()).unwrap();
    (simulated, found)
}

/// Worst error between two placed cameras, degrees, over rotations and directions.
fn worst_pair_deg(simulated: &Simulated, found: &Reconstruction) -> f64 {
    let pairs = camera_pairs(&simulated.session, &simulated.truth.cameras, &found.cameras);
    let error = relative_camera_error(&pairs).unwrap();
    error.rotation_deg.max(error.direction_deg)
}

/// Shares of detections assigned to the right person, and to any person.
fn identity_shares(simulated: &Simulated, found: &Reconstruction) -> (f64, f64) {
    let n_people = simulated.truth.joints[0].len();
    let mut counts = vec![vec![0usize; n_people]; found.motions.len()];
    let (mut n_given, mut n_all) = (0usize, 0usize);
    for (truth, given) in simulated.truth.identities.iter().zip(&found.identities) {
        for (truth, given) in truth.iter().flatten().zip(given.iter().flatten()) {
            n_all += 1;
            if let Some(person) = given {
                n_given += 1;
                counts[person.0][truth.unwrap()] += 1;
            }
        }
    }
    let right: usize = counts.iter().map(|v| v.iter().max().copied().unwrap_or(0)).sum();
    (right as f64 / n_given.max(1) as f64, n_given as f64 / n_all.max(1) as f64)
}
