//! Builds a body from arrays: every shape, range and sum is checked once, here.

use super::error::BodyFileError;
use super::fields::Fields;
use super::landmark_table::LandmarkTable;
use crate::body::model::{BodyModel, ShapeDirections};
use crate::body::skeleton::{N_JOINTS, PARENTS};
use crate::body::surface::{JointWeight, N_POSE_FEATURES, Surface, SurfacePoint, VertexWeight};
use crate::formats::npy::Array;
use nalgebra::Vector3;

/// Most vertices of a body in SMPL's layout.
const MAX_VERTICES: usize = 20_000;
/// Smallest and largest height of an adult or adolescent at beta 0, m.
const HEIGHTS: [f64; 2] = [1.2, 2.3];
/// Largest difference between a sum of weights and 1.
const SUM_TOLERANCE: f64 = 1e-3;

/// Checks the fields and builds the body; the points of `table` replace those of the file.
pub(super) fn body(name: String, mut fields: Fields, table: &LandmarkTable) -> Result<BodyModel, BodyFileError> {
    let vertices = vertices(&take(&mut fields, "v_template")?)?;
    let n = vertices.len();
    let skin = skin(&take(&mut fields, "weights")?, n)?;
    check_tree(&take(&mut fields, "kintree_table")?)?;
    let mut surface = Surface {
        shape_directions: shape_directions(&take(&mut fields, "shapedirs")?, n)?,
        faces: faces(&take(&mut fields, "f")?, n)?,
        regressor: regressor(&take(&mut fields, "J_regressor")?, n)?,
        pose_directions: Vec::new(),
        points: own_points(&fields)?,
        vertices,
        skin,
    };
    if let Some(array) = fields.remove("posedirs") {
        surface.pose_directions = pose_directions(&array, n)?;
    }
    let points = &mut surface.points;
    points.retain(|point| !table.points.iter().any(|other| other.name == point.name));
    points.extend(table.points.iter().cloned());
    for point in &*points {
        if let Some(share) = point.vertices.iter().find(|share| share.vertex >= n) {
            let (name, vertex) = (point.name.clone(), share.vertex);
            return Err(BodyFileError::LandmarkVertex { name, vertex, n_vertices: n });
        }
    }
    Ok(BodyModel::new(name, surface))
}

/// Whether a sum of weights is 1 within the precision of files; false for NaN.
fn is_one(sum: f64) -> bool {
    (sum - 1.0).abs() <= SUM_TOLERANCE
}

fn take(fields: &mut Fields, field: &'static str) -> Result<Array, BodyFileError> {
    fields.remove(field).ok_or(BodyFileError::Missing { field })
}

pub(super) fn shaped(
    field: &'static str,
    array: &Array,
    expected: &'static str,
    fits: bool,
) -> Result<(), BodyFileError> {
    if !fits {
        return Err(BodyFileError::Shape { field, expected, found: array.shape.clone() });
    }
    Ok(())
}

fn all_finite(field: &'static str, array: &Array, row_length: usize) -> Result<(), BodyFileError> {
    match array.values.iter().position(|v| !v.is_finite()) {
        Some(at) => {
            Err(BodyFileError::Value { field, row: at / row_length.max(1), rule: "every number must be finite" })
        }
        None => Ok(()),
    }
}

fn vertices(array: &Array) -> Result<Vec<Vector3<f64>>, BodyFileError> {
    let field = "v_template";
    shaped(field, array, "(V, 3)", matches!(array.shape[..], [n, 3] if n > 0))?;
    if array.shape[0] > MAX_VERTICES {
        return Err(BodyFileError::TooLarge { what: "the number of vertices", limit: MAX_VERTICES as u64 });
    }
    all_finite(field, array, 3)?;
    let vertices: Vec<Vector3<f64>> = array.values.chunks_exact(3).map(Vector3::from_column_slice).collect();
    let (low, high) = vertices.iter().fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v.y), high.max(v.y)));
    if !(HEIGHTS[0]..=HEIGHTS[1]).contains(&(high - low)) {
        let rule = "the height along y must lie between 1.2 and 2.3 m; is the file in metres with y up?";
        return Err(BodyFileError::Value { field, row: 0, rule });
    }
    Ok(vertices)
}

/// The first ten components; where the file has fewer, the others are zero.
fn shape_directions(array: &Array, n: usize) -> Result<Vec<ShapeDirections>, BodyFileError> {
    let field = "shapedirs";
    shaped(field, array, "(V, 3, n)", matches!(array.shape[..], [v, 3, k] if v == n && k > 0))?;
    all_finite(field, array, 3 * array.shape[2])?;
    let n_components = array.shape[2];
    let entry = |vertex: usize, axis: usize, k: usize| match k < n_components {
        true => array.values[(vertex * 3 + axis) * n_components + k],
        false => 0.0,
    };
    Ok((0..n).map(|vertex| ShapeDirections::from_fn(|axis, k| entry(vertex, axis, k))).collect())
}

fn skin(array: &Array, n: usize) -> Result<Vec<Vec<JointWeight>>, BodyFileError> {
    let field = "weights";
    shaped(field, array, "(V, 24)", array.shape == [n, N_JOINTS])?;
    let row = |(row, weights): (usize, &[f64])| {
        let sum: f64 = weights.iter().sum();
        if !weights.iter().all(|w| *w >= -1e-6) || !is_one(sum) {
            let rule = "weights must be finite, not negative, and sum to 1";
            return Err(BodyFileError::Value { field, row, rule });
        }
        let total: f64 = weights.iter().filter(|w| **w > 0.0).sum();
        let shares = weights.iter().enumerate().filter(|(_, w)| **w > 0.0);
        Ok(shares.map(|(joint, w)| JointWeight { joint, weight: w / total }).collect())
    };
    array.values.chunks_exact(N_JOINTS).enumerate().map(row).collect()
}

fn regressor(array: &Array, n: usize) -> Result<[Vec<VertexWeight>; N_JOINTS], BodyFileError> {
    let field = "J_regressor";
    shaped(field, array, "(24, V)", array.shape == [N_JOINTS, n])?;
    let mut rows: [Vec<VertexWeight>; N_JOINTS] = std::array::from_fn(|_| Vec::new());
    for (row, weights) in array.values.chunks_exact(n).enumerate() {
        let sum: f64 = weights.iter().sum();
        if !is_one(sum) {
            return Err(BodyFileError::Value { field, row, rule: "a joint's shares must be finite and sum to 1" });
        }
        let shares = weights.iter().enumerate().filter(|(_, w)| **w != 0.0);
        rows[row] = shares.map(|(vertex, w)| VertexWeight { vertex, weight: *w }).collect();
    }
    Ok(rows)
}

/// Checks that the joint tree is SMPL's: parents in the first row, the root's parent being -1 in some integer width.
fn check_tree(array: &Array) -> Result<(), BodyFileError> {
    let field = "kintree_table";
    shaped(field, array, "(2, 24)", array.shape == [2, N_JOINTS])?;
    let is_root = |parent: f64| parent < 0.0 || parent >= f64::from(u32::MAX);
    for (row, parent) in PARENTS.iter().enumerate() {
        let found = array.values[row];
        let fits = parent.map_or_else(|| is_root(found), |p| found == p as f64);
        if !fits {
            return Err(BodyFileError::Value { field, row, rule: "the parents must be those of SMPL's 24 joints" });
        }
    }
    Ok(())
}

fn faces(array: &Array, n: usize) -> Result<Vec<[usize; 3]>, BodyFileError> {
    let field = "f";
    shaped(field, array, "(F, 3)", matches!(array.shape[..], [f, 3] if f > 0))?;
    let face = |(row, corners): (usize, &[f64])| {
        if !corners.iter().all(|v| *v >= 0.0 && *v < n as f64) {
            return Err(BodyFileError::Value { field, row, rule: "corners must be numbers of vertices" });
        }
        Ok([corners[0] as usize, corners[1] as usize, corners[2] as usize])
    };
    array.values.chunks_exact(3).enumerate().map(face).collect()
}

fn pose_directions(array: &Array, n: usize) -> Result<Vec<f32>, BodyFileError> {
    shaped("posedirs", array, "(V, 3, 207)", array.shape == [n, 3, N_POSE_FEATURES])?;
    all_finite("posedirs", array, 3 * N_POSE_FEATURES)?;
    let is_still = array.values.iter().all(|v| *v == 0.0);
    Ok(if is_still { Vec::new() } else { array.values.iter().map(|v| *v as f32).collect() })
}

/// The landmarks of our own layout: rows (landmark, vertex) with weights, and the names as lines of text.
fn own_points(fields: &Fields) -> Result<Vec<SurfacePoint>, BodyFileError> {
    let (Some(names), Some(rows), Some(weights)) =
        (fields.get("landmark_names"), fields.get("landmark_vertices"), fields.get("landmark_weights"))
    else {
        return Ok(Vec::new());
    };
    let text: String = names.values.iter().map(|v| char::from(*v as u8)).collect();
    let point = |name: &str| SurfacePoint { name: name.to_owned(), vertices: Vec::new() };
    let mut points: Vec<SurfacePoint> = text.lines().map(point).collect();
    shaped("landmark_vertices", rows, "(n, 2)", matches!(rows.shape[..], [k, 2] if k == weights.values.len()))?;
    for (row, (pair, weight)) in rows.values.chunks_exact(2).zip(&weights.values).enumerate() {
        let fault = BodyFileError::Value { field: "landmark_vertices", row, rule: "must name a landmark and a vertex" };
        let point = points.get_mut(pair[0] as usize).filter(|_| pair[1] >= 0.0 && weight.is_finite()).ok_or(fault)?;
        point.vertices.push(VertexWeight { vertex: pair[1] as usize, weight: *weight });
    }
    for (row, point) in points.iter_mut().enumerate() {
        let sum: f64 = point.vertices.iter().map(|share| share.weight).sum();
        if !is_one(sum) {
            return Err(BodyFileError::Value { field: "landmark_weights", row, rule: "must sum to 1" });
        }
        point.vertices.iter_mut().for_each(|share| share.weight /= sum);
    }
    Ok(points)
}
