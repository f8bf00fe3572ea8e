//! Reading and writing motion files; invalid files give one clear error each.

use super::{rotations, waving};
use npyz::WriterBuilder;
use std::path::{Path, PathBuf};
use wandless::motion_prior::dataset::{DatasetError, read_dataset};
use wandless::motion_prior::motion_file::{MotionProblem, read_take};
use wandless::motion_prior::motion_writer::write_take;

/// Writes arrays of doubles as an npz.
fn npz(path: &Path, arrays: &[(&str, &[u64], Vec<f64>)]) -> PathBuf {
    let mut zip = zip::ZipWriter::new(std::fs::File::create(path).unwrap());
    for (name, shape, values) in arrays {
        zip.start_file(format!("{name}.npy"), zip::write::SimpleFileOptions::default()).unwrap();
        let mut writer = npyz::WriteOptions::new().default_dtype().shape(shape).writer(&mut zip).begin_nd().unwrap();
        writer.extend(values.iter().copied()).unwrap();
        writer.finish().unwrap();
    }
    zip.finish().unwrap();
    path.to_owned()
}

#[test]
fn reads_what_it_writes() {
    let folder = tempfile::tempdir().unwrap();
    let (path, take) = (folder.path().join("a.npz"), waving(40, 60.0, 0.3));
    write_take(&path, &take).unwrap();
    let read = read_take(&path).unwrap();
    assert_eq!((read.fps, read.poses.len()), (60.0, 40));
    for (a, b) in rotations(&read).iter().zip(rotations(&take)) {
        assert!((0..24).all(|j| (a[j] - b[j]).norm() < 1e-9));
    }
    // One second and a half at 60 Hz less a frame: 20 samples at 30 Hz.
    assert_eq!(read_dataset(folder.path()).unwrap().takes[0].rotations.len(), 20);
}

#[test]
fn rejects_invalid_motion_files_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let rate = ("mocap_framerate", &[][..], vec![30.0]);
    let trans = |n: u64| ("trans", [n, 3], vec![0.0; 3 * n as usize]);
    let take = |name: &str, shape: [u64; 2], value: f64, n: u64| {
        let trans = trans(n);
        let poses = vec![value; (shape[0] * shape[1]) as usize];
        npz(&at(name), &[("poses", &shape, poses), (trans.0, &trans.1, trans.2), rate.clone()])
    };
    let shape = |result| matches!(result, Err(MotionProblem::Shape { array: "poses", .. }));
    assert!(shape(read_take(&take("width.npz", [4, 71], 0.0, 4))));
    assert!(shape(read_take(&take("empty.npz", [0, 72], 0.0, 0))));
    let nan = read_take(&take("nan.npz", [4, 72], f64::NAN, 4));
    assert!(matches!(nan, Err(MotionProblem::Values { array: "poses" })));
    let short = read_take(&take("trans.npz", [4, 72], 0.0, 3));
    assert!(matches!(short, Err(MotionProblem::Shape { array: "trans", .. })));
    let bare = npz(&at("bare.npz"), std::slice::from_ref(&rate));
    assert!(matches!(read_take(&bare), Err(MotionProblem::Archive { array: "poses", .. })));
    std::fs::write(at("text.npz"), b"no archive").unwrap();
    assert!(matches!(read_take(&at("text.npz")), Err(MotionProblem::Archive { .. })));
    let objects = at("objects.npz");
    let mut zip = zip::ZipWriter::new(std::fs::File::create(&objects).unwrap());
    zip.start_file("poses.npy", zip::write::SimpleFileOptions::default()).unwrap();
    let header = "{'descr': '|O', 'fortran_order': False, 'shape': (2, 72), }".to_owned();
    let header = format!("{header:<117}\n");
    let mut file = b"\x93NUMPY\x01\x00".to_vec();
    file.extend((header.len() as u16).to_le_bytes());
    file.extend(header.as_bytes());
    std::io::Write::write_all(&mut zip, &file).unwrap();
    zip.finish().unwrap();
    assert!(read_take(&objects).is_err());
    let named = read_dataset(folder.path()).unwrap_err();
    assert!(matches!(&named, DatasetError::Motion { path, .. } if path.ends_with("bare.npz")), "{named}");
}
