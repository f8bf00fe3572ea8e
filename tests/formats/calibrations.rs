//! Every calibration file projects like the camera it was written from; values that a format lacks cause warnings.

use crate::dialects::openpose;
use crate::take::{CAMERAS, COCO17, Camera, Files, HEIGHT, WIDTH, camera, people, read};
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use serde_json::json;
use wandless::geometry::{Distortion, rotation};
use wandless::session::upload::LoadedSession;

const OPENCV4: Distortion = Distortion::OpenCv5([-0.11, 0.07, 0.0006, -0.0004, 0.0]);
const OPENCV5: Distortion = Distortion::OpenCv5([-0.11, 0.07, 0.0006, -0.0004, -0.012]);
const RATIONAL: Distortion = Distortion::Rational8([0.6, 0.1, 0.0005, -0.0003, 0.01, 0.75, 0.2, 0.02]);
const FISHEYE: Distortion = Distortion::Fisheye4([-0.03, 0.012, -0.006, 0.001]);

fn comma(numbers: &[f64]) -> String {
    numbers.iter().map(|n| format!("{n:?}")).collect::<Vec<_>>().join(", ")
}

fn spaced(numbers: &[f64]) -> String {
    numbers.iter().map(|n| format!("{n:?}")).collect::<Vec<_>>().join(" ")
}

fn rig(dist: Distortion) -> Vec<(&'static str, Camera)> {
    CAMERAS.iter().enumerate().map(|(i, id)| (*id, camera(i, dist))).collect()
}

/// The nine entries of a rotation, row by row.
fn row_major(camera: &Camera) -> Vec<f64> {
    camera.pose.rotation.transpose().as_slice().to_vec()
}

fn matrix(camera: &Camera) -> Vec<f64> {
    camera.intrinsics.matrix().transpose().as_slice().to_vec()
}

fn translation(camera: &Camera) -> [f64; 3] {
    camera.pose.translation.into()
}

fn opencv_yaml(dist: Distortion, as_axis_angle: bool) -> Files {
    let (mut intri, mut extri) = ("%YAML:1.0\r\n---\r\nnames:\r\n".to_owned(), String::new());
    CAMERAS.iter().for_each(|id| intri += &format!("   - \"{id}\"\r\n"));
    extri += &intri;
    let matrix_of = |name: String, rows: usize, numbers: &[f64]| {
        let (cols, data) = (numbers.len() / rows, comma(numbers));
        format!("{name}: !!opencv-matrix\r\n   rows: {rows}\r\n   cols: {cols}\r\n   dt: d\r\n   data: [ {data} ]\r\n")
    };
    for (id, camera) in rig(dist) {
        intri += &matrix_of(format!("K_{id}"), 3, &matrix(&camera));
        intri += &matrix_of(format!("dist_{id}"), 1, dist.coefficients());
        intri += &format!("H_{id}: {HEIGHT}\r\nW_{id}: {WIDTH}\r\n");
        extri += &match as_axis_angle {
            true => matrix_of(format!("R_{id}"), 3, rotation::log(&camera.pose.rotation).as_slice()),
            false => matrix_of(format!("Rot_{id}"), 3, &row_major(&camera)),
        };
        extri += &matrix_of(format!("T_{id}"), 3, &translation(&camera));
    }
    vec![("intri.yml".to_owned(), intri.into_bytes()), ("extri.yml".to_owned(), extri.into_bytes())]
}

fn toml(dist: Distortion, n_coefficients: usize, table: &str, unit: f64, more: &str) -> Files {
    let mut text = String::new();
    for (i, (id, camera)) in rig(dist).into_iter().enumerate() {
        let k = matrix(&camera);
        let t = translation(&camera).map(|t| t * unit);
        let is_fisheye = matches!(dist, Distortion::Fisheye4(_));
        text += &format!(
            "[{}]\nname = \"{id}\"\nsize = [{WIDTH}, {HEIGHT}]\nmatrix = [[{}], [{}], [{}]]\ndistortions = [{}]\n\
             rotation = [{}]\ntranslation = [{}]\nfisheye = {is_fisheye}\n{more}\n",
            table.replace('#', &i.to_string()),
            comma(&k[..3]),
            comma(&k[3..6]),
            comma(&k[6..]),
            comma(&dist.coefficients()[..n_coefficients]),
            comma(rotation::log(&camera.pose.rotation).as_slice()),
            comma(&t)
        );
    }
    vec![("calibration.toml".to_owned(), text.into_bytes())]
}

fn colmap(dist: Distortion) -> Files {
    let (mut cameras, mut images) = ("# Camera list\n".to_owned(), "# Image list\n".to_owned());
    for (i, (id, camera)) in rig(dist).into_iter().enumerate() {
        let k = &camera.intrinsics;
        let model = match dist {
            Distortion::None => "PINHOLE",
            Distortion::OpenCv5(_) => "OPENCV",
            Distortion::Rational8(_) => "FULL_OPENCV",
            Distortion::Fisheye4(_) => "OPENCV_FISHEYE",
        };
        let n = if dist == Distortion::None { 0 } else { dist.coefficients().len().min(8) & !1 };
        let lens = [&[k.fx, k.fy, k.cx + 0.5, k.cy + 0.5], &dist.coefficients()[..n]].concat();
        cameras += &format!("{} {model} {WIDTH} {HEIGHT} {}\n", i + 1, spaced(&lens));
        let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(camera.pose.rotation));
        let pose = spaced(&[&[q.w, q.i, q.j, q.k], &translation(&camera)[..]].concat());
        images += &format!("{} {pose} {} {id}.jpg\n\n", i + 1, i + 1);
    }
    vec![("sparse/cameras.txt".to_owned(), cameras.into_bytes()), ("sparse/images.txt".to_owned(), images.into_bytes())]
}

fn ros(dist: Distortion) -> Files {
    let model = match dist {
        Distortion::None | Distortion::OpenCv5(_) => "plumb_bob",
        Distortion::Rational8(_) => "rational_polynomial",
        Distortion::Fisheye4(_) => "equidistant",
    };
    let file = |(id, camera): (&str, Camera)| {
        let (k, d) = (comma(&matrix(&camera)), dist.coefficients());
        let text = format!(
            "image_width: {WIDTH}\nimage_height: {HEIGHT}\ncamera_name: {id}\ncamera_matrix:\n  rows: 3\n  cols: 3\n  \
             data: [{k}]\ndistortion_model: {model}\ndistortion_coefficients:\n  rows: 1\n  cols: {}\n  data: [{}]\n\
             projection_matrix:\n  rows: 3\n  cols: 4\n  data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]\n",
            d.len(),
            comma(d)
        );
        (format!("info/{id}.yaml"), text.into_bytes())
    };
    rig(dist).into_iter().map(file).collect()
}

fn agisoft(dist: Distortion) -> Files {
    let (mut sensors, mut cameras) = (String::new(), String::new());
    for (i, (id, camera)) in rig(dist).into_iter().enumerate() {
        let (k, world_from_camera) = (&camera.intrinsics, camera.pose.inverse());
        let (kind, lens) = match dist {
            Distortion::Fisheye4([k1, k2, k3, k4]) => ("equidistant_fisheye", [k1, k2, k3, k4, 0.0, 0.0]),
            Distortion::OpenCv5([k1, k2, p1, p2, k3]) => ("frame", [k1, k2, k3, 0.0, p2, p1]),
            _ => ("frame", [0.0; 6]),
        };
        let [k1, k2, k3, k4, p1, p2] = lens;
        sensors += &format!(
            "<sensor id=\"{i}\" label=\"s\" type=\"{kind}\"><resolution width=\"{WIDTH}\" height=\"{HEIGHT}\"/>\
             <calibration type=\"{kind}\" class=\"adjusted\"><resolution width=\"{WIDTH}\" height=\"{HEIGHT}\"/>\
             <f>{:?}</f><cx>{:?}</cx><cy>{:?}</cy><b1>{:?}</b1><k1>{k1:?}</k1><k2>{k2:?}</k2><k3>{k3:?}</k3><k4>{k4:?}</k4>\
             <p1>{p1:?}</p1><p2>{p2:?}</p2></calibration></sensor>",
            k.fy,
            k.cx + 0.5 - 0.5 * f64::from(WIDTH),
            k.cy + 0.5 - 0.5 * f64::from(HEIGHT),
            k.fx - k.fy
        );
        let transform = world_from_camera.rotation.transpose();
        let c: Vector3<f64> = world_from_camera.translation;
        let r = transform.as_slice();
        let rows = [&r[..3], &[c.x], &r[3..6], &[c.y], &r[6..], &[c.z], &[0.0, 0.0, 0.0, 1.0]].concat();
        cameras += &format!(
            "<camera id=\"{i}\" sensor_id=\"{i}\" label=\"{id}.jpg\"><transform>{}</transform></camera>",
            spaced(&rows)
        );
    }
    let text = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<document version=\"1.5.0\"><chunk label=\"c\"><sensors>{sensors}\
         </sensors><cameras>{cameras}</cameras></chunk></document>"
    );
    vec![("cameras.xml".to_owned(), text.into_bytes())]
}

/// `resolution`: height of the videos; `first`: first pixel of the recorded part of the sensor, right and down.
fn qualisys(dist: Distortion, resolution: f64, first: [f64; 2]) -> Files {
    let mut cameras = String::new();
    let scale = resolution / 1080.0;
    for (id, camera) in rig(dist) {
        let (k, centre) = (&camera.intrinsics, camera.pose.inverse().translation * 1000.0);
        let on_sensor = |px: f64, first: f64| ((px + 0.5) / scale + first) * 64.0 - 0.5;
        let last = |first: f64, size: u32| first + f64::from(size) / scale - 1.0;
        let [k1, k2, p1, p2, k3] = match dist {
            Distortion::OpenCv5(coefficients) => coefficients,
            _ => [0.0; 5],
        };
        let mut pose = format!("x=\"{:?}\" y=\"{:?}\" z=\"{:?}\"", centre.x, centre.y, centre.z);
        for (i, entry) in row_major(&camera).iter().enumerate() {
            // Its y axis is up, its z axis backwards.
            let sign = if i < 3 { 1.0 } else { -1.0 };
            pose += &format!(" r{}{}=\"{:?}\"", i / 3 + 1, i % 3 + 1, sign * entry);
        }
        cameras += &format!(
            "<camera active=\"1\" serial=\"{id}\" model=\"Miqus Video\" viewrotation=\"0\" video_resolution=\"{resolution}p\">\
             <fov_video left=\"{:?}\" top=\"{:?}\" right=\"{:?}\" bottom=\"{:?}\"/><transform {pose}/>\
             <intrinsic focalLengthU=\"{:?}\" focalLengthV=\"{:?}\" centerPointU=\"{:?}\" centerPointV=\"{:?}\" skew=\"0\" \
             radialDistortion1=\"{k1:?}\" radialDistortion2=\"{k2:?}\" radialDistortion3=\"{k3:?}\" \
             tangentalDistortion1=\"{p1:?}\" tangentalDistortion2=\"{p2:?}\"/></camera>",
            first[0],
            first[1],
            last(first[0], WIDTH),
            last(first[1], HEIGHT),
            64.0 * k.fx / scale,
            64.0 * k.fy / scale,
            on_sensor(k.cx, first[0]),
            on_sensor(k.cy, first[1]),
        );
    }
    // A marker camera records no video and is left out.
    let marker = "<camera active=\"1\" serial=\"9\" model=\"Miqus M3\" viewrotation=\"0\"/>";
    let text = format!(
        "<?xml version=\"1.0\"?>\n<calibration qtm-version=\"2024.3\" type=\"regular\"><cameras>{marker}{cameras}</cameras></calibration>"
    );
    vec![("take.qca.txt".to_owned(), text.into_bytes())]
}

fn dmmr() -> Files {
    let mut text = String::new();
    for (i, (_, camera)) in rig(Distortion::None).into_iter().enumerate() {
        let (k, r, t) = (matrix(&camera), row_major(&camera), translation(&camera));
        text += &format!("{}\n", i + 1);
        k.chunks(3).for_each(|row| text += &format!("{}\n", spaced(row)));
        text += "0 0\n";
        (0..3).for_each(|i| text += &format!("{} {:?}\n", spaced(&r[3 * i..3 * i + 3]), t[i]));
        text += "\n";
    }
    vec![("camparams.txt".to_owned(), text.into_bytes())]
}

pub(crate) fn native(dist: Distortion, change: impl Fn(&mut serde_json::Value)) -> (String, Vec<u8>) {
    let cameras: Vec<serde_json::Value> = rig(dist)
        .into_iter()
        .map(|(id, camera)| {
            let rows = |numbers: Vec<f64>| numbers.chunks(3).map(<[f64]>::to_vec).collect::<Vec<_>>();
            let mut value = json!({
                "id": id, "width": WIDTH, "height": HEIGHT, "K": rows(matrix(&camera)), "dist": dist.coefficients(),
                "distortion_model": dist.name(), "R": rows(row_major(&camera)), "t": translation(&camera)
            });
            change(&mut value);
            value
        })
        .collect();
    ("session.json".to_owned(), json!({"fps": 50, "cameras": cameras}).to_string().into_bytes())
}

fn with_poses(calibration: Files) -> Files {
    let poses = openpose(&COCO17).into_iter().filter(|(name, _)| name.contains("keypoints"));
    calibration.into_iter().chain(poses).collect()
}

/// The largest distance, px, between the read cameras' pixels and those of the rig they were written from.
fn largest_difference_px(loaded: &LoadedSession, dist: Distortion, has_poses: bool) -> f64 {
    let mut largest: f64 = 0.0;
    for (view, (_, truth)) in loaded.session.views.iter().zip(rig(dist)) {
        assert_eq!(view.camera_from_world.is_some(), has_poses);
        let pose = view.camera_from_world.unwrap_or(truth.pose);
        assert_eq!((view.intrinsics.width, view.intrinsics.height), (WIDTH, HEIGHT));
        for x in [-1.0, -0.3, 0.4, 0.9] {
            for y in [0.1, 1.0, 1.9] {
                let point = Vector3::new(x, y, 0.5 * x - 0.2 * y);
                let expected = truth.intrinsics.pixel_from_camera(&truth.pose.transform(&point)).unwrap();
                let found = view.intrinsics.pixel_from_camera(&pose.transform(&point)).unwrap();
                largest = largest.max((found - expected).norm());
            }
        }
    }
    largest
}

#[test]
fn every_calibration_projects_like_its_source() {
    let none = Distortion::None;
    let cases: Vec<(&str, Files, Distortion, bool)> = vec![
        ("opencv_yaml", opencv_yaml(OPENCV5, false), OPENCV5, true),
        ("opencv_yaml", opencv_yaml(RATIONAL, true), RATIONAL, true),
        ("toml", toml(OPENCV5, 5, "cam_#", 1.0, ""), OPENCV5, true),
        ("toml", toml(OPENCV4, 4, "cam_#", 1.0, ""), OPENCV4, true),
        ("toml", toml(FISHEYE, 4, "cam_#", 1.0, ""), FISHEYE, true),
        ("toml", toml(OPENCV5, 5, "cameras.#", 1.0, "cam_id = 7\nrotation_count = 0\ngrid_count = 9"), OPENCV5, true),
        ("toml", toml(OPENCV5, 5, "cam_#", 1000.0, "world_position = [0.0, 0.0, 0.0]"), OPENCV5, true),
        ("colmap", colmap(none), none, true),
        ("colmap", colmap(OPENCV4), OPENCV4, true),
        ("colmap", colmap(RATIONAL), RATIONAL, true),
        ("colmap", colmap(FISHEYE), FISHEYE, true),
        ("ros_camera_info", ros(OPENCV5), OPENCV5, false),
        ("ros_camera_info", ros(RATIONAL), RATIONAL, false),
        ("ros_camera_info", ros(FISHEYE), FISHEYE, false),
        ("agisoft_xml", agisoft(OPENCV5), OPENCV5, true),
        ("agisoft_xml", agisoft(FISHEYE), FISHEYE, true),
        ("qualisys_qca", qualisys(Distortion::None, 1080.0, [0.0, 0.0]), Distortion::None, true),
        ("qualisys_qca", qualisys(OPENCV5, 540.0, [64.0, 32.0]), OPENCV5, true),
        ("native", vec![native(RATIONAL, |_| {})], RATIONAL, true),
        ("native", vec![native(FISHEYE, |_| {})], FISHEYE, true),
    ];
    for (name, files, dist, has_poses) in cases {
        let loaded = read(&with_poses(files)).unwrap_or_else(|e| panic!("{name} {dist:?}: {e}"));
        assert_eq!(loaded.format, format!("openpose with {name}"));
        let difference = largest_difference_px(&loaded, dist, has_poses);
        assert!(difference < 1e-6, "{name} {dist:?}: {difference} px");
    }
}

#[test]
fn cameras_without_an_image_size_need_one_from_elsewhere() {
    assert_eq!(read(&with_poses(dmmr())).unwrap_err().code, "image_size_unknown");
    let sizes: Vec<_> = (1..=3).map(|i| json!({"id": i.to_string(), "width": WIDTH, "height": HEIGHT})).collect();
    let header = ("session.json".to_owned(), json!({"fps": 25, "cameras": sizes}).to_string().into_bytes());
    let loaded = read(&with_poses([dmmr(), vec![header]].concat())).unwrap();
    assert_eq!(loaded.format, "openpose with dmmr_camparams");
    assert!(largest_difference_px(&loaded, Distortion::None, true) < 1e-6);
}

#[test]
fn warns_about_values_that_a_format_lacks() {
    let assert_warns = |files: Files, part: &str| {
        let warnings = read(&with_poses(files)).unwrap().warnings;
        assert!(warnings.iter().any(|line| line.contains(part)), "{part}: {warnings:?}");
    };
    assert_warns(toml(OPENCV4, 4, "cam_#", 1.0, ""), "a k3 of the lens, if any, is missing");
    assert_warns(
        toml(OPENCV5, 5, "cam_#", 1000.0, "world_position = [0.0, 0.0, 0.0]"),
        "FreeMoCap's: its translations are read as millimetres",
    );
    assert_warns(toml(OPENCV5, 5, "cam_#", 1.0, "rotation_count = 1"), "rotation_count 1");
    assert_warns(colmap(Distortion::None), "COLMAP's poses have no unit");
    let mut turned = qualisys(OPENCV5, 1080.0, [0.0, 0.0]);
    turned[0].1 = String::from_utf8(turned[0].1.clone())
        .unwrap()
        .replacen("rotation=\"0\" video", "rotation=\"90\" video", 1)
        .into_bytes();
    assert_warns(turned, "Track Manager shows its video turned");
    let refused = |files: Files| read(&with_poses(files)).map_err(|e| e.code).unwrap_err();
    let fov = b"1 FOV 1280 720 800 800 640 360 0.9\n".to_vec();
    assert_eq!(refused(vec![("cameras.txt".to_owned(), fov)]), "distortion_unsupported");
    let mut k4 = agisoft(OPENCV5);
    k4[0].1 = String::from_utf8(k4[0].1.clone()).unwrap().replace("<k4>0.0", "<k4>0.1").into_bytes();
    assert_eq!(refused(k4), "distortion_unsupported");
}

#[test]
fn scales_the_calibration_to_the_keypoints_image_size() {
    let mut files = crate::dialects::easymocap(false);
    files[1].1 = String::from_utf8(files[1].1.clone()).unwrap().replace("1280.0, 720.0", "2560.0, 1440.0").into_bytes();
    let loaded = read(&files).unwrap();
    let fx = loaded.session.views[0].intrinsics.fx;
    assert_eq!((loaded.session.views[0].intrinsics.width, fx), (WIDTH, 0.5 * 800.5));
    assert!(loaded.warnings.iter().any(|line| line.contains("calibrated at 2560x1440")), "{:?}", loaded.warnings);
    files[1].1 = String::from_utf8(files[1].1.clone()).unwrap().replace("2560.0, 1440.0", "720.0, 1280.0").into_bytes();
    let error = read(&files).unwrap_err();
    assert_eq!(error.code, "camera_invalid");
    assert!(error.detail.contains("rotated"), "{}", error.detail);
}

/// Of two calibrations of one camera the second had been dropped without a word: two cameras had become one.
#[test]
fn two_calibrations_of_one_camera_were_merged_silently() {
    let first = toml(OPENCV5, 5, "cam_#", 1.0, "");
    let text = String::from_utf8(first[0].1.clone()).unwrap();
    let second = |text: String| vec![("other/Calib.toml".to_owned(), text.into_bytes())];
    let error = read(&with_poses([first.clone(), second(text.replace("800.5", "900.5"))].concat())).unwrap_err();
    let place = (error.code, error.file.as_deref(), error.camera.as_deref());
    assert_eq!(place, ("calibration_invalid", Some("other/Calib.toml"), Some("cam1")));
    assert!(error.detail.contains("K ") && error.detail.contains("calibration.toml"), "{error}");
    let same = second(text.replace("800.5", "800.5001"));
    assert!(largest_difference_px(&read(&with_poses([first, same].concat())).unwrap(), OPENCV5, true) < 1e-6);
}

/// ROS's calibration tool writes one `camera_name` into the files of all cameras.
#[test]
fn cameras_of_ros_with_one_name_became_one_camera() {
    let renamed = |change: fn(&str) -> String| {
        let file = |(name, content): (String, Vec<u8>)| {
            let mut text = String::from_utf8(content).unwrap();
            CAMERAS
                .iter()
                .for_each(|id| text = text.replace(&format!("camera_name: {id}"), "camera_name: narrow_stereo"));
            (change(&name), text.into_bytes())
        };
        with_poses(ros(OPENCV5).into_iter().map(file).collect())
    };
    for files in [renamed(str::to_owned), renamed(|name| name.replace(".yaml", "/ost.yaml"))] {
        assert!(largest_difference_px(&read(&files).unwrap(), OPENCV5, false) < 1e-6);
    }
}

/// A camera without K beside cameras with K had been thrown away, though its focal length is estimated.
#[test]
fn poses_of_a_camera_without_k_were_ignored() {
    let without_k = |size: [u32; 2]| {
        let change = move |camera: &mut serde_json::Value| {
            if camera["id"] == "cam3" {
                *camera = json!({"id": "cam3", "width": size[0], "height": size[1]});
            }
        };
        read(&with_poses(vec![native(Distortion::None, change)]))
    };
    let loaded = without_k([WIDTH, HEIGHT]).unwrap();
    let known: Vec<bool> = loaded.session.views.iter().map(|view| view.has_intrinsics).collect();
    assert_eq!(known, [true, true, false], "{:?}", loaded.warnings);
    let error = without_k([0, 0]).unwrap_err();
    assert_eq!((error.code, error.camera.as_deref()), ("image_size_unknown", Some("cam3")));
}

/// Without a calibration both were named `annotations`, and the upload refused for an id that its sender had never written.
#[test]
fn files_of_one_name_in_folders_were_one_camera() {
    let images = |frames: std::ops::Range<i64>| {
        let image = |id: i64| json!({"id": id, "file_name": format!("{id:06}.jpg"), "width": WIDTH, "height": HEIGHT});
        frames.map(image).collect::<Vec<_>>()
    };
    let file = |(i, id): (usize, &&str)| {
        let annotation = |frame: i64| {
            let keypoints: Vec<f64> = people(i, frame, &COCO17)[0].iter().flatten().copied().collect();
            json!({"id": frame, "image_id": frame, "category_id": 1, "keypoints": keypoints})
        };
        let annotations: Vec<_> = (0..4).map(annotation).collect();
        // Tools write the images first, whose sizes the annotations need.
        let document = format!(r#"{{"images": {}, "annotations": {}}}"#, json!(images(0..4)), json!(annotations));
        (format!("{id}/annotations.json"), document.into_bytes())
    };
    let loaded = read(&CAMERAS.iter().enumerate().map(file).collect()).unwrap();
    assert_eq!(loaded.session.views.iter().map(|view| view.id.as_str()).collect::<Vec<_>>(), CAMERAS);
    assert!(loaded.warnings.iter().any(|line| line.contains("poses of \"cam1\"")), "{:?}", loaded.warnings);
}

/// What OpenCV's calibration program writes was read as EasyMocap's file and refused for its missing names.
#[test]
fn opencvs_own_calibration_was_refused() {
    let file = |(name, content): (String, Vec<u8>)| {
        let text = String::from_utf8(content).unwrap();
        let (text, is_named) =
            (text.replace("matrix:\n", "matrix: !!opencv-matrix\n"), |l: &&str| !l.starts_with("camera_name"));
        let lines: Vec<&str> = text.lines().filter(is_named).filter(|l| !l.starts_with("distortion_model")).collect();
        (name, format!("%YAML:1.0\n---\ncalibration_time: \"Mon\"\n{}\n", lines.join("\n")).into_bytes())
    };
    let files = with_poses(ros(OPENCV5).into_iter().map(file).collect());
    assert!(largest_difference_px(&read(&files).unwrap(), OPENCV5, false) < 1e-6);
}

/// A quaternion was dropped without a word, and `t` then said to be given without R.
#[test]
fn a_rotation_of_four_numbers_was_dropped() {
    let change = |files: Files, from: &str, to: &str| {
        let file = |(name, content): (String, Vec<u8>)| {
            (name, String::from_utf8(content).unwrap().replacen(from, to, 1).into_bytes())
        };
        let error = read(&with_poses(files.into_iter().map(file).collect())).unwrap_err();
        assert_eq!(error.code, "calibration_invalid");
        error.to_string()
    };
    let error = change(toml(OPENCV5, 5, "cam_#", 1.0, ""), "rotation = [", "rotation = [0.0, ");
    assert!(error.contains("camera \"cam_0\"") && error.contains("`rotation` has 4 numbers, expected 3"), "{error}");
    let (from, to) = (
        "R_cam1: !!opencv-matrix\r\n   rows: 3\r\n   cols: 1\r\n   dt: d\r\n   data: [ ",
        "R_cam1:\r\n   data: [ 0.0, ",
    );
    assert!(change(opencv_yaml(OPENCV5, true), from, to).contains("R_cam1 has 4 numbers"));
}

/// One set of files per calibration format, for damage.
pub(crate) fn damaged_sets() -> Vec<Files> {
    let calibrations = [
        opencv_yaml(OPENCV5, false),
        toml(OPENCV5, 5, "cameras.#", 1.0, "rotation_count = 0"),
        colmap(RATIONAL),
        ros(FISHEYE),
        agisoft(OPENCV5),
        dmmr(),
        vec![native(RATIONAL, |_| {})],
    ];
    calibrations.into_iter().map(with_poses).collect()
}
