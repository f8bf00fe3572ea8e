//! A mesh of octahedra, one per bone, which makes a skeleton without skin visible.

use super::buffer::{Buffer, Element};
use crate::export::rig::Rig;
use crate::geometry::rotation::any_perpendicular;
use nalgebra::Vector3;
use serde_json::{Value, json};

/// Position and radius of the thickest cross-section, as shares of the bone's length.
const WAIST_AT: f64 = 0.15;
const WAIST_RADIUS: f64 = 0.1;
/// Corners 0 (parent), 1 to 4 (waist), 5 (child); counter-clockwise from outside.
const FACES: [[u32; 3]; 8] = [[0, 2, 1], [0, 3, 2], [0, 4, 3], [0, 1, 4], [5, 1, 2], [5, 2, 3], [5, 3, 4], [5, 4, 1]];

/// The primitive in the rest pose; every octahedron is skinned to the joint at which its bone starts.
pub(super) fn primitive(buffer: &mut Buffer, rig: &Rig) -> Value {
    let (mut positions, mut joints, mut corners) = (Vec::new(), Vec::new(), Vec::new());
    let rest = &rig.joints;
    for (joint, parent) in rig.parents.iter().enumerate() {
        let Some(parent) = *parent else { continue };
        let first = joints.len() as u32;
        for corner in octahedron(&rest[parent], &rest[joint]) {
            positions.extend([corner.x as f32, corner.y as f32, corner.z as f32]);
            joints.push([parent as u8, 0, 0, 0]);
        }
        corners.extend(FACES.iter().flatten().map(|corner| first + corner));
    }
    let weights = [1.0, 0.0, 0.0, 0.0].repeat(joints.len());
    json!({
        "attributes": {
            "POSITION": buffer.vertex_floats(&positions, Element::Vec3),
            "JOINTS_0": buffer.vertex_bytes(&joints),
            "WEIGHTS_0": buffer.vertex_floats(&weights, Element::Vec4),
        },
        "indices": buffer.indices(&corners),
    })
}

fn octahedron(from: &Vector3<f64>, to: &Vector3<f64>) -> [Vector3<f64>; 6] {
    let bone = to - from;
    let across = bone.try_normalize(0.0).map_or_else(Vector3::zeros, |axis| any_perpendicular(&axis));
    let (a, b) = (across * (WAIST_RADIUS * bone.norm()), across.cross(&bone) * -WAIST_RADIUS);
    let waist = from + bone * WAIST_AT;
    [*from, waist + a, waist + b, waist - a, waist - b, *to]
}
