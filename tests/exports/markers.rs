//! TRC and C3D, read according to their published layouts.

use crate::result::{FIRST_FRAME, FPS, assert_near, both_up_axes, keypoint_offset};
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::fs;
use wandless::body::skeleton::{JOINT_NAMES, KeypointConvention};
use wandless::session::reconstruction::ExportFormat;
use wandless::session::recording::UpAxis;

/// The joints, and the keypoints under their own names.
fn marker_names() -> Vec<String> {
    let keypoints = KeypointConvention::Coco17.names().iter().map(|name| format!("detected_{name}"));
    JOINT_NAMES.iter().map(|name| (*name).to_owned()).chain(keypoints).collect()
}

/// A marker in the `i`th frame of a person, in the result's world.
fn expected(joints: &[Vector3<f64>], i: usize, marker: usize) -> Option<Vector3<f64>> {
    match marker.checked_sub(JOINT_NAMES.len()) {
        None => Some(joints[marker]),
        Some(k) => keypoint_offset(i, k).map(|offset| joints[k] + offset),
    }
}

#[test]
fn trc_joints_match_the_result() {
    for written in both_up_axes(&[ExportFormat::Trc, ExportFormat::C3d]) {
        for person in written.people() {
            let text = written.text(&format!("{}.trc", person.id));
            let lines: Vec<Vec<&str>> = text.lines().map(|line| line.split('\t').collect()).collect();
            assert_eq!(lines[0][..3], ["PathFileType", "4", "(X/Y/Z)"]);
            let head: BTreeMap<&str, &str> = lines[1].iter().copied().zip(lines[2].iter().copied()).collect();
            assert_eq!((head["Units"], head["NumMarkers"]), ("m", "41"));
            assert_eq!(head["NumFrames"], person.frames.len().to_string());
            assert_eq!(head["OrigDataStartFrame"], person.frames[0].to_string());
            assert_eq!(head["DataRate"].parse::<f64>().unwrap(), FPS);
            let names: Vec<&str> = lines[3][2..].iter().copied().filter(|name| !name.is_empty()).collect();
            assert_eq!(names, marker_names());
            assert_eq!(lines[4][2..5], ["X1", "Y1", "Z1"]);
            assert_eq!(lines[5], [""]);
            assert_eq!(lines.len(), 6 + person.frames.len());
            for (i, ((line, frame), joints)) in lines[6..].iter().zip(&person.frames).zip(&person.joints).enumerate() {
                assert_eq!(line[0], frame.to_string());
                let secs: f64 = line[1].parse().unwrap();
                assert!((secs - (frame - FIRST_FRAME) as f64 / FPS).abs() < 1e-6);
                assert_eq!(line.len(), 2 + 3 * 41);
                for (marker, cells) in line[2..].chunks(3).enumerate() {
                    match expected(joints, i, marker) {
                        None => assert_eq!(cells, ["", "", ""]),
                        Some(point) => {
                            let place = Vector3::from_iterator(cells.iter().map(|cell| cell.parse::<f64>().unwrap()));
                            assert_near(&written.turned(UpAxis::Y, &point), &place, "trc");
                        }
                    }
                }
            }
        }
    }
}

fn word(bytes: &[u8], at: usize) -> usize {
    usize::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]))
}

fn float(bytes: &[u8], at: usize) -> f32 {
    f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
}

/// Raw bytes of all parameters by `GROUP:NAME`, by following the records.
fn parameters(bytes: &[u8]) -> BTreeMap<String, Vec<u8>> {
    let start = (usize::from(bytes[0]) - 1) * 512;
    assert_eq!((bytes[start + 1], bytes[start + 3]), (0x50, 84));
    let mut groups = BTreeMap::new();
    let mut values = BTreeMap::new();
    let mut at = start + 4;
    while bytes[at] != 0 {
        let (n, id) = (usize::from(bytes[at]), bytes[at + 1] as i8);
        let name = String::from_utf8(bytes[at + 2..at + 2 + n].to_vec()).unwrap();
        let offset = at + 2 + n;
        if id < 0 {
            groups.insert(-id, name);
        } else {
            let n_dimensions = usize::from(bytes[offset + 3]);
            let size: usize = bytes[offset + 4..offset + 4 + n_dimensions].iter().map(|d| usize::from(*d)).product();
            let width = usize::from((bytes[offset + 2] as i8).unsigned_abs());
            let data = offset + 4 + n_dimensions;
            values.insert(format!("{}:{name}", groups[&id]), bytes[data..data + size * width].to_vec());
        }
        at = offset + word(bytes, offset);
    }
    assert!(at - start <= 512 * usize::from(bytes[start + 2]));
    values
}

#[test]
fn c3d_joints_match_the_result() {
    for written in both_up_axes(&[ExportFormat::Trc, ExportFormat::C3d]) {
        for person in written.people() {
            let bytes = fs::read(written.path(&format!("{}.c3d", person.id))).unwrap();
            assert_eq!((bytes.len() % 512, bytes[1]), (0, 0x50));
            assert_eq!((word(&bytes, 2), word(&bytes, 4)), (41, 0));
            assert_eq!(word(&bytes, 6) as i64, person.frames[0]);
            assert_eq!(word(&bytes, 8) as i64, *person.frames.last().unwrap());
            assert_eq!((float(&bytes, 12), float(&bytes, 20)), (-1.0, FPS as f32));
            let parameters = parameters(&bytes);
            assert_eq!(parameters["POINT:UNITS"], b"mm");
            assert_eq!(
                (parameters["POINT:X_SCREEN"].as_slice(), parameters["POINT:Y_SCREEN"].as_slice()),
                (&b"+X"[..], &b"+Z"[..])
            );
            assert_eq!(word(&parameters["POINT:FRAMES"], 0), person.frames.len());
            assert_eq!(word(&parameters["TRIAL:ACTUAL_START_FIELD"], 0) as i64, person.frames[0]);
            let labels = &parameters["POINT:LABELS"];
            let labels: Vec<&str> =
                labels.chunks(labels.len() / 41).map(|l| std::str::from_utf8(l).unwrap().trim()).collect();
            assert_eq!(labels, marker_names());
            let data_block = word(&bytes, 16);
            assert_eq!(word(&parameters["POINT:DATA_START"], 0), data_block);
            let mut at = (data_block - 1) * 512;
            for (i, (valid, joints)) in person.valid.iter().zip(&person.joints).enumerate() {
                for marker in 0..41 {
                    let point = expected(joints, i, marker).filter(|_| *valid);
                    let [x, y, z, residual] = [0, 4, 8, 12].map(|i| f64::from(float(&bytes, at + i)));
                    at += 16;
                    assert_eq!(residual, if point.is_some() { 0.0 } else { -1.0 });
                    if let Some(point) = point {
                        let place = Vector3::new(x, y, z) / 1000.0;
                        assert_near(&written.turned(UpAxis::Z, &point), &place, "c3d");
                    }
                }
            }
        }
    }
}
