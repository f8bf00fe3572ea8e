//! Nuke's `.chan` and the data of the Blender script.

use crate::result::{FIRST_FRAME, N_FRAMES, assert_near, both_up_axes, centred, numbers};
use nalgebra::{Isometry3, Point3, Quaternion, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};
use serde_json::Value;
use wandless::geometry::{Distortion, Intrinsics};
use wandless::session::reconstruction::ExportFormat;
use wandless::session::recording::UpAxis;

#[test]
fn chan_projects_like_cameras_json() {
    for written in both_up_axes(&[ExportFormat::Chan, ExportFormat::Colmap, ExportFormat::Blender]) {
        let names = ["01", "left_front", "cam_c", "kamera-4", "wide", "dome"];
        for (camera, name) in written.cameras().iter().zip(names) {
            let text = written.text(&format!("{name}.chan"));
            assert_eq!(text.lines().count(), N_FRAMES);
            let frames: Vec<i64> = text.lines().map(|l| l.split('\t').next().unwrap().parse().unwrap()).collect();
            assert_eq!(frames, (FIRST_FRAME..FIRST_FRAME + N_FRAMES as i64).collect::<Vec<_>>());
            let v: Vec<f64> = text.lines().next().unwrap().split('\t').map(|v| v.parse().unwrap()).collect();
            let about = |axis, degrees: f64| Rotation3::from_axis_angle(&axis, degrees.to_radians());
            // ZXY: about z first.
            let turn = about(Vector3::y_axis(), v[5]) * about(Vector3::x_axis(), v[4]) * about(Vector3::z_axis(), v[6]);
            let place = Vector3::new(v[1], v[2], v[3]);
            let height = f64::from(camera.lens.height);
            let focal = height / 2.0 / (v[7].to_radians() / 2.0).tan();
            let middle = Vector2::new(f64::from(camera.lens.width) - 1.0, height - 1.0) / 2.0;
            let project = |point: &Vector3<f64>| {
                let p = turn.inverse() * (written.turned(UpAxis::Y, point) - place);
                middle + Vector2::new(p.x, -p.y) / -p.z * focal
            };
            let hold = |lens: &mut Intrinsics| {
                centred(lens);
                (lens.fx, lens.skew, lens.dist) = (lens.fy, 0.0, Distortion::None);
            };
            written.assert_projects(camera, hold, project);
        }
    }
}

/// `TAKE` of the script: a Python string literal that is also valid JSON.
fn take(script: &str) -> Value {
    let line = script.lines().find_map(|line| line.strip_prefix("TAKE = json.loads(")).unwrap();
    let literal: String = serde_json::from_str(line.strip_suffix(')').unwrap()).unwrap();
    serde_json::from_str(&literal).unwrap()
}

fn turn(xyzw: &Value) -> UnitQuaternion<f64> {
    let q = numbers(xyzw);
    UnitQuaternion::from_quaternion(Quaternion::new(q[3], q[0], q[1], q[2]))
}

#[test]
fn script_joints_match_the_result() {
    for written in both_up_axes(&[ExportFormat::Chan, ExportFormat::Colmap, ExportFormat::Blender]) {
        let take = take(&written.text("scene.py"));
        assert_eq!(take["name"], "a \"take\" \\ with 'quotes' ü\n");
        let parents: Vec<Option<usize>> =
            take["parents"].as_array().unwrap().iter().map(|p| p.as_u64().map(|p| p as usize)).collect();
        for (person, theirs) in written.people().iter().zip(take["people"].as_array().unwrap()) {
            assert_eq!(theirs["first_frame"], person.frames[0]);
            assert_eq!(numbers(&theirs["carried"]), [5, 6, 7].map(|i| person.frames[i] as f64));
            let rest: Vec<Vector3<f64>> =
                theirs["rest_joints"].as_array().unwrap().iter().map(|j| Vector3::from_vec(numbers(j))).collect();
            for (i, joints) in person.joints.iter().enumerate() {
                let mut posed: Vec<Isometry3<f64>> = Vec::new();
                for (j, parent) in parents.iter().enumerate() {
                    let local = turn(&theirs["rotations_xyzw"][j][i]);
                    let pose = match parent {
                        None => Isometry3::from_parts(Vector3::from_vec(numbers(&theirs["pelvis"][i])).into(), local),
                        Some(p) => posed[*p] * Isometry3::from_parts((rest[j] - rest[*p]).into(), local),
                    };
                    posed.push(pose);
                    assert_near(&written.turned(UpAxis::Y, &joints[j]), &pose.translation.vector, "scene.py");
                }
            }
        }
    }
}

#[test]
fn script_cameras_project_like_cameras_json() {
    for written in both_up_axes(&[ExportFormat::Chan, ExportFormat::Colmap, ExportFormat::Blender]) {
        let take = take(&written.text("scene.py"));
        for (camera, theirs) in written.cameras().iter().zip(take["cameras"].as_array().unwrap()) {
            assert_eq!(theirs["distortion_model"], camera.lens.dist.name());
            assert_eq!(numbers(&theirs["dist"]), camera.lens.dist.coefficients());
            let place = Vector3::from_vec(numbers(&theirs["location"]));
            let world_from_camera = Isometry3::from_parts(Translation3::from(place), turn(&theirs["rotation_xyzw"]));
            let number = |key: &str| theirs[key].as_f64().unwrap();
            let (width, height) = (number("width"), number("height"));
            let focal = number("focal_length_mm") / number("sensor_width_mm"); // widths of the image
            let shift = numbers(&theirs["shift"]);
            let aspect = number("pixel_aspect");
            // According to Blender's manual the shift moves the image centre by this many widths of the sensor.
            let project = |point: &Vector3<f64>| {
                let p = world_from_camera.inverse_transform_point(&Point3::from(written.turned(UpAxis::Y, point)));
                let (x, y) = (p.x / -p.z * focal - shift[0], p.y / -p.z * focal - shift[1]);
                Vector2::new(x * width + width / 2.0 - 0.5, height / 2.0 - 0.5 - y * width / aspect)
            };
            let hold = |lens: &mut Intrinsics| (lens.skew, lens.dist) = (0.0, Distortion::None);
            written.assert_projects(camera, hold, project);
        }
    }
}
