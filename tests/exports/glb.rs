//! The glb, parsed and posed according to the specification of glTF 2.0.

use crate::result::{FIRST_FRAME, FPS, Written, assert_near, both_up_axes, centred, numbers};
use nalgebra::{Isometry3, Matrix4, Point3, Quaternion, Translation3, UnitQuaternion, Vector2, Vector3};
use serde_json::Value;
use std::fs;
use wandless::body::skeleton::JOINT_NAMES;
use wandless::session::recording::UpAxis;

/// A channel of an animation with the values of its sampler.
struct Channel {
    node: usize,
    path: String,
    times: Vec<Vec<f64>>,
    values: Vec<Vec<f64>>,
}

struct Glb {
    root: Value,
    binary: Vec<u8>,
}

impl Glb {
    fn read(written: &Written) -> Self {
        let bytes = fs::read(written.path("scene.glb")).unwrap();
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((&bytes[..4], word(4), word(8)), (&b"glTF"[..], 2, bytes.len()));
        let n_json = word(12);
        assert_eq!((n_json % 4, &bytes[16..20]), (0, &b"JSON"[..]));
        let binary = 20 + n_json;
        assert_eq!(&bytes[binary + 4..binary + 8], b"BIN\0");
        assert_eq!(binary + 8 + word(binary), bytes.len());
        Self { root: serde_json::from_slice(&bytes[20..binary]).unwrap(), binary: bytes[binary + 8..].to_vec() }
    }

    /// The floats of an accessor, in rows.
    fn floats(&self, accessor: &Value) -> Vec<Vec<f64>> {
        let accessor = &self.root["accessors"][accessor.as_u64().unwrap() as usize];
        assert_eq!(accessor["componentType"], 5126);
        let width = match accessor["type"].as_str().unwrap() {
            "SCALAR" => 1,
            "VEC3" => 3,
            "VEC4" => 4,
            _ => 16,
        };
        let view = &self.root["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let [start, length] = ["byteOffset", "byteLength"].map(|key| view[key].as_u64().unwrap() as usize);
        let values: Vec<f64> = self.binary[start..start + length]
            .chunks_exact(4)
            .map(|b| f64::from(f32::from_le_bytes(b.try_into().unwrap())))
            .collect();
        assert_eq!(values.len(), width * accessor["count"].as_u64().unwrap() as usize);
        values.chunks(width).map(<[f64]>::to_vec).collect()
    }

    fn node(&self, name: &str) -> usize {
        self.nodes().iter().position(|node| node["name"] == name).unwrap()
    }

    fn nodes(&self) -> &Vec<Value> {
        self.root["nodes"].as_array().unwrap()
    }

    fn parent(&self, node: usize) -> Option<usize> {
        let holds = |parent: &Value| parent["children"].as_array().is_some_and(|c| c.contains(&node.into()));
        self.nodes().iter().position(holds)
    }

    /// The transform `parent_from_node`, with its animated values.
    fn local(&self, node: usize, animated: &dyn Fn(usize, &str) -> Option<Vec<f64>>) -> Isometry3<f64> {
        let still = |path: &str| Some(&self.nodes()[node][path]).filter(|v| v.is_array()).map(numbers);
        let value = |path: &str| animated(node, path).or_else(|| still(path));
        let t = value("translation").unwrap_or_else(|| vec![0.0; 3]);
        let q = value("rotation").unwrap_or_else(|| vec![0.0, 0.0, 0.0, 1.0]);
        Isometry3::from_parts(
            Translation3::new(t[0], t[1], t[2]),
            UnitQuaternion::from_quaternion(Quaternion::new(q[3], q[0], q[1], q[2])),
        )
    }

    fn world(&self, node: usize, animated: &dyn Fn(usize, &str) -> Option<Vec<f64>>) -> Isometry3<f64> {
        let local = self.local(node, animated);
        self.parent(node).map_or(local, |parent| self.world(parent, animated) * local)
    }
}

#[test]
fn joints_match_the_result() {
    for written in both_up_axes() {
        let glb = Glb::read(&written);
        let animation = &glb.root["animations"][0];
        let channels: Vec<Channel> = animation["channels"]
            .as_array()
            .unwrap()
            .iter()
            .map(|channel| {
                let sampler = &animation["samplers"][channel["sampler"].as_u64().unwrap() as usize];
                let target = &channel["target"];
                let node = target["node"].as_u64().unwrap() as usize;
                let (times, values) = (glb.floats(&sampler["input"]), glb.floats(&sampler["output"]));
                Channel { node, path: target["path"].as_str().unwrap().to_owned(), times, values }
            })
            .collect();
        for person in written.people() {
            let root = glb.node(&format!("person_{}", person.id));
            assert_eq!(glb.nodes()[root]["extras"]["frame_presence"][0], person.frames[0]);
            let carried = &glb.nodes()[root]["extras"]["carried"][0];
            assert_eq!((&carried[0], &carried[1]), (&(person.frames[5]).into(), &(person.frames[7]).into()));
            let skins = glb.root["skins"].as_array().unwrap();
            let skin = skins.iter().find(|s| s["name"] == format!("person_{}", person.id)).unwrap();
            let joints: Vec<usize> = numbers(&skin["joints"]).iter().map(|j| *j as usize).collect();
            for (i, frame) in person.frames.iter().enumerate() {
                let animated = |node: usize, path: &str| {
                    let channel = channels.iter().find(|c| c.node == node && c.path == path)?;
                    assert!((channel.times[i][0] - (frame - FIRST_FRAME) as f64 / FPS).abs() < 1e-5);
                    Some(channel.values[i].clone())
                };
                for (j, node) in joints.iter().enumerate() {
                    assert_eq!(glb.nodes()[*node]["name"], JOINT_NAMES[j]);
                    let position = glb.world(*node, &animated).translation.vector;
                    assert_near(&written.turned(UpAxis::Y, &person.joints[i][j]), &position, JOINT_NAMES[j]);
                }
            }
        }
    }
}

#[test]
fn skins_are_bound_in_the_rest_pose_of_the_nodes() {
    let [written, _] = both_up_axes();
    let glb = Glb::read(&written);
    for skin in glb.root["skins"].as_array().unwrap() {
        let inverse = glb.floats(&skin["inverseBindMatrices"]);
        for (matrix, node) in inverse.iter().zip(numbers(&skin["joints"])) {
            let world = glb.world(node as usize, &|_, _| None).to_homogeneous();
            let product = world * Matrix4::from_column_slice(matrix);
            assert!((product - Matrix4::identity()).norm() < 1e-5, "{product}");
        }
    }
}

#[test]
fn cameras_project_like_cameras_json() {
    for written in both_up_axes() {
        let glb = Glb::read(&written);
        for camera in written.cameras() {
            let node = glb.node(&camera.id);
            let extras = &glb.nodes()[node]["extras"];
            assert_eq!(
                (&extras["K"][0][2], numbers(&extras["dist"])),
                (&camera.lens.cx.into(), camera.lens.dist.coefficients().to_vec())
            );
            assert_eq!(extras["distortion_model"], camera.lens.dist.name());
            let number = glb.nodes()[node]["camera"].as_u64().unwrap() as usize;
            let perspective = &glb.root["cameras"][number]["perspective"];
            let [yfov, aspect] = ["yfov", "aspectRatio"].map(|key| perspective[key].as_f64().unwrap());
            let camera_from_world = glb.world(node, &|_, _| None).inverse();
            let (width, height) = (f64::from(camera.lens.width), f64::from(camera.lens.height));
            let project = |point: &Vector3<f64>| {
                let p = camera_from_world * Point3::from(written.turned(UpAxis::Y, point));
                let tan = (yfov / 2.0).tan();
                let (x, y) = (p.x / -p.z / (tan * aspect), p.y / -p.z / tan); // -1 to 1
                Vector2::new((x + 1.0) * width / 2.0 - 0.5, (1.0 - y) * height / 2.0 - 0.5)
            };
            let hold = |lens: &mut wandless::geometry::Intrinsics| {
                centred(lens);
                (lens.skew, lens.dist) = (0.0, wandless::geometry::Distortion::None);
            };
            written.assert_projects(&camera, hold, project);
        }
    }
}
