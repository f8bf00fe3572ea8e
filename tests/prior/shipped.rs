//! Tests of the embedded weights.

use super::{pelvis, rotations, waving};
use std::path::Path;
use wandless::geometry::rotation::angle_between;
use wandless::motion_prior::chart::{LATENT_JOINTS, LocalRotations};
use wandless::motion_prior::dataset::{Take, read_dataset};
use wandless::motion_prior::evaluation::gap_errors;
use wandless::motion_prior::grid::at_rate;
use wandless::motion_prior::observed::{DESCRIBED_JOINTS, N_DESCRIBED, ObservedMotion, described_place};
use wandless::motion_prior::reconstruction::reconstruction_errors;
use wandless::motion_prior::{LatentPrior, MotionPrior};

/// Mean angle between latent joints of two takes, degrees.
fn mean_angle_deg(a: &[LocalRotations], b: &[LocalRotations]) -> f64 {
    let angles = a.iter().zip(b).flat_map(|(a, b)| LATENT_JOINTS.iter().map(|&j| angle_between(&a[j], &b[j])));
    (angles.sum::<f64>() / (a.len() * LATENT_JOINTS.len()) as f64).to_degrees()
}

fn observed(n_frames: usize, fps: f64) -> ObservedMotion {
    let take = waving(n_frames, fps, 0.3);
    let mut motion = ObservedMotion::exact(rotations(&take), pelvis(&take));
    motion.sigma = vec![[0.01; N_DESCRIBED]; n_frames];
    motion
}

#[test]
fn seen_joints_stay_where_they_are() {
    let prior = MotionPrior::embedded();
    for n in [1, 2, 3, 8, 127, 300] {
        let mut motion = observed(n, 30.0);
        motion.rotations.iter_mut().for_each(|frame| frame[13] = frame[16]);
        let found = prior.completed(&motion);
        assert!(mean_angle_deg(&motion.rotations, &found.rotations) < 1.5, "{n}");
        assert!(motion.rotations.iter().zip(&found.rotations).all(|(a, b)| a[13] == b[13] && a[22] == b[22]));
    }
}

/// A gap's uncertainty is largest in its middle, and precisions are positive definite.
#[test]
fn uncertainty_grows_into_a_gap() {
    let mut motion = observed(200, 30.0);
    motion.hide(&[16, 18, 20], 70..130);
    let found = MotionPrior::embedded().completed(&motion);
    let shoulder = described_place(16).unwrap();
    let sigma = |t: usize| found.precision[t][shoulder].try_inverse().unwrap().trace().sqrt();
    assert!(sigma(100) > 2.0 * sigma(71) && sigma(100) > 5.0 * sigma(40), "{} {} {}", sigma(40), sigma(71), sigma(100));
    assert!(found.precision.iter().flatten().all(|p| p.symmetric_eigenvalues().min() > 0.0));
}

#[test]
fn a_motion_is_the_same_at_25_30_and_60_hz() {
    let prior = MotionPrior::embedded();
    let at = |n: usize, fps: f64| {
        let motion = observed(n, fps);
        at_rate(&motion, fps, |grid| prior.completed(grid)).rotations
    };
    let thirty: Vec<LocalRotations> = at(181, 30.0).into_iter().step_by(6).collect();
    for (n, fps, step) in [(151, 25.0, 5), (361, 60.0, 12)] {
        let other: Vec<LocalRotations> = at(n, fps).into_iter().step_by(step).collect();
        assert_eq!(other.len(), thirty.len());
        assert!(mean_angle_deg(&thirty, &other) < 0.1, "{fps}: {}", mean_angle_deg(&thirty, &other));
    }
}

/// Rotations of unseen joints are arbitrary.
#[test]
fn unseen_rotations_are_ignored() {
    let prior = MotionPrior::embedded();
    let mut motion = observed(90, 30.0);
    motion.hide(&DESCRIBED_JOINTS, 30..45);
    let mut spoilt = motion.clone();
    spoilt.rotations[30..45].iter_mut().for_each(|frame| frame[16] = frame[4].transpose() * frame[18]);
    let [a, b] = [&motion, &spoilt].map(|motion| prior.completed(motion).rotations);
    assert!(mean_angle_deg(&a, &b) < 1e-9);
}

#[test]
fn completion_has_the_same_bytes_with_any_threads() {
    let mut motion = observed(200, 30.0);
    motion.hide(&[1, 4, 7, 10], 60..120);
    let completed = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| MotionPrior::embedded().completed(&motion))
    };
    assert_eq!(completed(1), completed(4));
}

/// The autoencoder at other frame rates, over several windows, and with any number of threads.
#[test]
fn latent_motions_are_decoded_at_any_rate_and_length() {
    let prior = LatentPrior::embedded();
    for (n_frames, fps) in [(1, 30.0), (2, 25.0), (90, 60.0), (400, 30.0), (350, 25.0)] {
        let motion = rotations(&waving(n_frames, fps, 0.3));
        let reconstructed = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| prior.reconstructed(&motion, fps))
        };
        let found = reconstructed(1);
        assert_eq!(found, reconstructed(3));
        // Waves of 17 degrees in every joint are no recorded motion: 4 to 6 degrees are lost. Wrong frames would lose the waves.
        assert!(mean_angle_deg(&motion, &found) < 8.0, "{n_frames} {fps}: {}", mean_angle_deg(&motion, &found));
    }
    assert!(prior.encoded(&[], 30.0).is_empty() && prior.drawn(0, 1).is_empty());
    assert_eq!(prior.drawn(50, 1), prior.drawn(50, 1));
}

/// Bounds on real takes; the model card has the figures.
#[test]
fn the_autoencoder_reconstructs_test_takes() {
    let Ok(data) = std::env::var("WANDLESS_TEST_DATA") else {
        eprintln!("SKIPPED the_autoencoder_reconstructs_test_takes: WANDLESS_TEST_DATA is not set");
        return;
    };
    let data = read_dataset(&Path::new(&data).join("motion/valid")).unwrap();
    let takes: Vec<&Take> = data.takes.iter().collect();
    let errors = reconstruction_errors(LatentPrior::embedded(), &takes);
    assert!(errors.network.mean_mm < 9.0, "{errors:?}");
}

/// Bounds on real takes; the model card has the figures.
#[test]
fn the_model_cards_figures_hold_on_test_takes() {
    let Ok(data) = std::env::var("WANDLESS_TEST_DATA") else {
        eprintln!("SKIPPED the_model_cards_figures_hold_on_test_takes: WANDLESS_TEST_DATA is not set");
        return;
    };
    let data = read_dataset(&Path::new(&data).join("motion/valid")).unwrap();
    let takes: Vec<&Take> = data.takes.iter().collect();
    let errors = gap_errors(MotionPrior::embedded(), &takes, 4);
    let mean = |value: fn(&wandless::motion_prior::evaluation::GapErrors) -> f64| errors.iter().map(value).sum::<f64>();
    assert!(mean(|kind| kind.denoiser_mm) < mean(|kind| kind.baseline_mm()), "{errors:?}");
}
