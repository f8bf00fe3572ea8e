//! One recording of two people and three cameras, and functions that write it as other tools' files.

pub(crate) use crate::stick_figure::COCO17;
use crate::stick_figure::stick_figure_point;
use nalgebra::{Matrix3, Rotation3, Vector3};
use std::io::{Cursor, Write};
use wandless::geometry::{Distortion, Intrinsics, Rigid};
use wandless::session::upload::{LoadedSession, UploadError, UploadLimits, read_upload};

pub(crate) const N_FRAMES: i64 = 24;
pub(crate) const CAMERAS: [&str; 3] = ["cam1", "cam2", "cam3"];
pub(crate) const WIDTH: u32 = 1280;
pub(crate) const HEIGHT: u32 = 720;

/// Files with their names.
pub(crate) type Files = Vec<(String, Vec<u8>)>;

/// A detected point: x and y in pixels, confidence.
pub(crate) type Point = [f64; 3];

/// A camera of the rig, on a circle of 4 m and looking at its centre.
pub(crate) struct Camera {
    pub(crate) intrinsics: Intrinsics,
    pub(crate) pose: Rigid,
}

pub(crate) fn camera(index: usize, dist: Distortion) -> Camera {
    let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), 0.4 + 1.7 * index as f64).into_inner();
    // World is y up, the camera's y is down; a level camera's rotation would be symmetric and equal to its transpose.
    let tilt = Rotation3::from_euler_angles(0.08 + 0.02 * index as f64, 0.0, 0.1 - 0.07 * index as f64).into_inner();
    let rotation = tilt * Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)) * turn;
    let center = turn.transpose() * Vector3::new(0.0, 0.0, 4.0) + Vector3::new(0.0, 1.1 + 0.3 * index as f64, 0.0);
    Camera {
        intrinsics: Intrinsics {
            width: WIDTH,
            height: HEIGHT,
            fx: 800.5,
            fy: 801.25,
            cx: 640.5 + index as f64,
            cy: 358.25,
            skew: 0.0,
            dist,
        },
        pose: Rigid { rotation, translation: -(rotation * center) },
    }
}

/// Position of a person's joint at a frame, world metres.
fn joint(person: usize, frame: i64, name: &str) -> Option<Vector3<f64>> {
    let position = stick_figure_point(name)?;
    let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), 0.9 * person as f64 + 0.05 * frame as f64);
    let at = Vector3::new(1.3 * person as f64 - 0.7, 0.0, 0.03 * frame as f64 - 0.4);
    Some(turn * Vector3::from(position) + at)
}

/// Detected points of a person: pixels to 0.01 px, confidences of three digits; unknown joints missing.
pub(crate) fn points(camera: &Camera, person: usize, frame: i64, joints: &[&str]) -> Vec<Point> {
    let point = |(i, name): (usize, &&str)| {
        let pixel =
            joint(person, frame, name).and_then(|x| camera.intrinsics.pixel_from_camera(&camera.pose.transform(&x)));
        let confidence = 0.5 + 0.001 * ((7 * i + 3 * person + frame as usize) % 400) as f64;
        pixel.map_or([0.0; 3], |p| [round(p.x, 100.0), round(p.y, 100.0), round(confidence, 1000.0)])
    };
    joints.iter().enumerate().map(point).collect()
}

fn round(value: f64, per_unit: f64) -> f64 {
    (value * per_unit).round() / per_unit
}

/// The two people of a frame as camera `index` of the rig detects them.
pub(crate) fn people(index: usize, frame: i64, joints: &[&str]) -> Vec<Vec<Point>> {
    (0..2).map(|person| points(&camera(index, Distortion::None), person, frame, joints)).collect()
}

/// Pose2Sim's calibration of the rig.
pub(crate) fn calib_toml() -> (String, Vec<u8>) {
    let mut text = String::new();
    for (i, id) in CAMERAS.iter().enumerate() {
        let Camera { intrinsics: k, pose } = camera(i, Distortion::None);
        let r = wandless::geometry::rotation::log(&pose.rotation);
        let t = pose.translation;
        text += &format!(
            "[{id}]\nname = \"{id}\"\nsize = [{WIDTH}.0, {HEIGHT}.0]\nmatrix = [[{}, 0.0, {}], [0.0, {}, {}], [0.0, 0.0, 1.0]]\n\
             distortions = [0.0, 0.0, 0.0, 0.0]\nrotation = [{:?}, {:?}, {:?}]\ntranslation = [{:?}, {:?}, {:?}]\nfisheye = false\n\n",
            k.fx, k.cx, k.fy, k.cy, r.x, r.y, r.z, t.x, t.y, t.z
        );
    }
    text += "[metadata]\nadjusted = false\nerror = 0.0\n";
    ("calibration/Calib.toml".to_owned(), text.into_bytes())
}

pub(crate) fn header() -> (String, Vec<u8>) {
    ("session.json".to_owned(), br#"{"name": "take", "fps": 50}"#.to_vec())
}

pub(crate) fn zip(files: &Files) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in files {
        zip.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        zip.write_all(content).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

pub(crate) fn read(files: &Files) -> Result<LoadedSession, UploadError> {
    read_upload(Cursor::new(zip(files)), "upload", &UploadLimits::default())
}
