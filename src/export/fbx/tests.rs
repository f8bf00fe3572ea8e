//! A scene, read back and posed as FBX defines it.

use super::read_back::{Record, read};
use super::*;
use crate::body::model::Betas;
use crate::body::skeleton::JOINT_NAMES;
use crate::body::skinning::skinned;
use crate::body::{default_body, kinematics};
use crate::export::names::person_name;
use crate::export::sample_motion::motion;
use crate::session::reconstruction::BodyModelId;
use crate::session::{BodyMotion, FrameIndex, PersonId};
use nalgebra::{Matrix4, Rotation3, Vector3};
use std::collections::BTreeMap;

/// Two people on a time line of six frames; the second is present in frames 1 to 3.
fn take() -> Take {
    let whole = |motion: BodyMotion| {
        let frames = motion.frames.iter().cycle().take(6).cloned().collect();
        BodyMotion { frames, ..motion }
    };
    let second = BodyMotion { person: PersonId(1), first: FrameIndex(1), ..motion() };
    Take {
        name: "take".to_owned(),
        fps: 25.0,
        first_frame: 300,
        n_frames: 6,
        up_axis: UpAxis::Y,
        cameras: Vec::new(),
        unsolved: Vec::new(),
        motions: vec![whole(motion()), second],
        names: BTreeMap::new(),
        keypoint_names: Vec::new(),
        keypoints: BTreeMap::new(),
        body_model: BodyModelId { name: "default".to_owned(), sha256: String::new() },
        body: Some(default_body()),
    }
}

/// Objects by number, and connections as (child, parent, property).
struct Scene {
    objects: BTreeMap<i64, Record>,
    connections: Vec<(i64, i64, Option<String>)>,
}

impl Scene {
    fn of(bytes: &[u8]) -> Self {
        let mut sections = read(bytes).0;
        let mut section = |name: &str| {
            let at = sections.iter().position(|section| section.name == name).unwrap();
            sections.swap_remove(at).children
        };
        let connection = |record: Record| {
            let property = (record.text(0) == "OP").then(|| record.text(3).to_owned());
            (record.number(1) as i64, record.number(2) as i64, property)
        };
        Self {
            objects: section("Objects").into_iter().map(|object| (object.number(0) as i64, object)).collect(),
            connections: section("Connections").into_iter().map(connection).collect(),
        }
    }

    fn id(&self, record: &str, name: &str) -> i64 {
        let is_it = |object: &Record| object.name == record && object.text(1).split('\0').next() == Some(name);
        *self.objects.iter().find(|(_, object)| is_it(object)).unwrap().0
    }

    /// The objects of a kind of record that a connection leads from.
    fn below(&self, parent: i64, record: &str, property: Option<&str>) -> Vec<i64> {
        let leads = |(_, to, of): &&(i64, i64, Option<String>)| *to == parent && of.as_deref() == property;
        let ids = self.connections.iter().filter(leads).map(|(from, ..)| *from);
        ids.filter(|id| self.objects[id].name == record).collect()
    }

    /// The values of an animated property at a key; `None` where it is not animated.
    fn animated(&self, model: i64, property: &str, channels: &[&str], key: usize) -> Option<Vec<f64>> {
        let node = *self.below(model, "AnimationCurveNode", Some(property)).first()?;
        let value = |channel: &&str| {
            let curve = &self.objects[&self.below(node, "AnimationCurve", Some(channel))[0]];
            assert_eq!(curve.child("KeyTime").numbers().len(), 6, "all people share one clock");
            curve.child("KeyValueFloat").numbers()[key]
        };
        Some(channels.iter().map(value).collect())
    }

    fn vector(&self, model: i64, property: &str) -> Vector3<f64> {
        let properties = &self.objects[&model].child("Properties70").children;
        let found = properties.iter().find(|p| p.text(0) == property);
        found.map_or_else(Vector3::zeros, |p| Vector3::new(p.number(4), p.number(5), p.number(6)))
    }

    /// `world_from_model` at a key, cm.
    fn world(&self, model: i64, key: usize) -> Matrix4<f64> {
        let channels = ["d|X", "d|Y", "d|Z"];
        let value = |property: &str| {
            let animated = self.animated(model, property, &channels, key);
            animated.map_or_else(|| self.vector(model, property), Vector3::from_vec)
        };
        // nalgebra's roll, pitch and yaw are R_z R_y R_x.
        let turn = |deg: Vector3<f64>| {
            let [x, y, z] = [deg.x, deg.y, deg.z].map(f64::to_radians);
            Rotation3::from_euler_angles(x, y, z).to_homogeneous()
        };
        let local = Matrix4::new_translation(&value("Lcl Translation"))
            * turn(self.vector(model, "PreRotation"))
            * turn(value("Lcl Rotation"));
        let parent = self.connections.iter().find(|(child, parent, property)| {
            *child == model && property.is_none() && self.objects.get(parent).is_some_and(|o| o.name == "Model")
        });
        parent.map_or(local, |(_, parent, _)| self.world(*parent, key) * local)
    }
}

#[test]
fn joints_and_vertices_match_the_body() {
    let take = take();
    let dir = tempfile::tempdir().unwrap();
    write(&mut ResultFiles::create(dir.path()).unwrap(), &take).unwrap();
    let scene = Scene::of(&std::fs::read(dir.path().join("scene.fbx")).unwrap());
    let body = default_body();
    for motion in &take.motions {
        let person = person_name(&take, motion);
        let joints = JOINT_NAMES.map(|joint| scene.id("Model", &format!("{person}:{joint}")));
        let geometry = &scene.objects[&scene.id("Geometry", &format!("{person}_body"))];
        let rest: Vec<Vector3<f64>> =
            geometry.child("Vertices").numbers().chunks(3).map(Vector3::from_column_slice).collect();
        let skin = scene.below(geometry.number(0) as i64, "Deformer", None)[0];
        for (key, pose) in take.on_time_line(motion).enumerate() {
            let world = joints.map(|joint| scene.world(joint, key));
            for (joint, world) in world.iter().enumerate() {
                let place = world.column(3).xyz() / 100.0;
                assert!((place - pose.joints[joint]).norm() < 0.5e-3, "{} {place}", JOINT_NAMES[joint]);
            }
            let mut vertices = vec![Vector3::zeros(); rest.len()];
            for cluster in scene.below(skin, "Deformer", None) {
                let joint = scene.below(cluster, "Model", None)[0];
                let cluster = &scene.objects[&cluster];
                let bone_from_rest = Matrix4::from_column_slice(&cluster.child("Transform").numbers());
                let moved = world[joints.iter().position(|id| *id == joint).unwrap()] * bone_from_rest;
                let shares = cluster.child("Indexes").numbers().into_iter().zip(cluster.child("Weights").numbers());
                for (vertex, weight) in shares {
                    vertices[vertex as usize] += (moved * rest[vertex as usize].push(1.0)).xyz() * (weight / 100.0);
                }
            }
            let pose = kinematics::Pose { rotations: pose.rotations, translation: pose.translation };
            let own = skinned(&body, &Betas::from(motion.betas), &pose);
            let worst = own.iter().zip(&vertices).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
            assert!(own.len() == vertices.len() && worst < 1e-3, "{worst} m");
        }
    }
}

#[test]
fn absent_people_are_invisible_and_names_are_those_of_programs() {
    let take = take();
    let dir = tempfile::tempdir().unwrap();
    write(&mut ResultFiles::create(dir.path()).unwrap(), &take).unwrap();
    let read = |name: &str| Scene::of(&std::fs::read(dir.path().join(name)).unwrap());
    let scene = read("scene.fbx");
    for name in ["person_1", "person_1_body"] {
        let model = scene.id("Model", name);
        let shown = (0..6).map(|key| scene.animated(model, "Visibility", &["d|Visibility"], key).unwrap()[0]);
        assert_eq!(shown.collect::<Vec<_>>(), [0.0, 1.0, 1.0, 1.0, 0.0, 0.0]);
    }
    assert!(scene.animated(scene.id("Model", "person_0"), "Visibility", &["d|Visibility"], 0).is_none());
    for (profile, elbow) in [("humanik", "LeftForeArm"), ("mixamo", "mixamorig:LeftForeArm"), ("unreal", "lowerarm_l")]
    {
        let one = read(&format!("1.{profile}.fbx"));
        let ours = scene.world(scene.id("Model", "person_1:left_elbow"), 2);
        assert!((one.world(one.id("Model", elbow), 2) - ours).norm() < 1e-9, "{profile}");
    }
}

#[test]
fn keys_are_at_the_frame_numbers_of_the_take() {
    let scene = Scene::of(&scene(&take(), &[]).unwrap());
    let stack = &scene.objects[&scene.id("AnimationStack", "take")];
    let times: Vec<f64> = stack.child("Properties70").children.iter().map(|time| time.number(4)).collect();
    let ticks_per_frame = 46_186_158_000.0 / 25.0;
    assert_eq!(times, [300.0, 300.0, 305.0, 305.0].map(|frame| frame * ticks_per_frame));
}
