//! Training of a tiny network: the same bytes in every run, with any number of threads.

use super::waving;
use std::path::Path;
use wandless::motion_prior::dataset::{Dataset, read_dataset};
use wandless::motion_prior::motion_writer::write_take;
use wandless::motion_prior::training::{TrainingConfig, TrainingError, train};
use wandless::motion_prior::weights::{NetworkKind, Weights, WeightsError};
use wandless::motion_prior::{LatentPrior, MotionPrior};
use wandless::progress::Progress;

fn data(folder: &Path) -> Dataset {
    for subject in 0..6 {
        let of_subject = folder.join(format!("s{subject}"));
        std::fs::create_dir(&of_subject).unwrap();
        write_take(&of_subject.join("a.npz"), &waving(240, 30.0, f64::from(subject))).unwrap();
    }
    read_dataset(folder).unwrap()
}

fn trained(data: &Dataset, model: NetworkKind, seed: u64, threads: usize) -> Weights {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let config = TrainingConfig { model, seed, steps: 3, width: 16 };
    pool.install(|| train(data, &config, &Progress::silent(), &mut |_| {}).unwrap())
}

#[test]
fn the_seed_determines_the_bytes_with_any_threads() {
    let folder = tempfile::tempdir().unwrap();
    let data = data(folder.path());
    for model in [NetworkKind::Denoiser, NetworkKind::Latent] {
        let once = trained(&data, model, 1, 1).to_bytes().unwrap();
        assert_eq!(once, trained(&data, model, 1, 3).to_bytes().unwrap());
        assert_ne!(once, trained(&data, model, 2, 3).to_bytes().unwrap());
        assert_eq!(MotionPrior::from_bytes(&once).is_ok(), model == NetworkKind::Denoiser);
        assert_eq!(LatentPrior::from_bytes(&once).is_ok(), model == NetworkKind::Latent);
    }
}

#[test]
fn damaged_weights_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let weights = trained(&data(folder.path()), NetworkKind::Denoiser, 1, 1);
    let bytes = weights.to_bytes().unwrap();
    assert!(matches!(Weights::from_bytes(&bytes[..bytes.len() - 7]), Err(WeightsError::Format(_))));
    assert!(matches!(Weights::from_bytes(b"weights"), Err(WeightsError::Format(_))));
    let mut spoilt = weights.clone();
    spoilt.basis.mean[3] = f32::NAN;
    let refused = Weights::from_bytes(&spoilt.to_bytes().unwrap()).unwrap_err().to_string();
    assert!(refused.contains("pose.mean") && refused.contains("finite"), "{refused}");
    let mut smaller = weights;
    smaller.network.remove("head.weight");
    let refused = MotionPrior::from_bytes(&smaller.to_bytes().unwrap()).unwrap_err().to_string();
    assert!(refused.contains("head.weight"), "{refused}");
}

#[test]
fn rejects_too_little_data() {
    let folder = tempfile::tempdir().unwrap();
    write_take(&folder.path().join("short.npz"), &waving(20, 30.0, 0.0)).unwrap();
    let data = read_dataset(folder.path()).unwrap();
    let refused = train(&data, &TrainingConfig::of(NetworkKind::Denoiser), &Progress::silent(), &mut |_| {});
    assert!(matches!(refused, Err(TrainingError::TooFewFrames { frames: 20 })));
}
