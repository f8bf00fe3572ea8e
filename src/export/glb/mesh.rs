//! The skinned mesh of a body as a glTF primitive.

use super::buffer::{Buffer, Element};
use crate::export::skin::SkinMesh;
use serde_json::{Value, json};

/// Colours of people, linear RGB, which repeat.
const COLOURS: [[f64; 3]; 6] = [
    [0.20, 0.42, 0.66],
    [0.80, 0.42, 0.18],
    [0.22, 0.56, 0.42],
    [0.66, 0.34, 0.58],
    [0.72, 0.62, 0.26],
    [0.40, 0.40, 0.44],
];

/// The colour of the `n`th person, with alpha.
pub(super) fn colour(n: usize) -> [f64; 4] {
    let [red, green, blue] = COLOURS[n % COLOURS.len()];
    [red, green, blue, 1.0]
}

/// The primitive in the rest pose.
pub(super) fn primitive(buffer: &mut Buffer, mesh: &SkinMesh) -> Value {
    let coordinates = |points: &[nalgebra::Vector3<f64>]| -> Vec<f32> {
        points.iter().flat_map(|p| [p.x as f32, p.y as f32, p.z as f32]).collect()
    };
    let joints: Vec<[u8; 4]> = mesh.skin.iter().map(|row| row.map(|one| one.joint as u8)).collect();
    let weights: Vec<f32> = mesh.skin.iter().flat_map(|row| row.map(|one| one.weight as f32)).collect();
    let corners: Vec<u32> = mesh.faces.iter().flatten().map(|vertex| *vertex as u32).collect();
    json!({
        "attributes": {
            "POSITION": buffer.vertex_floats(&coordinates(&mesh.vertices), Element::Vec3),
            "NORMAL": buffer.vertex_floats(&coordinates(&mesh.normals), Element::Vec3),
            "JOINTS_0": buffer.vertex_bytes(&joints),
            "WEIGHTS_0": buffer.vertex_floats(&weights, Element::Vec4),
        },
        "indices": buffer.indices(&corners),
    })
}
