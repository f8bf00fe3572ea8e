//! Generator of the default body: from published anthropometry to a mesh, deterministic to the last bit.
//!
//! 1. `places`: joints and landmarks as functions of measures;
//! 2. `figure`: the body as `tubes`, as functions of measures;
//! 3. `half_mesh`, `relaxation`: the left half as well-shaped triangles, mirrored;
//! 4. `tubes`: the change of every vertex per beta;
//! 5. `skin`: skin weights;
//! 6. `regressor`: joints and landmarks as weighted sums of vertices.
//!
//! Why not a scan-based model: no licence allows shipping one. Why no pose blend shapes: the patents on SMPL cover them.
//! Known limits: no fingers, no face beyond nose and jaw; muscles do not bulge; arms hang down at identity collars.

mod figure;
mod half_mesh;
mod places;
mod regressor;
mod relaxation;
mod skin;
#[cfg(test)]
mod tests;
mod tubes;

use super::anthropometry::Population;
use super::model::ShapeDirections;
use super::skeleton::{JOINT_COUNTERPARTS, JOINT_NAMES, KeypointConvention, N_JOINTS};
use super::surface::{JointWeight, Surface, SurfacePoint, VertexWeight};
use half_mesh::{HalfMesh, half_surface};
use nalgebra::Vector3;
use places::{VariedPlace, joint_place, side_and_part, surface_place, varied};
use regressor::{Candidate, convex_row};
use relaxation::relax;
use skin::{Tips, skin_weights};
use std::collections::BTreeSet;
use tubes::surface_directions;

/// A generated body.
#[derive(Debug, Clone, PartialEq)]
pub struct GeneratedBody {
    /// The mesh with skin weights, regressor and surface points.
    pub surface: Surface,
    /// The joints that the regressor is fitted to, m.
    pub joints: [Vector3<f64>; N_JOINTS],
    /// Change of the joints per beta, m.
    pub joint_directions: [ShapeDirections; N_JOINTS],
}

/// Generates the default adult: floor at y = 0, 1.692 m tall at beta 0, betas of [`Population::ansur2`].
pub fn generate() -> GeneratedBody {
    let population = Population::ansur2();
    let tubes = figure::figure(&population);
    let places: [VariedPlace; N_JOINTS] = std::array::from_fn(|j| {
        let (side, part) = side_and_part(JOINT_NAMES[j]);
        varied(&joint_place(part), side, &population)
    });
    let joints = std::array::from_fn(|j| places[j].mean);
    let mut half = half_surface(&tubes);
    relax(&mut half, &tubes);
    let mut directions: Vec<ShapeDirections> = half.vertices.iter().map(|v| surface_directions(&tubes, v)).collect();
    for (direction, _) in directions.iter_mut().zip(&half.on_plane).filter(|(_, on_plane)| **on_plane) {
        direction.row_mut(0).fill(0.0);
    }
    let skin = skin_weights(&half, &joints, &tips(&population));
    let mirror = Mirror::of(&half);
    let mut surface = mirror.whole(&half, &directions, &skin);
    let candidates = Candidates::of(&surface, &mirror);
    surface.regressor = regressor(&candidates, &mirror, &places);
    surface.points = surface_points(&candidates, &mirror, &population);
    GeneratedBody { surface, joints, joint_directions: std::array::from_fn(|j| places[j].directions) }
}

fn tips(population: &Population) -> Tips {
    let place = |place: &places::Place| varied(place, 1.0, population).mean;
    let of = |name: &str| surface_place(name).map_or_else(Vector3::zeros, |p| place(&p));
    let crotch = place(&places::spine(0.0, 0.0));
    Tips {
        crown: of("head_top"),
        finger: place(&places::arm(0.896, 1.0, 0.9, 0.0)),
        toe: of("big_toe"),
        heel: of("heel"),
        crotch: Vector3::new(0.0, crotch.y - 0.115, -0.02),
    }
}

/// Maps the left half to the whole mesh: half vertices first, then mirror images of those off the plane.
struct Mirror {
    /// Mirror image of every vertex of the whole mesh.
    image: Vec<usize>,
    n_half: usize,
}

impl Mirror {
    fn of(half: &HalfMesh) -> Self {
        let n_half = half.vertices.len();
        let mut image: Vec<usize> = (0..n_half).collect();
        for i in 0..n_half {
            if !half.on_plane[i] {
                image[i] = image.len();
                image.push(i);
            }
        }
        Self { image, n_half }
    }

    /// The whole surface, without regressor and points.
    fn whole(&self, half: &HalfMesh, directions: &[ShapeDirections], skin: &[Vec<JointWeight>]) -> Surface {
        let other_side = |v: &JointWeight| JointWeight { joint: JOINT_COUNTERPARTS[v.joint], ..*v };
        let originals = self.image[self.n_half..].to_vec();
        let vertices = originals.iter().map(|&i| reflected(&half.vertices[i]));
        let shapes = originals.iter().map(|&i| {
            let mut direction = directions[i];
            direction.row_mut(0).neg_mut();
            direction
        });
        let rows = originals.iter().map(|&i| skin[i].iter().map(other_side).collect());
        let faces = half.faces.iter().map(|[a, b, c]| [self.image[*a], self.image[*c], self.image[*b]]);
        Surface {
            vertices: half.vertices.iter().copied().chain(vertices).collect(),
            shape_directions: directions.iter().copied().chain(shapes).collect(),
            faces: half.faces.iter().copied().chain(faces).collect(),
            skin: skin.iter().cloned().chain(rows).collect(),
            regressor: std::array::from_fn(|_| Vec::new()),
            pose_directions: Vec::new(),
            points: Vec::new(),
        }
    }

    fn row(&self, row: &[VertexWeight]) -> Vec<VertexWeight> {
        row.iter().map(|v| VertexWeight { vertex: self.image[v.vertex], ..*v }).collect()
    }
}

fn reflected(v: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(-v.x, v.y, v.z)
}

/// Candidates for the sums that define a joint or a point: vertices of the left half, or mirrored pairs for the midline.
struct Candidates {
    left: Vec<Candidate>,
    pairs: Vec<Candidate>,
}

impl Candidates {
    fn of(surface: &Surface, mirror: &Mirror) -> Self {
        let single = |i: usize| Candidate {
            vertices: vec![i],
            place: surface.vertices[i],
            directions: surface.shape_directions[i],
        };
        let pair = |i: usize| {
            let (mut pair, image) = (single(i), mirror.image[i]);
            pair.vertices.extend((image != i).then_some(image));
            pair.place.x = 0.0;
            pair.directions.row_mut(0).fill(0.0);
            pair
        };
        Self { left: (0..mirror.n_half).map(single).collect(), pairs: (0..mirror.n_half).map(pair).collect() }
    }

    /// Weights of vertices for a place on the left side or the midline.
    fn row(&self, name: &str, place: &VariedPlace) -> Vec<VertexWeight> {
        convex_row(place, if name.starts_with("left_") { &self.left } else { &self.pairs })
    }
}

fn regressor(
    candidates: &Candidates,
    mirror: &Mirror,
    places: &[VariedPlace; N_JOINTS],
) -> [Vec<VertexWeight>; N_JOINTS] {
    let mut rows: [Vec<VertexWeight>; N_JOINTS] = std::array::from_fn(|_| Vec::new());
    for (j, name) in JOINT_NAMES.iter().enumerate() {
        rows[j] = match name.starts_with("right_") {
            true => mirror.row(&rows[JOINT_COUNTERPARTS[j]]),
            false => candidates.row(name, &places[j]),
        };
    }
    rows
}

/// All surface points that a convention names.
fn surface_points(candidates: &Candidates, mirror: &Mirror, population: &Population) -> Vec<SurfacePoint> {
    let names: BTreeSet<&str> = KeypointConvention::ALL.iter().flat_map(|c| c.names().iter().copied()).collect();
    let left_row =
        |name: &str| Some(candidates.row(name, &varied(&surface_place(side_and_part(name).1)?, 1.0, population)));
    let point = |name: &&str| {
        let vertices = match name.strip_prefix("right_") {
            Some(part) => mirror.row(&left_row(&format!("left_{part}"))?),
            None => left_row(name)?,
        };
        Some(SurfacePoint { name: (*name).to_owned(), vertices })
    };
    names.iter().filter_map(point).collect()
}
