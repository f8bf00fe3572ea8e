//! Training of a tiny network: the same bytes in every run, with any number of threads, and after an interruption.

use super::waving;
use std::path::Path;
use wandless::motion_prior::checkpoint::{Checkpoint, checkpoint_bytes};
use wandless::motion_prior::dataset::{Dataset, read_dataset};
use wandless::motion_prior::motion_writer::write_take;
use wandless::motion_prior::training::{TrainingConfig, TrainingError, state_bytes, state_from_bytes, train};
use wandless::motion_prior::{VaeForm, VaeShape};
use wandless::progress::Progress;

fn data(folder: &Path) -> Dataset {
    for subject in 0..6 {
        let of_subject = folder.join(format!("s{subject}"));
        std::fs::create_dir(&of_subject).unwrap();
        write_take(&of_subject.join("a.npz"), &waving(120, 30.0, f64::from(subject))).unwrap();
    }
    read_dataset(folder).unwrap()
}

fn config(steps: usize) -> TrainingConfig {
    let shape = VaeShape { encoder_hidden: 8, decoder_hidden: 8, form: VaeForm::Recurrent };
    TrainingConfig { steps, shape, ..TrainingConfig::default() }
}

fn trained(data: &Dataset, threads: usize) -> Checkpoint {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| train(data, &config(4), None, &Progress::silent(), &mut |_| {}).unwrap())
}

#[test]
fn the_seed_determines_the_bytes_with_any_threads() {
    let folder = tempfile::tempdir().unwrap();
    let data = data(folder.path());
    let once = checkpoint_bytes(&trained(&data, 1));
    assert_eq!(once, checkpoint_bytes(&trained(&data, 3)));
    let other = TrainingConfig { seed: 2, ..config(4) };
    let other = train(&data, &other, None, &Progress::silent(), &mut |_| {}).unwrap();
    assert_ne!(once, checkpoint_bytes(&other));
}

/// A short run validates once, at its last step, so that the state is that of the complete run.
#[test]
fn resuming_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let data = data(folder.path());
    let mut kept = None;
    let straight =
        train(&data, &config(4), None, &Progress::silent(), &mut |state| kept = Some(state.clone())).unwrap();
    let bytes = state_bytes(&kept.unwrap());
    let state = state_from_bytes(&bytes).unwrap();
    let resumed = train(&data, &config(4), Some(state), &Progress::silent(), &mut |_| {}).unwrap();
    assert_eq!(checkpoint_bytes(&straight), checkpoint_bytes(&resumed));
    assert!(matches!(state_from_bytes(&bytes[..bytes.len() - 3]), Err(TrainingError::Unreadable)));
}

#[test]
fn rejects_too_little_data() {
    let folder = tempfile::tempdir().unwrap();
    write_take(&folder.path().join("short.npz"), &waving(20, 30.0, 0.0)).unwrap();
    let data = read_dataset(folder.path()).unwrap();
    let refused = train(&data, &config(1), None, &Progress::silent(), &mut |_| {});
    assert!(matches!(refused, Err(TrainingError::TooFewFrames { frames: 20 })));
}
