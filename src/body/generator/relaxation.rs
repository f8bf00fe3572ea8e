//! Mesh relaxation to well-shaped triangles: vertices slide along the surface, edges flip, short edges collapse.

use super::half_mesh::HalfMesh;
use super::tubes::{Tube, body_distance, body_gradient};
use nalgebra::Vector3;
use std::collections::{BTreeMap, BTreeSet};

/// Rounds of flipping, collapsing and sliding; the smallest angle has converged after them.
const ROUNDS: usize = 8;
/// Sliding steps in each round.
const SLIDES: usize = 12;
/// Edges shorter than this collapse, m.
const SHORTEST: f64 = 0.0062;

/// Relaxes the mesh onto the tubes' surface.
pub(super) fn relax(mesh: &mut HalfMesh, tubes: &[Tube]) {
    for _ in 0..ROUNDS {
        while collapse_short_edges(mesh) {}
        flip_edges(mesh);
        for _ in 0..SLIDES {
            slide(mesh, tubes);
        }
    }
    flip_edges(mesh);
}

/// The vertices connected to each vertex by an edge, in ascending order.
pub(super) fn neighbours(mesh: &HalfMesh) -> Vec<Vec<usize>> {
    let mut sets = vec![BTreeSet::new(); mesh.vertices.len()];
    for [a, b, c] in &mesh.faces {
        for (i, j) in [(*a, *b), (*b, *c), (*c, *a)] {
            sets[i].insert(j);
            sets[j].insert(i);
        }
    }
    sets.into_iter().map(|set| set.into_iter().collect()).collect()
}

/// Moves every vertex along the surface half way to the centroid of the triangles around it, then back onto the surface.
///
/// The centroid is weighted by area, which makes the triangles equal; the mean of the neighbours would shrink thin tips
/// (toes, fingers).
fn slide(mesh: &mut HalfMesh, tubes: &[Tube]) {
    let mut sums = vec![Vector3::zeros(); mesh.vertices.len()];
    let mut areas = vec![0.0; mesh.vertices.len()];
    for face in &mesh.faces {
        let [a, b, c] = face.map(|v| mesh.vertices[v]);
        let area = (b - a).cross(&(c - a)).norm();
        for v in face {
            sums[*v] += (a + b + c) * (area / 3.0);
            areas[*v] += area;
        }
    }
    for i in 0..mesh.vertices.len() {
        let point = mesh.vertices[i];
        // A vertex on the plane also has the mirrored triangles: its movement off the plane cancels.
        let gradient = body_gradient(tubes, &point);
        let mut step = (sums[i] / areas[i] - point) * 0.5;
        if mesh.on_plane[i] {
            step.x = 0.0;
        }
        let along = step - gradient * (gradient.dot(&step) / gradient.norm_squared());
        mesh.vertices[i] = onto_surface(tubes, &(point + along), mesh.on_plane[i]);
    }
}

fn onto_surface(tubes: &[Tube], point: &Vector3<f64>, on_plane: bool) -> Vector3<f64> {
    let mut point = *point;
    for _ in 0..2 {
        let gradient = body_gradient(tubes, &point);
        point -= gradient * (body_distance(tubes, &point) / gradient.norm_squared());
        point.x = if on_plane { 0.0 } else { point.x.max(0.0) };
    }
    point
}

/// The faces on both sides of every edge, by its ends in ascending order.
fn faces_of_edges(faces: &[[usize; 3]]) -> BTreeMap<[usize; 2], Vec<usize>> {
    let mut edges: BTreeMap<[usize; 2], Vec<usize>> = BTreeMap::new();
    for (f, [a, b, c]) in faces.iter().enumerate() {
        for (i, j) in [(*a, *b), (*b, *c), (*c, *a)] {
            edges.entry([i.min(j), i.max(j)]).or_default().push(f);
        }
    }
    edges
}

/// Flips every edge whose flip raises the smallest angle of its two triangles and does not fold the surface.
fn flip_edges(mesh: &mut HalfMesh) {
    for _ in 0..4 {
        let edges = faces_of_edges(&mesh.faces);
        let mut touched = vec![false; mesh.faces.len()];
        let mut flipped = BTreeSet::new();
        for (&[i, j], sides) in &edges {
            let &[f, g] = sides.as_slice() else { continue };
            if touched[f] || touched[g] {
                continue;
            }
            // f contains i -> j in this direction or the reverse; a is opposite to it in f, b in g.
            let runs_forward = (0..3).any(|k| mesh.faces[f][k] == i && mesh.faces[f][(k + 1) % 3] == j);
            let (i, j) = if runs_forward { (i, j) } else { (j, i) };
            let (a, b) = (opposite(mesh.faces[f], i, j), opposite(mesh.faces[g], i, j));
            let new_edge = [a.min(b), a.max(b)];
            if a == b || edges.contains_key(&new_edge) || flipped.contains(&new_edge) {
                continue;
            }
            let (old, new) = ([[i, j, a], [j, i, b]], [[a, b, j], [b, a, i]]);
            let quality =
                |pair: [[usize; 3]; 2]| smallest_angle_cosine(mesh, pair[0]).max(smallest_angle_cosine(mesh, pair[1]));
            let normal = |face: [usize; 3]| normal_of(mesh, face);
            let is_flat = normal(new[0]).dot(&normal(new[1])) > 0.5 && normal(old[0]).dot(&normal(new[0])) > 0.5;
            if is_flat && quality(new) < quality(old) - 1e-3 {
                mesh.faces[f] = new[0];
                mesh.faces[g] = new[1];
                touched[f] = true;
                touched[g] = true;
                flipped.insert(new_edge);
            }
        }
        if flipped.is_empty() {
            return;
        }
    }
}

fn opposite(face: [usize; 3], i: usize, j: usize) -> usize {
    face.into_iter().find(|v| *v != i && *v != j).unwrap_or(i)
}

fn normal_of(mesh: &HalfMesh, face: [usize; 3]) -> Vector3<f64> {
    let [a, b, c] = face.map(|v| mesh.vertices[v]);
    (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_else(Vector3::zeros)
}

/// Cosine of the triangle's smallest angle: the largest of the three cosines, 1 where it is degenerate.
fn smallest_angle_cosine(mesh: &HalfMesh, face: [usize; 3]) -> f64 {
    let corners = face.map(|v| mesh.vertices[v]);
    (0..3)
        .map(|k| {
            let (u, v) = (corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]);
            let scale = (u.norm_squared() * v.norm_squared()).sqrt();
            if scale > 0.0 { u.dot(&v) / scale } else { 1.0 }
        })
        .fold(-1.0, f64::max)
}

/// Merges the ends of short edges where the surface stays a surface; returns whether it merged any.
///
/// The ends may share exactly the two vertices opposite the edge (link condition), and vertices of the plane do not move.
/// Edges merged in one call do not share neighbours.
fn collapse_short_edges(mesh: &mut HalfMesh) -> bool {
    let near = neighbours(mesh);
    let mut target: Vec<usize> = (0..mesh.vertices.len()).collect();
    let mut locked = vec![false; mesh.vertices.len()];
    let edges = faces_of_edges(&mesh.faces);
    for (&[i, j], sides) in &edges {
        let is_short = (mesh.vertices[i] - mesh.vertices[j]).norm() < SHORTEST;
        let n_shared = near[i].iter().filter(|v| near[j].contains(v)).count();
        let may =
            n_shared == sides.len() && sides.len() == 2 && mesh.on_plane[i] == mesh.on_plane[j] && !mesh.on_plane[i];
        if !is_short || !may || near[i].iter().chain(&near[j]).any(|v| locked[*v]) {
            continue;
        }
        mesh.vertices[i] = (mesh.vertices[i] + mesh.vertices[j]) * 0.5;
        target[j] = i;
        near[i].iter().chain(&near[j]).for_each(|v| locked[*v] = true);
    }
    let merged = target.iter().enumerate().any(|(i, t)| *t != i);
    if merged {
        drop_merged(mesh, &target);
    }
    merged
}

fn drop_merged(mesh: &mut HalfMesh, target: &[usize]) {
    let mut new_index = vec![usize::MAX; target.len()];
    let kept: Vec<usize> = (0..target.len()).filter(|&i| target[i] == i).collect();
    kept.iter().enumerate().for_each(|(new, &old)| new_index[old] = new);
    mesh.vertices = kept.iter().map(|&i| mesh.vertices[i]).collect();
    mesh.on_plane = kept.iter().map(|&i| mesh.on_plane[i]).collect();
    let renamed = mesh.faces.iter().map(|face| face.map(|v| new_index[target[v]]));
    mesh.faces = renamed.filter(|[a, b, c]| a != b && b != c && c != a).collect();
}
