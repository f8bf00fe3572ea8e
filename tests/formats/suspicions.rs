//! A wrong calibration is told by name before compute is spent on it.

use crate::calibrations::native;
use crate::dialects::openpose;
use crate::take::{COCO17, Files, N_FRAMES, camera, points, read};
use serde_json::{Value, json};
use wandless::geometry::Distortion;

/// By an independent computation this lens, wrongly undone, costs the take 1.04 px.
const BARREL: Distortion = Distortion::OpenCv5([-0.4, 0.1, 0.0, 0.0, 0.0]);

/// The warnings of the take with a changed calibration and changed pixels.
fn warnings(dist: Distortion, change: impl Fn(&mut Value), pixel: impl Fn([f64; 2]) -> [f64; 2]) -> Vec<String> {
    let mut files: Files = vec![native(dist, change)];
    for (name, _) in openpose(&COCO17).into_iter().skip(2) {
        let digits = |text: &str| text.chars().filter(char::is_ascii_digit).collect::<String>();
        let (view, frame) = name.rsplit_once('/').unwrap().1.split_once('_').unwrap();
        let (view, frame): (usize, i64) = (digits(view).parse().unwrap(), digits(frame).parse().unwrap());
        assert!(frame < N_FRAMES);
        let person = |who: usize| {
            let seen = points(&camera(view - 1, Distortion::None), who, frame, &COCO17);
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

fn says(warnings: &[String], part: &str) {
    assert!(warnings.iter().any(|line| line.contains(part)), "{part}: {warnings:?}");
}

fn same(pixel: [f64; 2]) -> [f64; 2] {
    pixel
}

#[test]
fn a_right_calibration_is_not_suspected() {
    let lines = warnings(Distortion::None, |_| {}, same);
    assert!(lines.iter().all(|line| line.contains("joints kept")), "{lines:?}");
}

#[test]
fn millimetres_are_suspected() {
    let in_mm = |camera: &mut Value| {
        camera["t"].as_array_mut().unwrap().iter_mut().for_each(|t| *t = json!(1000.0 * t.as_f64().unwrap()));
    };
    says(&warnings(Distortion::None, in_mm, same), "millimetres");
}

#[test]
fn half_resolution_is_suspected() {
    let lines = warnings(Distortion::None, |_| {}, |[x, y]| [0.5 * (x + 0.5) - 0.5, 0.5 * (y + 0.5) - 0.5]);
    says(&lines, "half the calibration's resolution");
    says(&lines, "in images 0.5 times as large");
    let double = |[x, y]: [f64; 2]| [2.0 * (x + 0.5) - 0.5, 2.0 * (y + 0.5) - 0.5];
    says(&warnings(Distortion::None, |_| {}, double), "in images 2 times as large");
}

#[test]
fn a_turned_video_is_suspected() {
    let clockwise = |[x, y]: [f64; 2]| [719.0 - y, x];
    says(&warnings(Distortion::None, |_| {}, clockwise), "90 degrees clockwise");
    let upside_down = |[x, y]: [f64; 2]| [1279.0 - x, 719.0 - y];
    says(&warnings(Distortion::None, |_| {}, upside_down), "180 degrees");
}

#[test]
fn transposed_and_inverted_poses_are_suspected() {
    let transpose = |camera: &mut Value| {
        let given = camera["R"].clone();
        (0..3).for_each(|r| (0..3).for_each(|c| camera["R"][r][c] = given[c][r].clone()));
    };
    says(&warnings(Distortion::None, transpose, same), "R is transposed");
    let invert = |camera: &mut Value| {
        let number = |value: &Value| value.as_f64().unwrap();
        let (r, t) = (camera["R"].clone(), camera["t"].clone());
        for i in 0..3 {
            camera["t"][i] = json!(-(0..3).map(|k| number(&r[k][i]) * number(&t[k])).sum::<f64>());
            (0..3).for_each(|c| camera["R"][i][c] = r[c][i].clone());
        }
    };
    says(&warnings(Distortion::None, invert, same), "world from camera");
}

#[test]
fn undistorted_points_of_a_distorting_lens_are_suspected() {
    says(&warnings(BARREL, |_| {}, same), "already undistorted");
}
