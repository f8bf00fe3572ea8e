//! OpenCV YAML, the TOML files and COLMAP's text, parsed line by line and projected with OpenCV's formulas.

use crate::result::{Written, both_up_axes};
use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector2, Vector3};
use std::collections::BTreeMap;
use wandless::geometry::{Distortion, Intrinsics};
use wandless::session::reconstruction::ExportFormat;

const CALIBRATIONS: [ExportFormat; 4] =
    [ExportFormat::Easymocap, ExportFormat::OpencvYaml, ExportFormat::CalibToml, ExportFormat::AniposeToml];

/// A camera as in OpenCV's `projectPoints` or `fisheye::projectPoints`.
struct OpenCv {
    matrix: Matrix3<f64>,
    dist: Vec<f64>,
    is_fisheye: bool,
    rotation: Rotation3<f64>,
    translation: Vector3<f64>,
}

impl OpenCv {
    fn pixel(&self, point: &Vector3<f64>) -> Vector2<f64> {
        let p = self.rotation * point + self.translation;
        let (x, y) = (p.x / p.z, p.y / p.z);
        let r2 = x * x + y * y;
        let d = |i: usize| self.dist.get(i).copied().unwrap_or(0.0);
        if self.is_fisheye {
            let theta = r2.sqrt().atan();
            let bent = theta + (0..4).map(|i| d(i) * theta.powi(2 * i as i32 + 3)).sum::<f64>();
            let pixel = self.matrix * Vector3::new(x * bent / r2.sqrt(), y * bent / r2.sqrt(), 1.0);
            return Vector2::new(pixel.x, pixel.y);
        }
        let above = 1.0 + d(0) * r2 + d(1) * r2.powi(2) + d(4) * r2.powi(3);
        let radial = above / (1.0 + d(5) * r2 + d(6) * r2.powi(2) + d(7) * r2.powi(3));
        let xd = x * radial + 2.0 * d(2) * x * y + d(3) * (r2 + 2.0 * x * x);
        let yd = y * radial + d(2) * (r2 + 2.0 * y * y) + 2.0 * d(3) * x * y;
        let pixel = self.matrix * Vector3::new(xd, yd, 1.0);
        Vector2::new(pixel.x, pixel.y)
    }
}

fn floats(text: &str) -> Vec<f64> {
    let words = text.split(|c: char| c == ',' || c == '[' || c == ']' || c.is_whitespace()).filter(|w| !w.is_empty());
    words.map(|word| word.parse().unwrap()).collect()
}

/// Numbers by key: those after `data:`, or the rest of the line.
fn yaml(text: &str) -> BTreeMap<String, Vec<f64>> {
    assert!(text.starts_with("%YAML:1.0\n---\nnames:\n"));
    let mut values = BTreeMap::new();
    let mut key = String::new();
    for line in text.lines().skip(2) {
        if let Some(data) = line.trim().strip_prefix("data: ") {
            values.insert(key.clone(), floats(data));
        } else if !line.starts_with(' ') {
            let (name, rest) = line.split_once(':').unwrap();
            key = name.to_owned();
            if !rest.is_empty() && !rest.contains("!!") {
                values.insert(key.clone(), floats(rest));
            }
        }
    }
    values
}

fn check_yaml(written: &Written, folder: &str) {
    let intri_text = written.text(&format!("{folder}intri.yml"));
    let (intri, extri) = (yaml(&intri_text), yaml(&written.text(&format!("{folder}extri.yml"))));
    let names: Vec<&str> =
        intri_text.lines().filter_map(|line| line.strip_prefix("   - \"")?.strip_suffix('"')).collect();
    assert_eq!(names, ["01", "left_front", "cam_c", "kamera-4", "wide", "dome"]);
    for (camera, name) in written.cameras().iter().zip(names) {
        assert_eq!((intri[&format!("H_{name}")][0], intri[&format!("W_{name}")][0]), (1080.0, 1920.0));
        let vector = Rotation3::new(Vector3::from_column_slice(&extri[&format!("R_{name}")]));
        let matrix = Matrix3::from_row_slice(&extri[&format!("Rot_{name}")]);
        assert!((vector.matrix() - matrix).norm() < 1e-9);
        let theirs = OpenCv {
            matrix: Matrix3::from_row_slice(&intri[&format!("K_{name}")]),
            dist: intri[&format!("dist_{name}")].clone(),
            is_fisheye: false,
            rotation: vector,
            translation: Vector3::from_column_slice(&extri[&format!("T_{name}")]),
        };
        assert_eq!(theirs.dist.len(), if name == "wide" { 8 } else { 5 });
        let hold = |lens: &mut Intrinsics| {
            if let Distortion::Fisheye4(_) = lens.dist {
                lens.dist = Distortion::None;
            }
        };
        written.assert_projects(camera, hold, |point| theirs.pixel(point));
    }
}

#[test]
fn opencv_yaml_projects_like_cameras_json() {
    for written in both_up_axes(&CALIBRATIONS) {
        check_yaml(&written, "");
        check_yaml(&written, "easymocap/");
    }
}

/// Tables in order, with the text after the equals sign by key.
fn toml(text: &str) -> Vec<(String, BTreeMap<String, String>)> {
    let mut tables: Vec<(String, BTreeMap<String, String>)> = Vec::new();
    for line in text.lines().filter(|line| !line.is_empty()) {
        if let Some((key, value)) = line.split_once(" = ") {
            tables.last_mut().unwrap().1.insert(key.to_owned(), value.to_owned());
        } else {
            let name = line.strip_prefix('[').unwrap().strip_suffix(']').unwrap();
            tables.push((name.to_owned(), BTreeMap::new()));
        }
    }
    tables
}

#[test]
fn toml_calibrations_project_like_cameras_json() {
    for written in both_up_axes(&CALIBRATIONS) {
        for (file, n_distortions) in [("Calib.toml", 4), ("calibration.toml", 5)] {
            let tables = toml(&written.text(file));
            assert_eq!(tables.last().unwrap().0, "metadata");
            assert_eq!(tables.len(), 7);
            for (camera, (_, table)) in written.cameras().iter().zip(&tables) {
                assert_eq!(table["name"], format!("{:?}", camera.id));
                assert_eq!(floats(&table["size"]), [1920.0, 1080.0]);
                let theirs = OpenCv {
                    matrix: Matrix3::from_row_slice(&floats(&table["matrix"])),
                    dist: floats(&table["distortions"]),
                    is_fisheye: table["fisheye"].parse().unwrap(),
                    rotation: Rotation3::new(Vector3::from_vec(floats(&table["rotation"]))),
                    translation: Vector3::from_vec(floats(&table["translation"])),
                };
                assert_eq!(theirs.is_fisheye, camera.id == "dome");
                let n_expected = match camera.id.as_str() {
                    "dome" => 4,
                    "wide" if n_distortions == 5 => 8,
                    _ => n_distortions,
                };
                assert_eq!(theirs.dist.len(), n_expected);
                let hold = |lens: &mut Intrinsics| match &mut lens.dist {
                    Distortion::OpenCv5(dist) => dist[n_distortions..].fill(0.0),
                    Distortion::Rational8(_) if n_distortions < 5 => lens.dist = Distortion::None,
                    _ => {}
                };
                written.assert_projects(camera, hold, |point| theirs.pixel(point));
            }
        }
    }
}

#[test]
fn colmap_projects_like_cameras_json_with_half_pixel() {
    for written in both_up_axes(&[ExportFormat::Colmap]) {
        let content = |name: &str| -> Vec<String> {
            let text = written.text(name);
            text.lines().filter(|line| !line.starts_with('#')).map(str::to_owned).collect()
        };
        let (cameras, images) = (content("colmap/cameras.txt"), content("colmap/images.txt"));
        assert!(content("colmap/points3D.txt").is_empty());
        assert_eq!((cameras.len(), images.len()), (6, 12), "an image has two lines, the second may be empty");
        let models: Vec<&str> = cameras.iter().map(|line| line.split(' ').nth(1).unwrap()).collect();
        assert_eq!(models, ["PINHOLE", "OPENCV", "FULL_OPENCV", "PINHOLE", "FULL_OPENCV", "OPENCV_FISHEYE"]);
        for (i, camera) in written.cameras().iter().enumerate() {
            let words: Vec<&str> = cameras[i].split(' ').collect();
            assert_eq!((words[2], words[3]), ("1920", "1080"));
            let p: Vec<f64> = words[4..].iter().map(|w| w.parse().unwrap()).collect();
            let image: Vec<&str> = images[2 * i].split(' ').collect();
            assert_eq!((image[0], image[8], images[2 * i + 1].as_str()), (words[0], words[0], ""));
            let v: Vec<f64> = image[1..8].iter().map(|w| w.parse().unwrap()).collect();
            let theirs = OpenCv {
                // COLMAP counts from the corner of the first pixel.
                matrix: Matrix3::new(p[0], 0.0, p[2] - 0.5, 0.0, p[1], p[3] - 0.5, 0.0, 0.0, 1.0),
                dist: p[4..].to_vec(),
                is_fisheye: models[i] == "OPENCV_FISHEYE",
                rotation: UnitQuaternion::from_quaternion(Quaternion::new(v[0], v[1], v[2], v[3])).into(),
                translation: Vector3::new(v[4], v[5], v[6]),
            };
            written.assert_projects(camera, |lens| lens.skew = 0.0, |point| theirs.pixel(point));
        }
    }
}
