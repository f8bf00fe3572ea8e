//! The left half of a mirror-symmetric surface: surface nets on a graded grid.
//!
//! The grid's first column of cells straddles the midplane, so that its vertices lie on the plane and the mirror image closes
//! the mesh without a seam. Surface nets (Gibson 1998): one vertex per cell that the surface crosses, one quad per crossed
//! grid edge. Two sheets of the surface within one cell would share a vertex: the figure keeps them apart.

use super::tubes::{Tube, body_distance};
use nalgebra::Vector3;

/// Triangles for x >= 0, anticlockwise from outside; vertices on the plane are shared with the mirror image.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct HalfMesh {
    /// Positions, m.
    pub vertices: Vec<Vector3<f64>>,
    /// Whether the vertex lies in the midplane, x = 0.
    pub on_plane: Vec<bool>,
    /// Triangles as indices of vertices.
    pub faces: Vec<[usize; 3]>,
}

/// Spacing of the grid over most of the body, m; gives 7,000 vertices.
const COARSE: f64 = 0.0198;
/// Spacing at hands, feet and face, m.
const FINE: f64 = 0.013;
/// Half width of the cells on the midplane, m; less than half the gap between the thighs.
const MIDDLE: f64 = 0.006;

/// Grid lines from `start` on; each band (end, spacing) adds lines up to its end.
fn graded(start: f64, bands: &[(f64, f64)]) -> Vec<f64> {
    let mut lines = vec![start];
    let mut at = start;
    for &(end, spacing) in bands {
        while at < end {
            at += spacing;
            lines.push(at);
        }
    }
    lines
}

struct Grid {
    lines: [Vec<f64>; 3],
}

impl Grid {
    fn over_the_body() -> Self {
        let x = graded(MIDDLE, &[(0.67, COARSE), (0.94, FINE)]);
        let y = graded(-0.025, &[(0.09, FINE), (1.315, COARSE), (1.39, 0.0125), (1.46, COARSE), (1.73, 0.0165)]);
        let z = graded(-0.20, &[(0.07, COARSE), (0.235, 0.0165)]);
        Self { lines: [std::iter::once(-MIDDLE).chain(x).collect(), y, z] }
    }

    fn size(&self) -> [usize; 3] {
        [0, 1, 2].map(|axis| self.lines[axis].len())
    }

    fn index(&self, node: [usize; 3]) -> usize {
        let [_, ny, nz] = self.size();
        (node[0] * ny + node[1]) * nz + node[2]
    }

    fn place(&self, node: [usize; 3]) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| self.lines[axis][node[axis]])
    }

    /// All nodes if `margin` is 0; those with a successor on every axis if it is 1.
    fn nodes(&self, margin: usize) -> impl Iterator<Item = [usize; 3]> + use<> {
        let [nx, ny, nz] = self.size().map(|n| n - margin);
        (0..nx).flat_map(move |i| (0..ny).flat_map(move |j| (0..nz).map(move |k| [i, j, k])))
    }
}

/// Meshes the half body at x >= 0.
pub(super) fn half_surface(tubes: &[Tube]) -> HalfMesh {
    let grid = Grid::over_the_body();
    let values: Vec<f64> = grid.nodes(0).map(|node| body_distance(tubes, &grid.place(node))).collect();
    let mut mesh = HalfMesh { vertices: Vec::new(), on_plane: Vec::new(), faces: Vec::new() };
    let mut vertex_of_cell = vec![usize::MAX; values.len()];
    for cell in grid.nodes(1) {
        if let Some(mut vertex) = cell_vertex(&grid, &values, cell) {
            let on_plane = cell[0] == 0;
            vertex.x = if on_plane { 0.0 } else { vertex.x };
            vertex_of_cell[grid.index(cell)] = mesh.vertices.len();
            mesh.vertices.push(vertex);
            mesh.on_plane.push(on_plane);
        }
    }
    for node in grid.nodes(1).filter(|node| node[0] > 0 && node[1] > 0 && node[2] > 0) {
        for axis in 0..3 {
            let mut next = node;
            next[axis] += 1;
            let (here, there) = (values[grid.index(node)] < 0.0, values[grid.index(next)] < 0.0);
            if here != there {
                let quad = cells_around(node, axis).map(|cell| vertex_of_cell[grid.index(cell)]);
                add_quad(&mut mesh, if here { quad } else { [quad[3], quad[2], quad[1], quad[0]] });
            }
        }
    }
    mesh
}

/// The mean of the points where the surface crosses the cell's edges.
fn cell_vertex(grid: &Grid, values: &[f64], cell: [usize; 3]) -> Option<Vector3<f64>> {
    let corner = |bits: usize| [0, 1, 2].map(|axis| cell[axis] + (bits >> axis & 1));
    let mut sum = Vector3::zeros();
    let mut count = 0.0;
    for a in 0..8 {
        for axis in 0..3 {
            let b = a | 1 << axis;
            if b == a {
                continue;
            }
            let (at_a, at_b) = (values[grid.index(corner(a))], values[grid.index(corner(b))]);
            if (at_a < 0.0) != (at_b < 0.0) {
                sum += grid.place(corner(a)).lerp(&grid.place(corner(b)), at_a / (at_a - at_b));
                count += 1.0;
            }
        }
    }
    (count > 0.0).then(|| sum / count)
}

/// The four cells around the grid edge that starts at `node`, anticlockwise seen from the edge's end.
fn cells_around(node: [usize; 3], axis: usize) -> [[usize; 3]; 4] {
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    [(1, 1), (0, 1), (0, 0), (1, 0)].map(|(du, dv)| {
        let mut cell = node;
        cell[u] -= du;
        cell[v] -= dv;
        cell
    })
}

/// Splits the quad along its shorter diagonal.
fn add_quad(mesh: &mut HalfMesh, quad: [usize; 4]) {
    let [a, b, c, d] = quad;
    let length = |i: usize, j: usize| (mesh.vertices[i] - mesh.vertices[j]).norm_squared();
    let halves = if length(a, c) <= length(b, d) { [[a, b, c], [a, c, d]] } else { [[b, c, d], [b, d, a]] };
    mesh.faces.extend(halves);
}
