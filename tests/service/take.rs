//! A small recording: two stick figures walk in circles in front of four known cameras, detected without noise.

use crate::stick_figure::{COCO17, stick_figure_point};
use serde_json::{Value, json};
use std::io::Write;
use zip::write::SimpleFileOptions;

type Point = [f64; 3];

/// Number of frames whose job still runs after some seconds on two cores.
pub const LONG: usize = 2000;

/// A session with the extrinsics of all its cameras, as one JSON document; `seed` shifts the walk.
pub fn take(frames: usize, seed: u32) -> Value {
    let cameras: Vec<Value> = (0..4).map(camera).collect();
    let poses: serde_json::Map<String, Value> = cameras
        .iter()
        .map(|camera| {
            let frames: Vec<Value> = (0..frames).map(|frame| recorded(camera, frame, seed)).collect();
            (camera["id"].as_str().unwrap().to_owned(), json!({ "frames": frames }))
        })
        .collect();
    json!({
        "name": format!("take {seed}"), "fps": 25, "n_frames": frames, "keypoint_convention": "coco17", "up_axis": "y",
        "cameras": cameras, "poses": poses,
    })
}

/// The session as a zip file in the native layout.
pub fn zipped(take: &Value) -> Vec<u8> {
    let mut session = take.clone();
    let poses = session.as_object_mut().unwrap().remove("poses").unwrap();
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    let mut member = |name: String, value: &Value| {
        zip.start_file(name, SimpleFileOptions::default()).unwrap();
        zip.write_all(value.to_string().as_bytes()).unwrap();
    };
    member("session.json".to_owned(), &session);
    for (camera, frames) in poses.as_object().unwrap() {
        member(format!("poses/{camera}.json"), frames);
    }
    zip.finish().unwrap().into_inner()
}

/// A camera 4 m from the centre, 1.5 m high, directed at the centre at a height of 1 m.
fn camera(index: usize) -> Value {
    let angle = 0.4 + 1.5 * index as f64;
    let center = [4.0 * angle.cos(), 1.5, 4.0 * angle.sin()];
    let ahead = unit([-center[0], 1.0 - center[1], -center[2]]);
    let right = unit(cross(ahead, [0.0, 1.0, 0.0]));
    let down = cross(ahead, right);
    let rotation = [right, down, ahead];
    let translation = rotation.map(|row| -dot(row, center));
    json!({
        "id": format!("cam{index}"), "width": 1280, "height": 720,
        "K": [[900.0, 0.0, 640.0], [0.0, 900.0, 360.0], [0.0, 0.0, 1.0]], "dist": [0.0, 0.0, 0.0, 0.0, 0.0],
        "R": rotation, "t": translation,
    })
}

fn recorded(camera: &Value, frame: usize, seed: u32) -> Value {
    let people: Vec<Value> = (0..2)
        .map(|person| {
            let points: Vec<Value> = body(frame, person, seed).iter().map(|point| seen(camera, *point)).collect();
            json!({ "track_id": null, "keypoints": points })
        })
        .collect();
    json!({ "frame": frame, "people": people })
}

/// COCO-17 points of one walking person in world coordinates, m.
fn body(frame: usize, person: usize, seed: u32) -> Vec<Point> {
    let time = frame as f64 / 25.0;
    let heading = 0.8 * time + 3.0 * person as f64 + 0.1 * f64::from(seed);
    let middle = [heading.cos(), 0.0, heading.sin()].map(|x| 0.9 * x);
    let (sin, cos) = (-heading).sin_cos();
    let point = |name: &&str| {
        let phase = (6.0 * time).sin() * if name.starts_with("right_") { -1.0 } else { 1.0 };
        let swing = match name.split_once('_') {
            Some((_, "elbow" | "wrist")) => -0.15 * phase,
            Some((_, "knee" | "ankle")) => 0.2 * phase,
            _ => 0.0,
        };
        let [x, y, z] = stick_figure_point(name).unwrap();
        let z = z + swing;
        [middle[0] + cos * x + sin * z, y, middle[2] - sin * x + cos * z]
    };
    COCO17.iter().map(point).collect()
}

fn seen(camera: &Value, point: Point) -> Value {
    let number = |value: &Value| value.as_f64().unwrap();
    let row = |i: usize| (0..3).map(|j| number(&camera["R"][i][j]) * point[j]).sum::<f64>() + number(&camera["t"][i]);
    let (x, y, z) = (row(0), row(1), row(2));
    let pixel = |center: f64, slope: f64| ((center + 900.0 * slope) * 100.0).round() / 100.0;
    json!([pixel(640.0, x / z), pixel(360.0, y / z), 0.9])
}

fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: Point, b: Point) -> Point {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(a: Point) -> Point {
    a.map(|x| x / dot(a, a).sqrt())
}
