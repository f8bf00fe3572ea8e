//! The body's skin: a triangle mesh with shape directions, skin weights and the joint regressor.

use super::shape::{Betas, ShapeDirections};
use super::skeleton::N_JOINTS;
use nalgebra::Vector3;
use sha2::{Digest, Sha256};

/// The weight of one vertex in a sum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VertexWeight {
    /// Index of the vertex.
    pub vertex: usize,
    /// Its weight.
    pub weight: f64,
}

/// The weight of one joint in a sum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointWeight {
    /// Index of the joint.
    pub joint: usize,
    /// Its weight.
    pub weight: f64,
}

/// A named point of the skin: a sum of vertices whose weights sum to 1.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfacePoint {
    /// Keypoint name as in the conventions.
    pub name: String,
    /// Weights of vertices.
    pub vertices: Vec<VertexWeight>,
}

/// Number of entries of SMPL's pose feature: 23 rotation matrices less the identity, row by row.
pub const N_POSE_FEATURES: usize = 9 * (N_JOINTS - 1);

/// A body's surface in the rest pose. V vertices, F faces.
#[derive(Debug, Clone, PartialEq)]
pub struct Surface {
    /// `T`: vertices at beta 0, m. `[V]`
    pub vertices: Vec<Vector3<f64>>,
    /// `S`: their change per beta, m. `[V]`
    pub shape_directions: Vec<ShapeDirections>,
    /// Triangles, anticlockwise from outside. `[F]`
    pub faces: Vec<[usize; 3]>,
    /// Skin weights, each row positive and summing to 1. `[V]`
    pub skin: Vec<Vec<JointWeight>>,
    /// Joints as sums of vertices, each row summing to 1; entries may be negative in a user's file.
    pub regressor: [Vec<VertexWeight>; N_JOINTS],
    /// `P`: change per entry of the pose feature, m; empty if the model has none. `[V * 3 * 207]`, vertex by vertex,
    /// coordinate by coordinate.
    pub pose_directions: Vec<f32>,
    /// The detectors' surface points.
    pub points: Vec<SurfacePoint>,
}

impl Surface {
    /// Rest vertices at a shape, `T + S beta`, m.
    pub fn shaped(&self, betas: &Betas) -> Vec<Vector3<f64>> {
        self.vertices.iter().zip(&self.shape_directions).map(|(vertex, s)| vertex + s * betas).collect()
    }

    /// Height of the rest pose at a shape, from soles to crown, m.
    pub fn stature(&self, betas: &Betas) -> f64 {
        let heights = self.vertices.iter().zip(&self.shape_directions).map(|(v, s)| v.y + s.row(1).tr_dot(betas));
        let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), y| (l.min(y), h.max(y)));
        high - low
    }

    /// Volume enclosed by the faces, m^3: the sum of signed tetrahedra at the origin.
    pub fn volume(&self, vertices: &[Vector3<f64>]) -> f64 {
        let tetrahedron = |[a, b, c]: &[usize; 3]| vertices[*a].dot(&vertices[*b].cross(&vertices[*c])) / 6.0;
        self.faces.iter().map(tetrahedron).sum()
    }

    /// Whether every edge belongs to exactly two faces that run along it in opposite directions.
    pub fn is_watertight(&self) -> bool {
        let directed = |[a, b, c]: &[usize; 3]| [[*a, *b], [*b, *c], [*c, *a]];
        let mut edges: Vec<[usize; 2]> = self.faces.iter().flat_map(directed).collect();
        edges.sort_unstable();
        let twin = |[a, b]: &[usize; 2]| edges.binary_search(&[*b, *a]).is_ok();
        edges.windows(2).all(|pair| pair[0] != pair[1]) && edges.iter().all(twin)
    }

    /// Adds every number to a digest.
    pub(super) fn digest_into(&self, hash: &mut Sha256) {
        let mut number = |value: f64| hash.update(value.to_le_bytes());
        self.vertices.iter().flat_map(|v| v.iter()).for_each(|v| number(*v));
        self.shape_directions.iter().flat_map(|s| s.iter()).for_each(|v| number(*v));
        self.faces.iter().flatten().for_each(|v| number(*v as f64));
        for JointWeight { joint, weight } in self.skin.iter().flatten() {
            number(*joint as f64);
            number(*weight);
        }
        for VertexWeight { vertex, weight } in self.regressor.iter().flatten() {
            number(*vertex as f64);
            number(*weight);
        }
        self.pose_directions.iter().for_each(|v| number(f64::from(*v)));
    }
}
