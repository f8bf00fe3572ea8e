//! Linear blend skinning: the mesh of a shape in a pose.

use super::kinematics::{Pose, posed};
use super::model::{Betas, BodyModel};
use super::skeleton::N_JOINTS;
use super::surface::{JointWeight, N_POSE_FEATURES};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

/// Vertices of a body in a pose, world, m.
///
/// `v_i = sum_j w_ij (G_j (x_i - J_j) + p_j)`, `x = T + S beta + P phi`, with joints posed as in [`super::kinematics`] and
/// `phi` the entries of `R_1 .. R_23 - I`, row by row (Loper et al. 2015, Eqs. 2 to 9). P is zero in the default body.
pub fn skinned(model: &BodyModel, betas: &Betas, pose: &Pose) -> Vec<Vector3<f64>> {
    let (surface, skeleton) = (&model.surface, posed(&model.shaped(betas), pose));
    let rest_joints = model.shaped(betas).rest_joints;
    let offsets: [Vector3<f64>; N_JOINTS] =
        std::array::from_fn(|j| skeleton.joints[j] - skeleton.rotations[j] * rest_joints[j]);
    let feature = pose_feature(pose);
    let vertex = |i: usize| {
        let rest = surface.vertices[i] + surface.shape_directions[i] * betas + pose_offset(model, &feature, i);
        let moved = |s: &JointWeight| (skeleton.rotations[s.joint] * rest + offsets[s.joint]) * s.weight;
        surface.skin[i].iter().map(moved).sum()
    };
    (0..surface.vertices.len()).into_par_iter().map(vertex).collect()
}

/// `phi`, without the root.
fn pose_feature(pose: &Pose) -> [f64; N_POSE_FEATURES] {
    std::array::from_fn(|k| {
        let turn = pose.rotations[1 + k / 9] - Matrix3::identity();
        turn[(k % 9 / 3, k % 3)]
    })
}

fn pose_offset(model: &BodyModel, feature: &[f64; N_POSE_FEATURES], vertex: usize) -> Vector3<f64> {
    let start = 3 * N_POSE_FEATURES * vertex;
    let Some(rows) = model.surface.pose_directions.get(start..start + 3 * N_POSE_FEATURES) else {
        return Vector3::zeros();
    };
    let row = |axis: usize| rows[axis * N_POSE_FEATURES..].iter().zip(feature).map(|(p, f)| f64::from(*p) * f).sum();
    Vector3::from_fn(|axis, _| row(axis))
}
