//! The glb, parsed and posed according to the specification of glTF 2.0.

use crate::result::{
    FIRST_FRAME, FPS, N_FRAMES, Written, assert_near, assert_same_skin, both_up_axes, centred, numbers,
};
use nalgebra::{Isometry3, Matrix4, Point3, Quaternion, Translation3, UnitQuaternion, Vector2, Vector3};
use serde_json::Value;
use std::fs;
use wandless::body::skeleton::JOINT_NAMES;
use wandless::session::reconstruction::ExportFormat;
use wandless::session::recording::UpAxis;

/// A channel of an animation with the values of its sampler.
struct Channel {
    node: usize,
    path: String,
    is_step: bool,
    times: Vec<f64>,
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

    /// The numbers of an accessor, in rows.
    fn rows(&self, accessor: &Value) -> Vec<Vec<f64>> {
        let accessor = &self.root["accessors"][accessor.as_u64().unwrap() as usize];
        let (n_bytes, number): (usize, fn(&[u8]) -> f64) = match accessor["componentType"].as_u64().unwrap() {
            5121 => (1, |b| f64::from(b[0])),
            5125 => (4, |b| f64::from(u32::from_le_bytes(b.try_into().unwrap()))),
            _ => (4, |b| f64::from(f32::from_le_bytes(b.try_into().unwrap()))),
        };
        let width = match accessor["type"].as_str().unwrap() {
            "SCALAR" => 1,
            "VEC3" => 3,
            "VEC4" => 4,
            _ => 16,
        };
        let view = &self.root["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let [start, length] = ["byteOffset", "byteLength"].map(|key| view[key].as_u64().unwrap() as usize);
        let values: Vec<f64> = self.binary[start..start + length].chunks_exact(n_bytes).map(number).collect();
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
    fn local(&self, node: usize, animated: Animated<'_>) -> Matrix4<f64> {
        let still = |path: &str| Some(&self.nodes()[node][path]).filter(|v| v.is_array()).map(numbers);
        let value = |path: &str| animated(node, path).or_else(|| still(path));
        let t = value("translation").unwrap_or_else(|| vec![0.0; 3]);
        let q = value("rotation").unwrap_or_else(|| vec![0.0, 0.0, 0.0, 1.0]);
        let s = value("scale").unwrap_or_else(|| vec![1.0; 3]);
        let rigid = Isometry3::from_parts(
            Translation3::new(t[0], t[1], t[2]),
            UnitQuaternion::from_quaternion(Quaternion::new(q[3], q[0], q[1], q[2])),
        );
        rigid.to_homogeneous() * Matrix4::new_nonuniform_scaling(&Vector3::from_vec(s))
    }

    fn world(&self, node: usize, animated: Animated<'_>) -> Matrix4<f64> {
        let local = self.local(node, animated);
        self.parent(node).map_or(local, |parent| self.world(parent, animated) * local)
    }

    fn channels(&self) -> Vec<Channel> {
        let animation = &self.root["animations"][0];
        let channel = |channel: &Value| {
            let sampler = &animation["samplers"][channel["sampler"].as_u64().unwrap() as usize];
            let target = &channel["target"];
            let (times, values) = (self.rows(&sampler["input"]), self.rows(&sampler["output"]));
            Channel {
                node: target["node"].as_u64().unwrap() as usize,
                path: target["path"].as_str().unwrap().to_owned(),
                is_step: sampler["interpolation"] == "STEP",
                times: times.iter().map(|row| row[0]).collect(),
                values,
            }
        };
        animation["channels"].as_array().unwrap().iter().map(channel).collect()
    }

    fn skin(&self, person: usize) -> &Value {
        let skins = self.root["skins"].as_array().unwrap();
        skins.iter().find(|skin| skin["name"] == format!("person_{person}")).unwrap()
    }
}

/// Animated values by node and path.
type Animated<'a> = &'a dyn Fn(usize, &str) -> Option<Vec<f64>>;

impl Channel {
    /// The value at a key of every frame, or the last step.
    fn at(&self, index: usize) -> Vec<f64> {
        let secs = index as f64 / FPS;
        if self.is_step {
            let last = self.times.iter().rposition(|time| *time <= secs).unwrap_or(0);
            return self.values[last].clone();
        }
        assert_eq!(self.times.len(), N_FRAMES, "all people share one clock");
        assert!((self.times[index] - secs).abs() < 1e-5);
        self.values[index].clone()
    }
}

/// Animated values at a frame of the time line.
fn posed(channels: &[Channel], index: usize) -> impl Fn(usize, &str) -> Option<Vec<f64>> {
    move |node, path| channels.iter().find(|c| c.node == node && c.path == path).map(|channel| channel.at(index))
}

#[test]
fn joints_match_the_result() {
    for written in both_up_axes(&[ExportFormat::Glb]) {
        let glb = Glb::read(&written);
        let channels = glb.channels();
        for person in written.people() {
            let root = glb.node(&format!("person_{}", person.id));
            assert_eq!(glb.nodes()[root]["extras"]["frame_presence"][0], person.frames[0]);
            let carried = &glb.nodes()[root]["extras"]["carried"][0];
            assert_eq!((&carried[0], &carried[1]), (&(person.frames[5]).into(), &(person.frames[7]).into()));
            let joints: Vec<usize> = numbers(&glb.skin(person.id)["joints"]).iter().map(|j| *j as usize).collect();
            for index in 0..N_FRAMES {
                let animated = posed(&channels, index);
                let (is_present, i) = person.at(FIRST_FRAME + index as i64);
                for (j, node) in joints.iter().enumerate() {
                    assert_eq!(glb.nodes()[*node]["name"], JOINT_NAMES[j]);
                    let place = glb.world(*node, &animated).column(3).xyz();
                    let expected = written.turned(UpAxis::Y, &person.joints[i][j]);
                    assert_near(&(if is_present { expected } else { Vector3::zeros() }), &place, JOINT_NAMES[j]);
                }
            }
        }
    }
}

#[test]
fn skinned_vertices_match_the_body() {
    for written in both_up_axes(&[ExportFormat::Glb]) {
        let glb = Glb::read(&written);
        let channels = glb.channels();
        for person in written.people() {
            let skin = glb.skin(person.id);
            let mesh = &glb.nodes()[glb.node(&format!("person_{}_body", person.id))]["mesh"];
            let primitive = &glb.root["meshes"][mesh.as_u64().unwrap() as usize]["primitives"][0];
            let attribute = |name: &str| glb.rows(&primitive["attributes"][name]);
            let [rest, joints, weights] = ["POSITION", "JOINTS_0", "WEIGHTS_0"].map(attribute);
            let inverse_bind = glb.rows(&skin["inverseBindMatrices"]);
            for (i, frame) in person.frames.iter().enumerate().step_by(9) {
                let animated = posed(&channels, (frame - FIRST_FRAME) as usize);
                let nodes = numbers(&skin["joints"]);
                let world_from_rest: Vec<Matrix4<f64>> = nodes
                    .iter()
                    .zip(&inverse_bind)
                    .map(|(node, inverse)| glb.world(*node as usize, &animated) * Matrix4::from_column_slice(inverse))
                    .collect();
                let vertex = |v: usize| -> Vector3<f64> {
                    let place = Vector3::from_column_slice(&rest[v]).push(1.0);
                    let shares = joints[v].iter().zip(&weights[v]);
                    shares.map(|(joint, weight)| (world_from_rest[*joint as usize] * place).xyz() * *weight).sum()
                };
                let vertices: Vec<Vector3<f64>> = (0..rest.len()).map(vertex).collect();
                assert_same_skin(&written, &person.skin(i), &vertices, "glb");
            }
            let corners = glb.rows(&primitive["indices"]);
            assert!(corners.iter().flatten().all(|corner| (*corner as usize) < rest.len()));
        }
    }
}

#[test]
fn skins_are_bound_in_the_rest_pose_of_the_nodes() {
    let [written, _] = both_up_axes(&[ExportFormat::Glb]);
    let glb = Glb::read(&written);
    for skin in glb.root["skins"].as_array().unwrap() {
        let inverse = glb.rows(&skin["inverseBindMatrices"]);
        for (matrix, node) in inverse.iter().zip(numbers(&skin["joints"])) {
            let world = glb.world(node as usize, &|_, _| None);
            let product = world * Matrix4::from_column_slice(matrix);
            assert!((product - Matrix4::identity()).norm() < 1e-5, "{product}");
        }
    }
}

#[test]
fn cameras_project_like_cameras_json() {
    for written in both_up_axes(&[ExportFormat::Glb]) {
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
            let camera_from_world = glb.world(node, &|_, _| None).try_inverse().unwrap();
            let (width, height) = (f64::from(camera.lens.width), f64::from(camera.lens.height));
            let project = |point: &Vector3<f64>| {
                let p = camera_from_world.transform_point(&Point3::from(written.turned(UpAxis::Y, point)));
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
