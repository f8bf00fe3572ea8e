//! The default body for the viewer, in the layout of [`super::buffers`].
//!
//! Header: `format: "wandless.body"`, `version: 1`, `name` and `sha256` of the model, `metres_per_step` and
//!
//! - `vertices` `[V, 3]`: the rest pose at beta 0, m
//! - `vertex_directions` `[V, 3, 10]`: change per beta, in steps of `metres_per_step`
//! - `joints` `[24, 3]` and `joint_directions` `[24, 3, 10]`: the same for the rest joints, m
//! - `skin_joints` `[V, 4]` and `skin_weights` `[V, 4]`: the joints of each vertex and their weights, which sum to 255
//! - `faces` `[F, 3]`: triangles, anticlockwise from outside

use super::buffers::{Array, Payload};
use super::skin::{MAX_JOINTS_PER_VERTEX, strongest_joints};
use crate::body::model::ShapeDirections;
use crate::body::surface::JointWeight;
use crate::body::{BodyModel, default_body};
use nalgebra::Vector3;
use serde::Serialize;
use std::io;

/// Version of the layout described above.
const VERSION: u32 = 1;

#[derive(Serialize)]
struct Header<'a> {
    format: &'static str,
    version: u32,
    name: &'a str,
    sha256: &'a str,
    metres_per_step: f64,
    vertices: Array,
    vertex_directions: Array,
    joints: Array,
    joint_directions: Array,
    skin_joints: Array,
    skin_weights: Array,
    faces: Array,
}

/// A file with the digest of its model.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BodyMesh {
    /// The file.
    pub bytes: Vec<u8>,
    /// Digest of the model, as in `people.json`.
    pub sha256: String,
}

/// The default body's mesh, which may be distributed freely, unlike bodies that an operator registers.
///
/// # Errors
/// Where its header cannot be written as JSON.
pub fn default_body_mesh() -> io::Result<BodyMesh> {
    let model = default_body();
    let sha256 = model.sha256();
    Ok(BodyMesh { bytes: file(&model, &sha256)?, sha256 })
}

fn file(model: &BodyModel, sha256: &str) -> io::Result<Vec<u8>> {
    let (surface, mut payload) = (&model.surface, Payload::default());
    let (n_vertices, n_joints) = (surface.vertices.len(), model.rest_joints.len());
    let directions = || surface.shape_directions.iter().flat_map(row_by_row);
    let largest = directions().fold(0.0, |most: f64, value| most.max(value.abs()));
    let metres_per_step = if largest > 0.0 { largest / f64::from(i16::MAX) } else { 1.0 };
    let skin_weights_of: Vec<[(u8, u8); MAX_JOINTS_PER_VERTEX]> =
        surface.skin.iter().map(|row| skin_weights_of(row)).collect();
    let coordinates = |points: &[Vector3<f64>]| points.iter().flat_map(|p| [p.x, p.y, p.z]).collect::<Vec<_>>();
    let joint_directions = model.shape_directions.iter().flat_map(row_by_row);
    let header = Header {
        format: "wandless.body",
        version: VERSION,
        name: &model.name,
        sha256,
        metres_per_step,
        vertices: payload.f32(&[n_vertices, 3], coordinates(&surface.vertices)),
        vertex_directions: payload
            .i16(&[n_vertices, 3, 10], directions().map(|v| (v / metres_per_step).round() as i16)),
        joints: payload.f32(&[n_joints, 3], coordinates(&model.rest_joints)),
        joint_directions: payload.f32(&[n_joints, 3, 10], joint_directions),
        skin_joints: payload
            .u8(&[n_vertices, MAX_JOINTS_PER_VERTEX], skin_weights_of.iter().flatten().map(|pair| pair.0)),
        skin_weights: payload
            .u8(&[n_vertices, MAX_JOINTS_PER_VERTEX], skin_weights_of.iter().flatten().map(|pair| pair.1)),
        faces: payload.u16(&[surface.faces.len(), 3], surface.faces.iter().flatten().map(|vertex| *vertex as u16)),
    };
    payload.file(&header)
}

/// The 3 x 10 entries, all betas of x first.
fn row_by_row(directions: &ShapeDirections) -> impl Iterator<Item = f64> {
    directions.transpose().iter().copied().collect::<Vec<_>>().into_iter()
}

/// The joints of a vertex with the largest weights, in descending order, with weights as shares of 255; the remainder of the
/// rounding is added to the first.
fn skin_weights_of(row: &[JointWeight]) -> [(u8, u8); MAX_JOINTS_PER_VERTEX] {
    let mut pairs = strongest_joints(row).map(|one| (one.joint as u8, (255.0 * one.weight).floor() as u8));
    let given: u32 = pairs.iter().map(|pair| u32::from(pair.1)).sum();
    pairs[0].1 += (255 - given) as u8;
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_of_every_vertex_sum_to_one() {
        let model = default_body();
        assert!(model.surface.vertices.len() <= usize::from(u16::MAX), "faces have 16-bit indices");
        for row in &model.surface.skin {
            assert!(row.len() <= MAX_JOINTS_PER_VERTEX);
            let skin_weights_of = skin_weights_of(row);
            assert_eq!(skin_weights_of.iter().map(|pair| u32::from(pair.1)).sum::<u32>(), 255);
            for one in row {
                let share = skin_weights_of.iter().find(|pair| usize::from(pair.0) == one.joint).unwrap().1;
                assert!((f64::from(share) / 255.0 - one.weight).abs() < 4.0 / 255.0);
            }
        }
    }

    #[test]
    fn mesh_is_small_and_names_its_model() {
        let mesh = default_body_mesh().unwrap();
        assert_eq!(mesh.sha256, default_body().sha256());
        assert!(mesh.bytes.len() < 1_000_000, "{}", mesh.bytes.len());
    }
}
