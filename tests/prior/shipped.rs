//! Tests of the embedded weights.

use super::{rotations, waving};
use std::path::Path;
use wandless::body::skeleton::N_JOINTS;
use wandless::geometry::rotation::angle_between;
use wandless::motion_prior::MotionPrior;
use wandless::motion_prior::chart::{LATENT_JOINTS, LocalRotations};
use wandless::motion_prior::dataset::read_dataset;
use wandless::motion_prior::evaluation::{
    clips_of, features_of, gap_task, latent_statistics, limb_task, noise_task, prolonged, rate_difference_mm,
    reconstruction, sample_statistics,
};

/// Mean angle between latent joints of two takes, degrees.
fn mean_angle_deg(a: &[LocalRotations], b: &[LocalRotations]) -> f64 {
    let angles = a.iter().zip(b).flat_map(|(a, b)| LATENT_JOINTS.iter().map(|&j| angle_between(&a[j], &b[j])));
    (angles.sum::<f64>() / (a.len() * LATENT_JOINTS.len()) as f64).to_degrees()
}

#[test]
fn reconstruction_keeps_length_and_outside_joints() {
    let prior = MotionPrior::embedded();
    for n in [1, 2, 3, 8, 127, 128, 129, 700] {
        let mut take = rotations(&waving(n, 30.0, 0.2));
        take.iter_mut().for_each(|frame| frame[13] = frame[16]);
        let back = prior.reconstructed(&take, None, 30.0);
        assert_eq!(back.len(), n);
        assert!(take.iter().zip(&back).all(|(a, b)| a[0] == b[0] && a[13] == b[13] && a[22] == b[22]));
        // Wrists and toes, which move joints very little, count here as much as hips: 6 degrees measured.
        assert!(mean_angle_deg(&take, &back) < 8.0, "{n}: {}", mean_angle_deg(&take, &back));
    }
    assert!(prior.reconstructed(&[], None, 30.0).is_empty());
}

#[test]
fn a_motion_is_the_same_at_25_30_and_60_hz() {
    let prior = MotionPrior::embedded();
    let at = |n: usize, fps: f64| prior.reconstructed(&rotations(&waving(n, fps, 0.0)), None, fps);
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
    let take = rotations(&waving(90, 25.0, 0.5));
    let mut seen = vec![[true; N_JOINTS]; 90];
    seen[30..45].iter_mut().for_each(|frame| *frame = [false; N_JOINTS]);
    let mut spoilt = take.clone();
    spoilt[30..45].iter_mut().for_each(|frame| frame[16] = frame[4].transpose() * frame[18]);
    let [a, b] = [&take, &spoilt].map(|take| prior.reconstructed(take, Some(&seen), 25.0));
    assert!(mean_angle_deg(&a, &b) < 1e-9);
}

/// Bounds on real takes; the model card has the figures.
#[test]
fn the_model_cards_figures_hold_on_test_takes() {
    let Ok(data) = std::env::var("WANDLESS_TEST_DATA") else {
        eprintln!("SKIPPED the_model_cards_figures_hold_on_test_takes: WANDLESS_TEST_DATA is not set");
        return;
    };
    let prior = MotionPrior::embedded();
    let data = read_dataset(&Path::new(&data).join("motion/valid")).unwrap();
    let takes = features_of(prior, &data.takes);
    let whole = reconstruction(prior, &takes);
    assert!(whole.mean_mm <= 17.0 && whole.p95_mm <= 60.0, "{whole:?}");
    assert!((0.72..1.25).contains(&whole.acceleration_ratio), "{whole:?}");
    let longest = takes.iter().max_by_key(|take| take.len()).unwrap();
    let alone = reconstruction(prior, std::slice::from_ref(longest));
    let long = reconstruction(prior, &[prolonged(longest, 2000)]);
    assert!((long.mean_mm / alone.mean_mm - 1.0).abs() < 0.15, "{long:?} {alone:?}");
    let short = reconstruction(prior, &clips_of(&takes, 8));
    assert!((short.mean_mm / whole.mean_mm - 1.0).abs() < 0.15, "{short:?} {whole:?}");
    let clips = clips_of(&takes, 120);
    let (gap, limb) = (gap_task(prior, &clips), limb_task(prior, &clips));
    let ratio = |task: &wandless::motion_prior::evaluation::TaskErrors| {
        task.prior.mean_mm / task.best_smoothing_mm().min(task.autoregression_mm)
    };
    assert!(ratio(&gap) < 1.05 && ratio(&limb) < 1.05 && ratio(&gap).min(ratio(&limb)) < 1.0, "{gap:?} {limb:?}");
    for steady in [false, true] {
        let noise = noise_task(prior, &clips, steady);
        // The first smoothing reproduces its input: its error is that of the input.
        let input_mm = noise.smoothings_mm[0].1;
        assert!(noise.prior.mean_mm < noise.best_smoothing_mm().min(0.7 * input_mm), "{noise:?}");
        assert!((0.7..1.3).contains(&noise.prior.acceleration_ratio), "{noise:?}");
    }
    for fps in [25.0, 60.0] {
        assert!(rate_difference_mm(prior, &data.takes, fps)[0] < 2.0, "{fps}");
    }
    assert!((0.4..4.0).contains(&latent_statistics(prior, &takes).mean_square));
    assert!(sample_statistics(prior, 1000, 1).within_limits > 0.95);
}
