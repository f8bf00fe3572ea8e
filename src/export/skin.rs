//! The mesh of a person in the rest pose with its skin weights, for scenes.
//!
//! Linear blend skinning of at most four joints a vertex, which all programs support. Known limits: the pose directions of a
//! body ([`crate::body::skinning`]) cannot be represented; the default body has none.

use crate::body::model::Betas;
use crate::body::surface::JointWeight;
use crate::body::{BodyModel, default_body, skeleton::N_JOINTS};
use crate::session::BodyMotion;
use crate::session::reconstruction::BodyModelId;
use nalgebra::Vector3;

/// The default body, where a result refers to it: the only body whose mesh everyone may distribute.
pub(super) fn free_body(model: &BodyModelId) -> Option<BodyModel> {
    let body = default_body();
    (body.sha256() == model.sha256).then_some(body)
}

/// Largest number of joints of a vertex: what a graphics card takes in one attribute. The default body has no vertex with more.
pub(super) const MAX_JOINTS_PER_VERTEX: usize = 4;

/// A mesh in the rest pose: y up, facing +z, metres. V vertices, F faces.
pub(super) struct SkinMesh {
    /// `[V]`, m.
    pub(super) vertices: Vec<Vector3<f64>>,
    /// Unit normals. `[V]`
    pub(super) normals: Vec<Vector3<f64>>,
    /// Triangles, anticlockwise from outside. `[F]`
    pub(super) faces: Vec<[usize; 3]>,
    /// Joints and weights of every vertex. `[V]`
    pub(super) skin: Vec<[JointWeight; MAX_JOINTS_PER_VERTEX]>,
}

/// The mesh of a person's shape.
pub(super) fn skin_mesh(body: &BodyModel, motion: &BodyMotion) -> SkinMesh {
    let vertices = body.surface.shaped(&Betas::from(motion.betas));
    SkinMesh {
        normals: normals(&vertices, &body.surface.faces),
        skin: body.surface.skin.iter().map(|row| strongest_joints(row)).collect(),
        faces: body.surface.faces.clone(),
        vertices,
    }
}

/// The joints of a vertex with the largest weights, in descending order; the weights sum to 1, missing ones are 0.
pub(super) fn strongest_joints(row: &[JointWeight]) -> [JointWeight; MAX_JOINTS_PER_VERTEX] {
    let mut strongest = row.to_vec();
    strongest.sort_by(|a, b| b.weight.total_cmp(&a.weight).then(a.joint.cmp(&b.joint)));
    strongest.resize(MAX_JOINTS_PER_VERTEX, JointWeight { joint: 0, weight: 0.0 });
    let total: f64 = strongest.iter().map(|one| one.weight).sum();
    std::array::from_fn(|i| JointWeight {
        joint: strongest[i].joint,
        weight: strongest[i].weight / total.max(f64::MIN_POSITIVE),
    })
}

/// Vertices of each joint with their weights, vertices in ascending order.
pub(super) fn vertices_by_joint(mesh: &SkinMesh) -> [Vec<(usize, f64)>; N_JOINTS] {
    let mut by_joint = [const { Vec::new() }; N_JOINTS];
    for (vertex, row) in mesh.skin.iter().enumerate() {
        for one in row.iter().filter(|one| one.weight > 0.0) {
            by_joint[one.joint].push((vertex, one.weight));
        }
    }
    by_joint
}

/// Normals of vertices: the sum of the faces' normals, weighted by their areas.
fn normals(vertices: &[Vector3<f64>], faces: &[[usize; 3]]) -> Vec<Vector3<f64>> {
    let mut sums = vec![Vector3::zeros(); vertices.len()];
    for &[a, b, c] in faces {
        let doubled_area = (vertices[b] - vertices[a]).cross(&(vertices[c] - vertices[a]));
        [a, b, c].into_iter().for_each(|corner| sums[corner] += doubled_area);
    }
    sums.iter().map(|sum| sum.try_normalize(f64::MIN_POSITIVE).unwrap_or_else(Vector3::y)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keeps_the_strongest_joints_with_a_sum_of_one() {
        let row: Vec<JointWeight> = [(3, 0.1), (5, 0.4), (1, 0.1), (7, 0.25), (9, 0.15)]
            .map(|(joint, weight)| JointWeight { joint, weight })
            .into();
        let strongest = strongest_joints(&row);
        assert_eq!(strongest.map(|one| one.joint), [5, 7, 9, 1], "of equal weights the first joint");
        assert!((strongest.iter().map(|one| one.weight).sum::<f64>() - 1.0).abs() < 1e-12);
        assert!((strongest[0].weight - 0.4 / 0.9).abs() < 1e-12);
        let single = strongest_joints(&row[..1]);
        assert_eq!((single[0].joint, single[0].weight, single[3].weight), (3, 1.0, 0.0));
    }

    #[test]
    fn normals_of_a_tetrahedron_point_outwards() {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(Vector3::from);
        let faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        let centre = corners.iter().sum::<Vector3<f64>>() / 4.0;
        for (corner, normal) in corners.iter().zip(normals(&corners, &faces)) {
            assert!((normal.norm() - 1.0).abs() < 1e-12 && normal.dot(&(corner - centre)) > 0.0);
        }
    }
}
