//! `scene.glb`: binary glTF 2.0 with a skinned skeleton and its animation per person and a node per camera.
//!
//! Metres, y up; time 0 s is the session's first frame, and all people have the times of the whole take. Every person has a
//! skin whose joints are SMPL's with axes along the bones ([`super::rig`]), bound in the T-pose, and the mesh of the body; where
//! the body may not be exported, one small octahedron per bone makes the skeleton visible. While a person is absent the
//! person's node has the scale 0, since glTF cannot hide a node. A glTF camera has neither principal point nor
//! distortion: `extras` of its node contain K, `distortion_model`, `dist` and the image size; those of a person's node
//! contain `frame_presence` and the frames in which no camera detected the person (`carried`), as frame numbers.

mod buffer;
mod mesh;
mod sticks;

use super::files::{ResultFiles, micro};
use super::film::{vertical_view, world_from_film};
use super::names::person_name;
use super::rig::{Rig, joint_turn};
use super::rotation_forms::{quaternion_xyzw, quaternions_xyzw};
use super::skin::skin_mesh;
use super::take::{Take, TakeCamera};
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
    materials: Vec<Value>,
    cameras: Vec<Value>,
    samplers: Vec<Value>,
    channels: Vec<Value>,
}

/// Writes the file.
pub(super) fn write(files: &mut ResultFiles, take: &Take) -> io::Result<()> {
    let take = take.with_up_axis(UpAxis::Y);
    let mut document = Document::default();
    if !take.motions.is_empty() {
        let times: Vec<f32> = (0..take.n_frames).map(|t| (t as f64 / take.fps) as f32).collect();
        let times = document.buffer.floats(&times, Element::Scalar);
        take.motions.iter().for_each(|motion| document.add_person(&take, motion, times));
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

    fn add_person(&mut self, take: &Take, motion: &BodyMotion, times: usize) {
        let rig = Rig::of(motion);
        let root = self.nodes.len();
        let pelvis = root + 1; // joint j is node pelvis + j
        self.scene_nodes.push(root);
        self.add_node(json!({
            "name": person_name(take, motion),
            "children": [pelvis],
            "extras": {
                "frame_presence": take.presence(motion),
                "carried": carried_ranges(take, motion),
                "betas": motion.betas,
            },
        }));
        for joint in 0..rig.n_joints() {
            let mut node = json!({
                "name": rig.names[joint],
                "translation": entries(&rig.offset(joint)).map(micro),
                "rotation": quaternion_xyzw(&rig.rest(joint)),
            });
            let children: Vec<usize> = rig.children(joint).map(|child| pelvis + child).collect();
            if !children.is_empty() {
                node["children"] = json!(children);
            }
            self.add_node(node);
        }
        self.add_skin(take, motion, &rig, pelvis);
        self.add_animation(take, motion, &rig, pelvis, times);
        self.hide_while_absent(take, motion, root);
    }

    fn add_skin(&mut self, take: &Take, motion: &BodyMotion, rig: &Rig, pelvis: usize) {
        let inverse_bind: Vec<f32> = (0..rig.n_joints()).flat_map(|joint| inverse_bind(rig, joint)).collect();
        let inverse_bind = self.buffer.floats(&inverse_bind, Element::Mat4);
        let joints: Vec<usize> = (0..rig.n_joints()).map(|joint| pelvis + joint).collect();
        let person = person_name(take, motion);
        self.skins.push(json!({
            "name": person, "inverseBindMatrices": inverse_bind, "joints": joints, "skeleton": pelvis,
        }));
        let (kind, mut primitive) = match &take.body {
            Some(body) => ("body", mesh::primitive(&mut self.buffer, &skin_mesh(body, motion))),
            None => ("sticks", sticks::primitive(&mut self.buffer, rig)),
        };
        primitive["material"] = json!(self.materials.len());
        let colour = mesh::colour(self.materials.len());
        self.materials.push(json!({
            "name": person,
            "pbrMetallicRoughness": { "baseColorFactor": colour, "metallicFactor": 0.0, "roughnessFactor": 0.8 },
        }));
        let name = format!("{person}_{kind}");
        self.meshes.push(json!({ "name": name, "primitives": [primitive] }));
        let (mesh, skin) = (self.meshes.len() - 1, self.skins.len() - 1);
        let node = self.add_node(json!({ "name": name, "mesh": mesh, "skin": skin }));
        self.scene_nodes.push(node);
    }

    fn add_animation(&mut self, take: &Take, motion: &BodyMotion, rig: &Rig, pelvis: usize, times: usize) {
        let poses = || take.on_time_line(motion);
        let places: Vec<f32> = poses().flat_map(|pose| entries(&pose.joints[0]).map(|c| micro(c) as f32)).collect();
        let output = self.buffer.floats(&places, Element::Vec3);
        self.add_channel(times, output, pelvis, "translation");
        for joint in 0..rig.n_joints() {
            let local = |t: usize| rig.local(joint, &joint_turn(motion, t, joint));
            let turns = quaternions_xyzw(take.frames_on_time_line(motion).map(local));
            let turns: Vec<f32> = turns.iter().flatten().map(|c| *c as f32).collect();
            let output = self.buffer.floats(&turns, Element::Vec4);
            self.add_channel(times, output, pelvis + joint, "rotation");
        }
    }

    /// Steps between the scales 0 and 1, half a frame before and after the person's frames: rounded times are on the right side.
    fn hide_while_absent(&mut self, take: &Take, motion: &BodyMotion, root: usize) {
        let (first, n_frames) = (motion.first.0, motion.frames.len());
        let secs = |frame: f64| (frame / take.fps) as f32;
        let mut keys = vec![(secs((first as f64 - 0.5).max(0.0)), 1.0_f32)];
        if first > 0 {
            keys.insert(0, (0.0, 0.0));
        }
        if first + n_frames < take.n_frames {
            keys.push((secs((first + n_frames) as f64 - 0.5), 0.0));
        }
        if keys.len() == 1 {
            return;
        }
        let input = self.buffer.floats(&keys.iter().map(|key| key.0).collect::<Vec<_>>(), Element::Scalar);
        let scales: Vec<f32> = keys.iter().flat_map(|key| [key.1; 3]).collect();
        let output = self.buffer.floats(&scales, Element::Vec3);
        self.add_channel(input, output, root, "scale");
        if let Some(sampler) = self.samplers.last_mut() {
            sampler["interpolation"] = json!("STEP");
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
        set("materials", self.materials);
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

/// `bone_from_body` in the rest pose, column by column.
fn inverse_bind(rig: &Rig, joint: usize) -> [f32; 16] {
    let bone_from_body = rig.axes[joint].transpose();
    let shift = -(bone_from_body * rig.joints[joint]);
    let column = |c: usize| -> [f64; 4] {
        if c == 3 {
            [shift.x, shift.y, shift.z, 1.0]
        } else {
            [bone_from_body[(0, c)], bone_from_body[(1, c)], bone_from_body[(2, c)], 0.0]
        }
    };
    std::array::from_fn(|i| column(i / 4)[i % 4] as f32)
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
