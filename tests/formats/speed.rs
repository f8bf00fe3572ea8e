//! Speed and memory of reading a gigabyte of frame files.

use std::io::{BufWriter, Write};
use std::time::Instant;
use wandless::session::upload::{UploadLimits, read_path};

/// Frame files of five people with faces and hands, as OpenPose writes them: 60 000 files of about 17 kB.
const N_CAMERAS: usize = 3;
const N_FRAMES: usize = 20_000;

fn person(seed: usize) -> String {
    let numbers = |n: usize| {
        let number = |i: usize| format!("{}.{:03}", 100 + (7 * i + seed) % 900, (31 * i + seed) % 1000);
        let triple =
            |i: usize| format!("{},{},0.{:06}", number(i), number(i + 3), 100_000 + (977 * i + seed) % 800_000);
        (0..n).map(triple).collect::<Vec<_>>().join(",")
    };
    format!(
        "{{\"person_id\":[-1],\"pose_keypoints_2d\":[{}],\"face_keypoints_2d\":[{}],\"hand_left_keypoints_2d\":[{}],\
         \"hand_right_keypoints_2d\":[{}],\"pose_keypoints_3d\":[]}}",
        numbers(25),
        numbers(70),
        numbers(21),
        numbers(21)
    )
}

fn peak_mib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    peak.trim().strip_suffix(" kB").unwrap().parse::<u64>().unwrap() / 1024
}

#[test]
#[ignore = "writes and reads a gigabyte: half a minute"]
fn reads_frame_files_at_sixty_megabytes_per_second() {
    let file = tempfile::NamedTempFile::new().unwrap();
    let mut zip = zip::ZipWriter::new(BufWriter::new(file.reopen().unwrap()));
    let options = zip::write::SimpleFileOptions::default().compression_level(Some(1));
    let (name, text) = crate::take::calib_toml();
    zip.start_file(name, options).unwrap();
    zip.write_all(&text).unwrap();
    let frames: Vec<String> = (0..50)
        .map(|i| {
            format!(
                "{{\"version\":1.3,\"people\":[{}]}}",
                (0..5).map(|p| person(100 * i + p)).collect::<Vec<_>>().join(",")
            )
        })
        .collect();
    let mut n_bytes = 0;
    for camera in 0..N_CAMERAS {
        for frame in 0..N_FRAMES {
            zip.start_file(format!("cam{}_json/cam_{frame:012}_keypoints.json", camera + 1), options).unwrap();
            let text = &frames[(frame + camera) % frames.len()];
            zip.write_all(text.as_bytes()).unwrap();
            n_bytes += text.len();
        }
    }
    zip.finish().unwrap().flush().unwrap();
    let start = Instant::now();
    let loaded = read_path(file.path(), &UploadLimits::default()).unwrap();
    let (seconds, peak) = (start.elapsed().as_secs_f64(), peak_mib());
    let rate = n_bytes as f64 / 1e6 / seconds;
    println!("{:.0} MB in {seconds:.1} s: {rate:.0} MB/s, peak {peak} MiB", n_bytes as f64 / 1e6);
    assert_eq!(loaded.session.n_frames, N_FRAMES);
    assert!(rate >= 60.0, "{rate} MB/s");
    assert!(peak <= 512, "{peak} MiB");
}
