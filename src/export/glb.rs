//! `scene.glb`: binary glTF 2.0 with a skinned skeleton and its animation per person and a node per camera.
//!
//! Metres, y up; time 0 s is the session's first frame. Every person has a skin whose joints are SMPL's, bound in the T-pose,
//! and a mesh of one small octahedron per bone that makes the skeleton visible. A glTF camera has neither principal point nor
//! distortion: `extras` of its node contain K, `distortion_model`, `dist` and the image size; those of a person's node
//! contain `frame_presence` and the frames in which no camera detected the person (`carried`), as frame numbers.

mod buffer;
mod sticks;

use super::files::{ResultFiles, micro};
use super::film::{vertical_view, world_from_film};
use super::rotation_forms::{quaternion_xyzw, quaternions_xyzw};
use super::take::{Take, TakeCamera, rest_joints};
use crate::body::skeleton::{JOINT_NAMES, N_JOINTS, PARENTS};
use crate::session::BodyMotion;
use crate::session::formats::{entries, rows};
use crate::session::recording::UpAxis;
use buffer::{Buffer, Element};
use serde_json::{Value, json};
use std::io;

/// Near clipping plane, m.
const NEAR: f64 = 0.01;

/// The arrays of a glTF document.
#[derive(Default)]
struct Document {
    buffer: Buffer,
    nodes: Vec<Value>,
    scene_nodes: Vec<usize>,
    skins: Vec<Value>,
    meshes: Vec<Value>,
    cameras: Vec<Value>,
    samplers: Vec<Value>,
    channels: Vec<Value>,
}

/// Writes the file.
pub(super) fn write(files: &mut ResultFiles, take: &Take) -> io::Result<()> {
    let take = take.with_up_axis(UpAxis::Y);
    let mut document = Document::default();
    for motion in &take.motions {
        document.add_person(&take, motion);
    }
    for camera in &take.cameras {
        document.add_camera(camera);
    }
    files.bytes("scene.glb", "model/gltf-binary", &document.finish(&take)?)
}

impl Document {
    fn add_node(&mut self, node: Value) -> usize {
        self.nodes.push(node);
        self.nodes.len() - 1
    }

    fn add_person(&mut self, take: &Take, motion: &BodyMotion) {
        let rest = rest_joints(motion);
        let root = self.nodes.len();
        let pelvis = root + 1; // joint j is node pelvis + j
        let id = motion.person.0;
        self.scene_nodes.push(root);
        self.add_node(json!({
            "name": format!("person_{id}"),
            "children": [pelvis],
            "extras": {
                "frame_presence": take.presence(motion),
                "carried": carried_ranges(take, motion),
                "betas": motion.betas,
            },
        }));
        for joint in 0..N_JOINTS {
            let offset = PARENTS[joint].map_or(rest[joint], |parent| rest[joint] - rest[parent]);
            let children: Vec<usize> =
                (0..N_JOINTS).filter(|&c| PARENTS[c] == Some(joint)).map(|c| pelvis + c).collect();
            let mut node = json!({ "name": JOINT_NAMES[joint], "translation": entries(&offset).map(micro) });
            if !children.is_empty() {
                node["children"] = json!(children);
            }
            self.add_node(node);
        }
        self.add_skin(&rest, pelvis, id);
        self.add_animation(take, motion, pelvis);
    }

    fn add_skin(&mut self, rest: &[nalgebra::Vector3<f64>; N_JOINTS], pelvis: usize, id: usize) {
        // Column-major: joint_from_mesh moves the rest joint to the origin.
        let inverse = |joint: &nalgebra::Vector3<f64>| {
            let [x, y, z] = entries(joint).map(|c| micro(-c) as f32);
            [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, x, y, z, 1.0]
        };
        let inverse_bind: Vec<f32> = rest.iter().flat_map(inverse).collect();
        let inverse_bind = self.buffer.floats(&inverse_bind, Element::Mat4);
        let joints: Vec<usize> = (0..N_JOINTS).map(|joint| pelvis + joint).collect();
        self.skins.push(json!({
            "name": format!("person_{id}"), "inverseBindMatrices": inverse_bind, "joints": joints, "skeleton": pelvis,
        }));
        let primitive = sticks::primitive(&mut self.buffer, rest);
        self.meshes.push(json!({ "name": format!("person_{id}_sticks"), "primitives": [primitive] }));
        let (mesh, skin) = (self.meshes.len() - 1, self.skins.len() - 1);
        let node = self.add_node(json!({ "name": format!("person_{id}_sticks"), "mesh": mesh, "skin": skin }));
        self.scene_nodes.push(node);
    }

    fn add_animation(&mut self, take: &Take, motion: &BodyMotion, pelvis: usize) {
        let times: Vec<f32> =
            (0..motion.frames.len()).map(|t| ((motion.first.0 + t) as f64 / take.fps) as f32).collect();
        let input = self.buffer.floats(&times, Element::Scalar);
        let places: Vec<f32> =
            motion.frames.iter().flat_map(|pose| entries(&pose.joints[0]).map(|c| micro(c) as f32)).collect();
        let output = self.buffer.floats(&places, Element::Vec3);
        self.add_channel(input, output, pelvis, "translation");
        for joint in 0..N_JOINTS {
            let turns = quaternions_xyzw(motion.frames.iter().map(|pose| &pose.rotations[joint]));
            let turns: Vec<f32> = turns.iter().flatten().map(|c| *c as f32).collect();
            let output = self.buffer.floats(&turns, Element::Vec4);
            self.add_channel(input, output, pelvis + joint, "rotation");
        }
    }

    fn add_channel(&mut self, input: usize, output: usize, node: usize, path: &str) {
        self.samplers.push(json!({ "input": input, "output": output, "interpolation": "LINEAR" }));
        let sampler = self.samplers.len() - 1;
        self.channels.push(json!({ "sampler": sampler, "target": { "node": node, "path": path } }));
    }

    fn add_camera(&mut self, camera: &TakeCamera) {
        let lens = &camera.intrinsics;
        let pose = world_from_film(camera);
        let (width, height) = (f64::from(lens.width), f64::from(lens.height));
        self.cameras.push(json!({
            "name": camera.id,
            "type": "perspective",
            "perspective": {
                "yfov": vertical_view(lens),
                "aspectRatio": (width / lens.fx) / (height / lens.fy),
                "znear": NEAR,
            },
        }));
        let number = self.cameras.len() - 1;
        let node = self.add_node(json!({
            "name": camera.id,
            "camera": number,
            "translation": entries(&pose.translation),
            "rotation": quaternion_xyzw(&pose.rotation),
            "extras": {
                "id": camera.id,
                "width": lens.width,
                "height": lens.height,
                "K": rows(&lens.matrix()),
                "distortion_model": lens.dist.name(),
                "dist": lens.dist.coefficients(),
            },
        }));
        self.scene_nodes.push(node);
    }

    fn finish(self, take: &Take) -> io::Result<Vec<u8>> {
        let mut root = json!({
            "asset": { "version": "2.0", "generator": "wandless" },
            "scene": 0,
            "scenes": [{
                "name": take.name,
                "extras": { "fps": take.fps, "frame_range": take.frame_range() },
            }],
        });
        // glTF forbids empty arrays.
        let mut set = |name: &str, values: Vec<Value>| {
            if !values.is_empty() {
                root[name] = Value::from(values);
            }
        };
        set("nodes", self.nodes);
        set("skins", self.skins);
        set("meshes", self.meshes);
        set("cameras", self.cameras);
        if !self.channels.is_empty() {
            set("animations", vec![json!({ "name": "take", "samplers": self.samplers, "channels": self.channels })]);
        }
        if !self.scene_nodes.is_empty() {
            root["scenes"][0]["nodes"] = json!(self.scene_nodes);
        }
        self.buffer.into_glb(root)
    }
}

/// Ranges of frame numbers, ends included, in which no camera detected the person.
fn carried_ranges(take: &Take, motion: &BodyMotion) -> Vec<[i64; 2]> {
    let mut ranges: Vec<[i64; 2]> = Vec::new();
    for (t, _) in motion.frames.iter().enumerate().filter(|(_, pose)| !pose.valid) {
        let frame = take.frame_number(motion.first.0 + t);
        match ranges.last_mut() {
            Some(range) if range[1].saturating_add(1) == frame => range[1] = frame,
            _ => ranges.push([frame, frame]),
        }
    }
    ranges
}
