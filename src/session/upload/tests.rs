//! Round trips and random damage.

use super::*;
use crate::body::skeleton::KeypointConvention;
use crate::geometry::{Intrinsics, Rigid, rotation};
use crate::session::formats::native::{to_json, write_folder};
use crate::session::recording::{Detection, FrameIndex, Keypoint, UpAxis, View};
use nalgebra::{Vector2, Vector3};
use proptest::prelude::*;
use std::io::{Cursor, Write};

/// Two cameras with names that need escaping, frames out of order and with gaps.
fn small_session() -> Session {
    let view = |id: &str, delivered: &[usize]| {
        let mut frames = vec![Vec::new(); 5];
        for &i in delivered {
            let keypoint = |k: usize| match k {
                3 => Keypoint::MISSING,
                _ => Keypoint::new(Vector2::new(10.25 * k as f64, 300.5 - i as f64), 0.875),
            };
            frames[i] = vec![Detection { track_id: Some(7 - i as i64), keypoints: (0..17).map(keypoint).collect() }];
        }
        View {
            id: id.to_owned(),
            intrinsics: Intrinsics {
                width: 640,
                height: 480,
                fx: 500.1,
                fy: 501.7,
                cx: 320.25,
                cy: 239.5,
                skew: 0.0,
                dist: [-0.1, 0.02, 1e-4, -2e-4, 0.001].into(),
            },
            time_offset: 0.02,
            has_intrinsics: true,
            camera_from_world: Some(Rigid {
                rotation: rotation::exp(&Vector3::new(0.1, -2.0, 0.3)),
                translation: Vector3::new(0.5, 1.25, 4.0),
            }),
            frames,
            delivered: delivered.iter().map(|&i| FrameIndex(i)).collect(),
        }
    };
    Session {
        name: "two \"cameras\"".to_owned(),
        fps: 29.97,
        first_frame: -3,
        n_frames: 5,
        dense: None,
        convention: KeypointConvention::Coco17,
        up_axis: Some(UpAxis::Z),
        start_timecode: Some("10:00:00:12".to_owned()),
        views: vec![view("Ä cam", &[4, 0, 2]), view("a", &[1])],
    }
}

fn read_bytes(bytes: &[u8]) -> Result<LoadedSession, UploadError> {
    read_upload(Cursor::new(bytes), "upload", &UploadLimits::default())
}

fn zip_of(files: &[(String, Vec<u8>)]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in files {
        zip.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        zip.write_all(content).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

fn files_of(dir: &Path, prefix: &str) -> Vec<(String, Vec<u8>)> {
    let mut names = vec!["session.json".to_owned()];
    names.extend(
        std::fs::read_dir(dir.join("poses")).unwrap().map(|e| format!("poses/{}", e.unwrap().file_name().display())),
    );
    names.sort();
    names.into_iter().map(|name| (format!("{prefix}{name}"), std::fs::read(dir.join(&name)).unwrap())).collect()
}

fn small_zip() -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    write_folder(&small_session(), dir.path()).unwrap();
    zip_of(&files_of(dir.path(), ""))
}

#[test]
fn round_trips_as_folder_zip_and_document() {
    let session = small_session();
    let dir = tempfile::tempdir().unwrap();
    write_folder(&session, dir.path()).unwrap();
    let folder = read_path(dir.path(), &UploadLimits::default()).unwrap();
    assert_eq!((&folder.session, folder.format.as_str()), (&session, "native"));
    assert_eq!(folder.warnings, [""; 0]);
    for prefix in ["", "take 1/"] {
        let zipped = read_bytes(&zip_of(&files_of(dir.path(), prefix))).unwrap();
        assert_eq!((&zipped.session, zipped.format.as_str()), (&session, "native"));
    }
    let document = read_bytes(to_json(&session).unwrap().as_bytes()).unwrap();
    assert_eq!((&document.session, document.format.as_str()), (&session, "native_json"));
    assert_eq!(document.sha256.len(), 64);
    assert_ne!(document.sha256, folder.sha256);
}

#[test]
fn round_trips_as_ndjson() {
    let session = small_session();
    let mut document: serde_json::Value = serde_json::from_str(&to_json(&session).unwrap()).unwrap();
    let poses = document.as_object_mut().unwrap().remove("poses").unwrap();
    let mut text = format!("{document}\n");
    for (camera, poses) in poses.as_object().unwrap() {
        for frame in poses["frames"].as_array().unwrap() {
            let mut line = frame.clone();
            line["camera"] = camera.clone().into();
            text += &format!("{line}\n");
        }
    }
    let read = read_bytes(text.as_bytes()).unwrap();
    assert_eq!((&read.session, read.format.as_str()), (&session, "native_ndjson"));
}

#[test]
fn rounds_keypoints_and_keeps_weak_ones() {
    let mut session = small_session();
    session.views[1].frames[1][0].keypoints[0] = Keypoint::new(Vector2::new(1.006, -0.001), 1e-5);
    let read = read_bytes(to_json(&session).unwrap().as_bytes()).unwrap().session;
    let keypoint = read.views[1].frames[1][0].keypoints[0];
    assert_eq!((keypoint.pixel, keypoint.confidence), (Vector2::new(1.01, 0.0), 1e-3));
}

#[test]
fn accepts_poses_first_and_warns_once_per_unknown_key() {
    let document: serde_json::Value = serde_json::from_str(&to_json(&small_session()).unwrap()).unwrap();
    let poses = document["poses"].to_string().replace("\"track_id\"", "\"box\":[1,[2]],\"track_id\"");
    let mut rest = document.clone();
    rest.as_object_mut().unwrap().remove("poses");
    let text = format!("{{\"poses\":{poses},\"lens\":null,{}", &rest.to_string()[1..]);
    let read = read_bytes(text.replace("0.875", "1.875").as_bytes()).unwrap();
    assert_eq!(
        read.warnings,
        [
            "upload: unknown key \"box\" in a person is ignored",
            "upload: unknown key \"lens\" in the session is ignored",
            "64 confidences above 1 (up to 1.875) are read as 1",
        ]
    );
    assert_eq!(read.session.views[0].frames[0][0].keypoints[0].confidence, 1.0);
}

#[test]
fn orthonormalises_a_rounded_rotation() {
    let session = small_session();
    let mut document: serde_json::Value = serde_json::from_str(&to_json(&session).unwrap()).unwrap();
    for value in document["cameras"][0]["R"].as_array_mut().unwrap().iter_mut().flat_map(|r| r.as_array_mut().unwrap())
    {
        *value = crate::session::formats::rounded(value.as_f64().unwrap(), 4).into();
    }
    let read = read_bytes(document.to_string().as_bytes()).unwrap().session;
    let (found, given) = (read.views[0].camera_from_world.unwrap(), session.views[0].camera_from_world.unwrap());
    // Nine entries with an error of at most half of the last digit each.
    assert!((found.rotation - given.rotation).norm() < 3.0 * 0.5e-4);
    assert!((found.rotation.transpose() * found.rotation - nalgebra::Matrix3::identity()).norm() < 1e-12);
}

#[test]
fn counts_people_and_frames_without_points() {
    let text = to_json(&small_session()).unwrap();
    // 4 frames of 3, 4 people of 4 and 17 points each.
    let n_spent = 4 * 3 + 4 * (4 + 17);
    let code = |max_keypoints| {
        let limits = UploadLimits { max_keypoints, ..UploadLimits::default() };
        read_upload(Cursor::new(&text), "upload", &limits).map_err(|e| e.code).map(|_| ())
    };
    assert_eq!((code(n_spent), code(n_spent - 1)), (Ok(()), Err("too_many_keypoints")));
}

#[test]
fn rejects_every_truncated_zip() {
    let zip = small_zip();
    for length in 0..zip.len() {
        assert!(read_bytes(&zip[..length]).is_err(), "{length} of {} bytes", zip.len());
    }
}

#[test]
fn rejects_or_ignores_every_flipped_byte_of_a_zip() {
    let zip = small_zip();
    let session = read_bytes(&zip).unwrap().session;
    for at in 0..zip.len() {
        let mut damaged = zip.clone();
        damaged[at] ^= 0xff;
        if let Ok(read) = read_bytes(&damaged) {
            assert_eq!(read.session, session, "byte {at}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn reads_or_rejects_a_damaged_document(
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let mut bytes = to_json(&small_session()).unwrap().into_bytes();
        for (at, byte) in &flips {
            let at = at.index(bytes.len());
            bytes[at] = *byte;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        if let Err(error) = read_bytes(&bytes) {
            prop_assert!(!error.detail.is_empty() && !error.to_string().contains('\n'));
        }
    }

    #[test]
    fn reads_or_rejects_a_damaged_zip(
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let mut bytes = small_zip();
        for (at, byte) in &flips {
            let at = at.index(bytes.len());
            bytes[at] = *byte;
        }
        if let Err(error) = read_bytes(&bytes) {
            prop_assert!(!error.detail.is_empty() && !error.to_string().contains('\n'));
        }
    }
}
