//! The presets with only the intrinsics given.

use super::{identity_shares, solved, worst_pair_deg};
use wandless::evaluation::camera_error::camera_pairs;
use wandless::evaluation::world_error::world_error;
use wandless::pipeline::{Options, reconstruct};
use wandless::progress::Progress;
use wandless::session::reconstruction::Verdict;
use wandless::session::recording::UpAxis;
use wandless::simulation::{Preset, SimulationConfig, Tracks, simulate};

fn preset(preset: Preset, frames: usize) -> SimulationConfig {
    SimulationConfig { frames, tracks: Tracks::None, ..SimulationConfig::preset(preset) }
}

#[test]
fn solves_paper_noise() {
    let (simulated, found) = solved(&preset(Preset::Paper, 150));
    // 5 px of noise at 1,000 px focal length is 0.3 degrees a point; thousands of points leave a tenth of it.
    assert!(worst_pair_deg(&simulated, &found) < 0.5);
    let (right, given) = identity_shares(&simulated, &found);
    assert!(right > 0.99 && given > 0.97, "right {right}, given {given}");
    assert_eq!(found.report.quality.verdict, Verdict::Pass, "{:?}", found.report.quality.reasons);
    assert_eq!(found.motions.len(), simulated.truth.joints[0].len());
}

#[test]
fn solves_hard_noise() {
    let (simulated, found) = solved(&preset(Preset::Hard, 150));
    assert!(worst_pair_deg(&simulated, &found) < 1.0);
    let (right, given) = identity_shares(&simulated, &found);
    assert!(right > 0.98 && given > 0.95, "right {right}, given {given}");
}

#[test]
fn result_does_not_depend_on_the_number_of_threads() {
    let simulated = simulate(&preset(Preset::Paper, 60)).unwrap();
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| reconstruct(&simulated.session, &Options::default(), &Progress::silent()).unwrap())
    };
    assert_eq!(on(1), on(2));
}

#[test]
fn the_floor_is_at_height_zero() {
    let (simulated, found) = solved(&preset(Preset::Easy, 120));
    let mut feet: Vec<f64> =
        found.motions.iter().flat_map(|m| &m.frames).map(|f| f.joints[10].y.min(f.joints[11].y)).collect();
    feet.sort_by(f64::total_cmp);
    // The lower foot joint lies 2 to 8 cm above the sole; scale and floor noise add a few.
    let median = feet[feet.len() / 2];
    assert!((-0.03..0.15).contains(&median), "lower foot joint at {median} m");
    let pairs = camera_pairs(&simulated.session, &simulated.truth.cameras, &found.cameras);
    let world = world_error(&pairs, found.up_axis, UpAxis::Y).unwrap();
    // Simulated cameras roll by a degree.
    assert!(world.up_deg < 2.0 && world.floor_mm.abs() < 60.0, "{world:?}");
}
