//! Writing a body: SMPL's `.npz` layout with our landmarks, Wavefront OBJ and binary glTF.

use crate::body::anthropometry::N_BETAS;
use crate::body::skeleton::{N_JOINTS, PARENTS};
use crate::body::surface::{N_POSE_FEATURES, Surface};
use crate::formats::npz::{CompressionMethod, NpzWriter};
use nalgebra::Vector3;
use std::fmt::Write as _;
use std::io::{self, Cursor};

/// The body as an `.npz` that [`super::load_body`] and smplx-compatible tools read: single precision, deflated. The
/// same body gives the same bytes.
///
/// `posedirs` is written if the body has pose directions, or as zeros if `with_posedirs` requests the full layout.
///
/// # Errors
/// What the writer reports; writing to memory does not fail.
pub fn body_npz(surface: &Surface, with_posedirs: bool) -> io::Result<Vec<u8>> {
    let n = surface.vertices.len();
    let mut file = NpzWriter::new(Cursor::new(Vec::new()), CompressionMethod::Deflated);
    file.array("v_template", &[n, 3], surface.vertices.iter().flat_map(|v| [v.x as f32, v.y as f32, v.z as f32]))?;
    let row_major = |k: usize| (k / N_BETAS, k % N_BETAS);
    let shapes = surface.shape_directions.iter().flat_map(|s| (0..3 * N_BETAS).map(move |k| s[row_major(k)] as f32));
    file.array("shapedirs", &[n, 3, N_BETAS], shapes)?;
    let mut weights = vec![0.0_f32; n * N_JOINTS];
    for (vertex, row) in surface.skin.iter().enumerate() {
        row.iter().for_each(|share| weights[vertex * N_JOINTS + share.joint] = share.weight as f32);
    }
    file.array("weights", &[n, N_JOINTS], weights)?;
    let mut regressor = vec![0.0_f32; N_JOINTS * n];
    for (joint, row) in surface.regressor.iter().enumerate() {
        row.iter().for_each(|share| regressor[joint * n + share.vertex] = share.weight as f32);
    }
    file.array("J_regressor", &[N_JOINTS, n], regressor)?;
    let parents = PARENTS.iter().map(|parent| parent.map_or(-1, |p| p as i64));
    file.array("kintree_table", &[2, N_JOINTS], parents.chain(0..N_JOINTS as i64))?;
    file.array("f", &[surface.faces.len(), 3], surface.faces.iter().flatten().map(|v| *v as u32))?;
    if with_posedirs || !surface.pose_directions.is_empty() {
        let full = n * 3 * N_POSE_FEATURES;
        let values = surface.pose_directions.iter().copied().chain(std::iter::repeat(0.0)).take(full);
        file.array("posedirs", &[n, 3, N_POSE_FEATURES], values)?;
    }
    let points = &surface.points;
    let names = points.iter().flat_map(|point| point.name.bytes().chain([b'\n']));
    let names: Vec<u8> = names.collect();
    file.array("landmark_names", &[names.len()], names)?;
    let shares = || points.iter().enumerate().flat_map(|(i, point)| point.vertices.iter().map(move |share| (i, share)));
    file.array("landmark_vertices", &[shares().count(), 2], shares().flat_map(|(i, s)| [i as u32, s.vertex as u32]))?;
    file.array("landmark_weights", &[shares().count()], shares().map(|(_, share)| share.weight as f32))?;
    Ok(file.finish()?.into_inner())
}

/// A mesh as Wavefront OBJ: metres, y up, faces from 1.
pub fn body_obj(vertices: &[Vector3<f64>], faces: &[[usize; 3]]) -> String {
    let mut text = String::from("# metres, y up\n");
    for v in vertices {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "v {:.6} {:.6} {:.6}", v.x, v.y, v.z);
    }
    for [a, b, c] in faces {
        let _ = writeln!(text, "f {} {} {}", a + 1, b + 1, c + 1);
    }
    text
}

/// A mesh as binary glTF 2.0 (Khronos, section 4.4): one node, one mesh, positions and indices.
pub fn body_glb(vertices: &[Vector3<f64>], faces: &[[usize; 3]]) -> Vec<u8> {
    let positions = vertices.iter().flat_map(|v| v.iter()).flat_map(|c| (*c as f32).to_le_bytes());
    let n_position_bytes = 12 * vertices.len();
    let indices = faces.iter().flatten().flat_map(|v| (*v as u32).to_le_bytes());
    let binary: Vec<u8> = positions.chain(indices).collect();
    let bound = |pick: fn(f32, f32) -> f32, start: f32| -> Vec<f32> {
        (0..3).map(|axis| vertices.iter().map(|v| v[axis] as f32).fold(start, pick)).collect()
    };
    let document = serde_json::json!({
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"byteLength": binary.len()}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": n_position_bytes, "target": 34962},
            {"buffer": 0, "byteOffset": n_position_bytes, "byteLength": 12 * faces.len(), "target": 34963},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": vertices.len(), "type": "VEC3",
             "min": bound(f32::min, f32::MAX), "max": bound(f32::max, f32::MIN)},
            {"bufferView": 1, "componentType": 5125, "count": 3 * faces.len(), "type": "SCALAR"},
        ],
    });
    let mut json = document.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut glb = Vec::with_capacity(28 + json.len() + binary.len());
    let length = 28 + json.len() + binary.len();
    for word in [0x4654_6C67, 2, length as u32, json.len() as u32, 0x4E4F_534A] {
        glb.extend(u32::to_le_bytes(word));
    }
    glb.extend(json);
    for word in [binary.len() as u32, 0x004E_4942] {
        glb.extend(u32::to_le_bytes(word));
    }
    glb.extend(binary);
    glb
}
