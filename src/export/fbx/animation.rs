//! The animation of a take: one stack with one layer, a curve per animated number, all on the same keys.

use super::node::{Node, Property as P};
use super::objects::{ObjectId, Objects, integer, properties, property};
use super::person::{CM, Person};
use super::skeleton::Models;
use crate::export::rig::joint_turn;
use crate::export::take::Take;
use crate::geometry::euler::{EulerAngles, nearest_angles, zyx_angles};
use crate::session::people::BodyPose;

/// Units of FBX's clock per second.
const TICKS_PER_SEC: f64 = 46_186_158_000.0;
/// Name of the stack.
pub(super) const STACK_NAME: &str = "take";
/// Version of curves.
const KEY_VERSION: i32 = 4008;
/// Flags of a key: linear interpolation with automatic tangents, or constant until the next key.
const LINEAR: i32 = 0x104;
const CONSTANT: i32 = 0x2;
/// Tangents of a key that nothing reads between linear or constant keys: slopes 0; weights of a third, which are stored in two
/// halves of a float as ten-thousandths; no velocities.
const TANGENTS: [f32; 4] = [0.0, 0.0, f32::from_bits(0x0d05_0d05), 0.0];

/// The layer that curves are added to, and the times of the keys.
pub(super) struct Animation {
    layer: ObjectId,
    times: Vec<i64>,
}

/// Time of a frame number on FBX's clock.
pub(super) fn ticks(take: &Take, frame: i64) -> i64 {
    (frame as f64 / take.fps * TICKS_PER_SEC).round() as i64
}

/// Adds stack and layer.
pub(super) fn add_animation(objects: &mut Objects, take: &Take) -> Animation {
    let [start, end] = take.frame_range().map(|frame| ticks(take, frame));
    let time = |name: &str, at: i64| property(name, "KTime", "Time", "", [P::I64(at)]);
    let span = ["LocalStart", "ReferenceStart"].map(|name| time(name, start));
    let span = span.into_iter().chain(["LocalStop", "ReferenceStop"].map(|name| time(name, end)));
    let stack = objects.add("AnimationStack", STACK_NAME, "AnimStack", "", vec![properties(span.collect())]);
    let layer = objects.add("AnimationLayer", STACK_NAME, "AnimLayer", "", vec![properties(vec![])]);
    objects.connect(layer, stack);
    Animation { layer, times: (0..take.n_frames).map(|t| ticks(take, take.frame_number(t))).collect() }
}

impl Animation {
    /// Adds the motion of a person: the pelvis's position and all rotations.
    pub(super) fn add_motion(&self, objects: &mut Objects, take: &Take, person: &Person<'_>, models: &Models) {
        let poses: Vec<&BodyPose> = take.on_time_line(person.motion).collect();
        let place = |axis: usize| poses.iter().map(|pose| (pose.joints[0][axis] * CM) as f32).collect();
        let places = [("d|X", place(0)), ("d|Y", place(1)), ("d|Z", place(2))];
        self.add_curves(objects, models.joints[0], ("T", "Lcl Translation"), places.into(), LINEAR);
        let frames: Vec<usize> = take.frames_on_time_line(person.motion).collect();
        for joint in 0..person.rig.n_joints() {
            let turns = rotation_curves(person, joint, &frames);
            self.add_curves(objects, models.joints[joint], ("R", "Lcl Rotation"), turns.into(), LINEAR);
        }
    }

    /// Hides a model in the frames in which the person is absent.
    pub(super) fn add_visibility(&self, objects: &mut Objects, person: &Person<'_>, model: ObjectId) {
        let present = person.motion.first.0..person.motion.first.0 + person.motion.frames.len();
        let shown: Vec<f32> = (0..self.times.len()).map(|t| if present.contains(&t) { 1.0 } else { 0.0 }).collect();
        if shown.contains(&0.0) {
            let curves = vec![("d|Visibility", shown)];
            self.add_curves(objects, model, ("Visibility", "Visibility"), curves, CONSTANT);
        }
    }

    fn add_curves(
        &self,
        objects: &mut Objects,
        model: ObjectId,
        (name, target): (&str, &str),
        curves: Vec<(&str, Vec<f32>)>,
        interpolation: i32,
    ) {
        let first = |values: &[f32]| P::F64(values.first().copied().map_or(0.0, f64::from));
        let defaults = curves.iter().map(|(channel, values)| property(channel, "Number", "", "A", [first(values)]));
        let content = vec![properties(defaults.collect())];
        let node = objects.add("AnimationCurveNode", name, "AnimCurveNode", "", content);
        objects.connect(node, self.layer);
        objects.connect_property(node, model, target);
        for (channel, values) in curves {
            let content = self.curve(values, interpolation);
            let curve = objects.add("AnimationCurve", "", "AnimCurve", "", content);
            objects.connect_property(curve, node, channel);
        }
    }

    fn curve(&self, values: Vec<f32>, interpolation: i32) -> Vec<Node> {
        vec![
            Node::leaf("Default", [P::F64(values.first().copied().map_or(0.0, f64::from))]),
            integer("KeyVer", KEY_VERSION),
            Node::leaf("KeyTime", [P::I64s(self.times.clone())]),
            Node::leaf("KeyAttrRefCount", [P::I32s(vec![values.len() as i32])]),
            Node::leaf("KeyValueFloat", [P::F32s(values)]),
            Node::leaf("KeyAttrFlags", [P::I32s(vec![interpolation])]),
            Node::leaf("KeyAttrDataFloat", [P::F32s(TANGENTS.to_vec())]),
        ]
    }
}

/// Rotations away from the rest pose, `R = R_z R_y R_x`, degrees, without jumps of full turns.
fn rotation_curves(person: &Person<'_>, joint: usize, frames: &[usize]) -> [(&'static str, Vec<f32>); 3] {
    let mut before = EulerAngles::default();
    let mut curves = [("d|X", Vec::new()), ("d|Y", Vec::new()), ("d|Z", Vec::new())];
    for t in frames {
        let turn = joint_turn(person.motion, *t, joint);
        before = nearest_angles(zyx_angles(&person.rig.away_from_rest(joint, &turn)), before);
        let angles = [before.inner, before.middle, before.outer];
        curves.iter_mut().zip(angles).for_each(|((_, curve), angle)| curve.push(angle.to_degrees() as f32));
    }
    curves
}
