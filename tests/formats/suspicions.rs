//! Warnings about wrong calibrations, before any compute is spent.

use crate::calibrations::native;
use crate::dialects::openpose;
use crate::take::{COCO17, Files, N_FRAMES, camera, points, read};
use serde_json::{Value, json};
use wandless::geometry::Distortion;

/// With this lens the wrong interpretation costs the session 1.04 px, by an independent computation.
const BARREL: Distortion = Distortion::OpenCv5([-0.4, 0.1, 0.0, 0.0, 0.0]);

/// The warnings of the take with a changed calibration and changed pixels.
fn warnings(dist: Distortion, change: impl Fn(&mut Value), pixel: impl Fn([f64; 2]) -> [f64; 2]) -> Vec<String> {
    let mut files: Files = vec![native(dist, change)];
    for (name, _) in openpose(&COCO17).into_iter().skip(2) {
        let digits = |text: &str| text.chars().filter(char::is_ascii_digit).collect::<String>();
        let (view, frame) = name.rsplit_once('/').unwrap().1.split_once('_').unwrap();
        let (view, frame): (usize, i64) = (digits(view).parse().unwrap(), digits(frame).parse().unwrap());
        assert!(frame < N_FRAMES);
        let person = |index: usize| {
            let seen = points(&camera(view - 1, Distortion::None), index, frame, &COCO17);
            let flat: Vec<f64> = seen
                .iter()
                .flat_map(|[x, y, c]| {
                    let [x, y] = pixel([*x, *y]);
                    [x, y, *c]
                })
                .collect();
            json!({"pose_keypoints_2d": flat})
        };
        files.push((name, json!({"people": [person(0), person(1)]}).to_string().into_bytes()));
    }
    read(&files).unwrap().warnings
}

fn assert_warns(warnings: &[String], part: &str) {
    assert!(warnings.iter().any(|line| line.contains(part)), "{part}: {warnings:?}");
}

fn same(pixel: [f64; 2]) -> [f64; 2] {
    pixel
}

#[test]
fn accepts_a_correct_calibration() {
    let lines = warnings(Distortion::None, |_| {}, same);
    assert!(lines.iter().all(|line| line.contains("joints kept")), "{lines:?}");
}

#[test]
fn warns_about_millimetres() {
    let in_mm = |camera: &mut Value| {
        camera["t"].as_array_mut().unwrap().iter_mut().for_each(|t| *t = json!(1000.0 * t.as_f64().unwrap()));
    };
    assert_warns(&warnings(Distortion::None, in_mm, same), "millimetres");
}

#[test]
fn warns_about_half_resolution() {
    let lines = warnings(Distortion::None, |_| {}, |[x, y]| [0.5 * (x + 0.5) - 0.5, 0.5 * (y + 0.5) - 0.5]);
    assert_warns(&lines, "half the calibration's resolution");
    assert_warns(&lines, "in images 0.5 times as large");
    let double = |[x, y]: [f64; 2]| [2.0 * (x + 0.5) - 0.5, 2.0 * (y + 0.5) - 0.5];
    assert_warns(&warnings(Distortion::None, |_| {}, double), "in images 2 times as large");
}

#[test]
fn warns_about_rotated_videos() {
    let clockwise = |[x, y]: [f64; 2]| [719.0 - y, x];
    assert_warns(&warnings(Distortion::None, |_| {}, clockwise), "90 degrees clockwise");
    let upside_down = |[x, y]: [f64; 2]| [1279.0 - x, 719.0 - y];
    assert_warns(&warnings(Distortion::None, |_| {}, upside_down), "180 degrees");
}

#[test]
fn warns_about_transposed_and_inverted_poses() {
    let transpose = |camera: &mut Value| {
        let given = camera["R"].clone();
        (0..3).for_each(|r| (0..3).for_each(|c| camera["R"][r][c] = given[c][r].clone()));
    };
    assert_warns(&warnings(Distortion::None, transpose, same), "R is transposed");
    let invert = |camera: &mut Value| {
        let number = |value: &Value| value.as_f64().unwrap();
        let (r, t) = (camera["R"].clone(), camera["t"].clone());
        for i in 0..3 {
            camera["t"][i] = json!(-(0..3).map(|k| number(&r[k][i]) * number(&t[k])).sum::<f64>());
            (0..3).for_each(|c| camera["R"][i][c] = r[c][i].clone());
        }
    };
    assert_warns(&warnings(Distortion::None, invert, same), "R and t map camera to world");
}

#[test]
fn warns_about_undistorted_points() {
    assert_warns(&warnings(BARREL, |_| {}, same), "already undistorted");
}
