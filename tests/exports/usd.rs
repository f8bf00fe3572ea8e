//! The `.usda` file, parsed line by line and posed as UsdSkel does.

use crate::result::{Written, assert_near, assert_same_skin, both_up_axes};
use nalgebra::{Isometry3, Matrix4, Quaternion, Translation3, UnitQuaternion, Vector2, Vector3, Vector4};
use std::collections::BTreeMap;
use wandless::body::skeleton::JOINT_NAMES;
use wandless::geometry::Intrinsics;
use wandless::session::reconstruction::ExportFormat;
use wandless::session::recording::UpAxis;

#[test]
fn the_package_holds_the_same_scene() {
    let [written, _] = both_up_axes(&[ExportFormat::Usd]);
    let mut package = zip::ZipArchive::new(std::fs::File::open(written.path("scene.usdz")).unwrap()).unwrap();
    assert_eq!(package.len(), 1);
    let mut member = package.by_index(0).unwrap();
    assert_eq!(member.name().unwrap(), "scene.usda");
    assert_eq!(member.compression(), zip::CompressionMethod::Stored);
    let mut text = String::new();
    std::io::Read::read_to_string(&mut member, &mut text).unwrap();
    assert_eq!(text, written.text("scene.usda"));
}

/// Attributes by prim path and name: `World/person_0/person_0_skeleton` to name to text. Samples have the name `name@frame`.
fn attributes(text: &str) -> BTreeMap<String, BTreeMap<String, String>> {
    let mut prims: BTreeMap<String, BTreeMap<String, String>> = BTreeMap::new();
    let mut path: Vec<String> = Vec::new();
    let mut samples: Option<String> = None;
    let mut in_metadata = false;
    for line in text.lines().map(str::trim) {
        let prim = prims.entry(path.join("/")).or_default();
        if line.starts_with("def ") {
            path.push(line.split('"').nth(1).unwrap().to_owned());
            in_metadata = line.ends_with('(');
        } else if line == "(" || line == ")" || in_metadata {
            in_metadata = line != ")";
        } else if line == "}" {
            if samples.take().is_none() {
                path.pop().unwrap();
            }
        } else if let Some(name) = &samples {
            let (frame, value) = line.split_once(": ").unwrap();
            prim.insert(format!("{name}@{frame}"), value.trim_end_matches(',').to_owned());
        } else if let Some((declaration, value)) = line.split_once(" = ") {
            let name = declaration.rsplit(' ').next().unwrap();
            if value == "{" {
                samples = Some(name.trim_end_matches(".timeSamples").to_owned());
            } else {
                prim.insert(name.to_owned(), value.to_owned());
            }
        }
    }
    assert!(path.is_empty());
    prims
}

fn numbers(text: &str) -> Vec<f64> {
    let words = text.split(|c: char| "[](),".contains(c) || c.is_whitespace()).filter(|word| !word.is_empty());
    words.map(|word| word.parse().unwrap()).collect()
}

/// USD's matrices multiply row vectors from the right.
fn matrices(text: &str) -> Vec<Matrix4<f64>> {
    numbers(text).chunks(16).map(Matrix4::from_column_slice).collect()
}

#[test]
fn joints_and_vertices_match_the_result() {
    for written in both_up_axes(&[ExportFormat::Usd]) {
        let text = written.text("scene.usda");
        assert!(
            text.starts_with("#usda 1.0\n") && text.contains("upAxis = \"Y\"") && text.contains("metersPerUnit = 1\n")
        );
        assert!(text.contains("startTimeCode = 100\n    endTimeCode = 139\n    timeCodesPerSecond = 30.0"));
        let prims = attributes(&text);
        for person in written.people() {
            let path = format!("World/person_{0}/person_{0}_skeleton", person.id);
            let (skeleton, animation) = (&prims[&path], &prims[&format!("{path}/person_{}_animation", person.id)]);
            let mesh = &prims[&format!("World/person_{0}/person_{0}_body", person.id)];
            assert_eq!(mesh["skel:skeleton"], format!("</{path}>"));
            let [rest_vertices, joints_of, weights] =
                ["points", "primvars:skel:jointIndices", "primvars:skel:jointWeights"].map(|name| numbers(&mesh[name]));
            let paths: Vec<&str> = skeleton["joints"].split('"').skip(1).step_by(2).collect();
            assert_eq!(skeleton["joints"], animation["joints"]);
            let parent = |j: usize| paths[j].rsplit_once('/').map(|(p, _)| paths.iter().position(|q| *q == p).unwrap());
            let (bind, rest) = (matrices(&skeleton["bindTransforms"]), matrices(&skeleton["restTransforms"]));
            for (i, (frame, joints)) in person.frames.iter().zip(&person.joints).enumerate() {
                let turns = numbers(&animation[&format!("rotations@{frame}")]);
                let places = numbers(&animation[&format!("translations@{frame}")]);
                let mut posed: Vec<Isometry3<f64>> = Vec::new();
                for j in 0..24 {
                    assert!(paths[j].ends_with(JOINT_NAMES[j]));
                    let q = &turns[4 * j..];
                    let turn = UnitQuaternion::from_quaternion(Quaternion::new(q[0], q[1], q[2], q[3]));
                    let place = Translation3::new(places[3 * j], places[3 * j + 1], places[3 * j + 2]);
                    let local = Isometry3::from_parts(place, turn);
                    posed.push(parent(j).map_or(local, |p| posed[p] * local));
                    assert_near(&written.turned(UpAxis::Y, &joints[j]), &posed[j].translation.vector, paths[j]);
                }
                if i % 9 == 0 {
                    let world_from_rest: Vec<Matrix4<f64>> =
                        (0..24).map(|j| posed[j].to_homogeneous() * bind[j].try_inverse().unwrap()).collect();
                    let vertex = |v: usize| -> Vector3<f64> {
                        let place = Vector3::from_column_slice(&rest_vertices[3 * v..3 * v + 3]).push(1.0);
                        let share = |k: usize| (world_from_rest[joints_of[k] as usize] * place).xyz() * weights[k];
                        (4 * v..4 * v + 4).map(share).sum()
                    };
                    let vertices: Vec<Vector3<f64>> = (0..rest_vertices.len() / 3).map(vertex).collect();
                    assert_same_skin(&written, &person.skin(i), &vertices, "usd");
                }
            }
            for j in 0..24 {
                let world = parent(j).map_or(rest[j], |p| bind[p] * rest[j]);
                assert!((bind[j] - world).norm() < 1e-5, "the rest and bind poses of {} differ", paths[j]);
            }
        }
    }
}

#[test]
fn people_are_visible_while_present() {
    let [written, _] = both_up_axes(&[ExportFormat::Usd]);
    let prims = attributes(&written.text("scene.usda"));
    let of = |person: usize, name: &str| prims[&format!("World/person_{person}")][name].clone();
    assert_eq!(of(0, "visibility.timeSamples"), r#"{ 100: "inherited" }"#);
    assert_eq!(of(1, "visibility.timeSamples"), r#"{ 100: "invisible", 107: "inherited", 127: "invisible" }"#);
    assert_eq!(of(1, "userProperties:valid.timeSamples"), "{ 107: 1, 112: 0, 115: 1 }");
}

fn check_camera(written: &Written, prim: &BTreeMap<String, String>, camera: &crate::result::WrittenCamera) {
    let number = |name: &str| numbers(&prim[name])[0];
    let world_from_camera = matrices(&prim["xformOp:transform"])[0];
    let camera_from_world = world_from_camera.try_inverse().unwrap();
    let focal = number("focalLength");
    let (width, height) = (number("userProperties:width"), number("userProperties:height"));
    // GfCamera: the frustum covers the aperture around its offset.
    let (aperture_x, offset_x) = (number("horizontalAperture"), number("horizontalApertureOffset"));
    let (aperture_y, offset_y) = (number("verticalAperture"), number("verticalApertureOffset"));
    let project = |point: &Vector3<f64>| {
        let p = written.turned(UpAxis::Y, point);
        let p = camera_from_world * Vector4::new(p.x, p.y, p.z, 1.0);
        let (x, y) = (p.x / -p.z * focal, p.y / -p.z * focal);
        let (u, v) = ((x - offset_x) / aperture_x, (y - offset_y) / aperture_y); // -1/2 to 1/2
        Vector2::new((u + 0.5) * width - 0.5, (0.5 - v) * height - 0.5)
    };
    let hold = |lens: &mut Intrinsics| (lens.skew, lens.dist) = (0.0, wandless::geometry::Distortion::None);
    written.assert_projects(camera, hold, project);
    assert_eq!(prim["userProperties:distortion_model"], format!("{:?}", camera.lens.dist.name()));
    assert_eq!(numbers(&prim["userProperties:dist"]), camera.lens.dist.coefficients());
    assert_eq!(numbers(&prim["userProperties:K"])[2], camera.lens.cx);
}

#[test]
fn cameras_project_like_cameras_json() {
    for written in both_up_axes(&[ExportFormat::Usd]) {
        let prims = attributes(&written.text("scene.usda"));
        let names = ["camera_01", "camera_left_front", "camera_cam_c", "camera_kamera_4", "camera_wide", "camera_dome"];
        for (camera, name) in written.cameras().iter().zip(names) {
            check_camera(&written, &prims[&format!("World/{name}")], camera);
        }
    }
}
