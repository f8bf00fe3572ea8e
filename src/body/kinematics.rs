//! Forward kinematics and its derivatives.
//!
//! SMPL's convention (docs/method.md): the root turns about the rest pelvis `J_0(beta)`, then `translation` is added:
//! `p_0 = J_0 + T`, `p_j = p_par + G_par (J_j - J_par)`, `G_0 = R_0`, `G_j = G_par R_j`.

use super::model::{BodyModel, Landmark, ShapeDirections, ShapedBody};
use super::skeleton::{JOINT_COUNTERPARTS, N_JOINTS, PARENTS, chain_to_root};
use crate::geometry::rotation::{self, skew};
use nalgebra::{Matrix3, Vector3};

/// One pose: local rotations `parent_from_joint` (entry 0: `world_from_pelvis`) and SMPL's translation, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Local rotations in SMPL's joint order.
    pub rotations: [Matrix3<f64>; N_JOINTS],
    /// Added after the rotation about the rest pelvis, m.
    pub translation: Vector3<f64>,
}

impl Pose {
    /// The T-pose, facing +z.
    pub fn rest() -> Self {
        Self { rotations: [Matrix3::identity(); N_JOINTS], translation: Vector3::zeros() }
    }

    /// The pose a share of the way to another one, each joint turning at a constant rate.
    pub fn towards(&self, other: &Self, share: f64) -> Self {
        let turned = |joint: usize| rotation::towards(&self.rotations[joint], &other.rotations[joint], share);
        Self { rotations: std::array::from_fn(turned), translation: self.translation.lerp(&other.translation, share) }
    }
}

/// Rotations of the mirror image at the plane x = 0, with left and right exchanged.
pub fn mirrored_rotations(rotations: &[Matrix3<f64>; N_JOINTS]) -> [Matrix3<f64>; N_JOINTS] {
    let mirror = Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, 1.0));
    JOINT_COUNTERPARTS.map(|joint| mirror * rotations[joint] * mirror)
}

/// A posed skeleton in the world.
#[derive(Debug, Clone, PartialEq)]
pub struct PosedSkeleton {
    /// `world_from_joint`.
    pub rotations: [Matrix3<f64>; N_JOINTS],
    /// Joint positions, m.
    pub joints: [Vector3<f64>; N_JOINTS],
}

/// Poses a body of a given shape.
pub fn posed(body: &ShapedBody, pose: &Pose) -> PosedSkeleton {
    let mut rotations = pose.rotations;
    let mut joints = [body.rest_joints[0] + pose.translation; N_JOINTS];
    for (j, parent) in PARENTS.iter().enumerate() {
        if let Some(p) = *parent {
            joints[j] = joints[p] + rotations[p] * (body.rest_joints[j] - body.rest_joints[p]);
            rotations[j] = rotations[p] * pose.rotations[j];
        }
    }
    PosedSkeleton { rotations, joints }
}

/// Position of a landmark (by index in the model) in the world, m.
pub fn landmark_position(
    model: &BodyModel,
    body: &ShapedBody,
    skeleton: &PosedSkeleton,
    landmark: usize,
) -> Vector3<f64> {
    let terms = model.landmarks[landmark].terms.iter().zip(&body.landmark_offsets[landmark]);
    terms.map(|(t, offset)| skeleton.joints[t.joint] * t.weight + skeleton.rotations[t.joint] * offset).sum()
}

/// The joints whose rotation moves a landmark, in ascending order: of a term without offset only the joint's ancestors.
pub fn moving_joints(landmark: &Landmark) -> Vec<usize> {
    let mut moves = [false; N_JOINTS];
    for term in &landmark.terms {
        let turns = term.offset != Vector3::zeros() || term.offset_directions != ShapeDirections::zeros();
        chain_to_root(term.joint).skip(usize::from(!turns)).for_each(|j| moves[j] = true);
    }
    (0..N_JOINTS).filter(|&j| moves[j]).collect()
}

/// Derivative of a landmark's position to the local right increment `R_a <- R_a exp(d)` of joint `a` (m per rad):
/// `-[q - w p_a]x G_a`, summed over the terms that `a` moves, with the term's value `q` and weight `w`.
pub fn landmark_by_rotation(
    model: &BodyModel,
    body: &ShapedBody,
    skeleton: &PosedSkeleton,
    landmark: usize,
    joint: usize,
) -> Matrix3<f64> {
    let mut lever = Vector3::zeros();
    for (term, offset) in model.landmarks[landmark].terms.iter().zip(&body.landmark_offsets[landmark]) {
        if chain_to_root(term.joint).any(|j| j == joint) {
            let arm = skeleton.joints[term.joint] - skeleton.joints[joint];
            lever += arm * term.weight + skeleton.rotations[term.joint] * offset;
        }
    }
    -skew(&lever) * skeleton.rotations[joint]
}

/// The same of a joint's position: zero where `ancestor` is not above it.
pub fn joint_by_rotation(skeleton: &PosedSkeleton, joint: usize, ancestor: usize) -> Matrix3<f64> {
    let is_above = chain_to_root(joint).skip(1).any(|j| j == ancestor);
    let arm = skeleton.joints[joint] - skeleton.joints[ancestor];
    if is_above { -skew(&arm) * skeleton.rotations[ancestor] } else { Matrix3::zeros() }
}

/// Derivatives of all joints to the betas: `S_0 + sum over the path of G_par(k) (S_k - S_par(k))`, m.
pub fn joints_by_betas(model: &BodyModel, skeleton: &PosedSkeleton) -> [ShapeDirections; N_JOINTS] {
    let mut by_betas = [model.shape_directions[0]; N_JOINTS];
    for (j, parent) in PARENTS.iter().enumerate() {
        if let Some(p) = *parent {
            by_betas[j] = by_betas[p] + skeleton.rotations[p] * (model.shape_directions[j] - model.shape_directions[p]);
        }
    }
    by_betas
}

/// Derivative of a landmark to the betas, given that of the joints, m.
pub fn landmark_by_betas(
    landmark: &Landmark,
    skeleton: &PosedSkeleton,
    joints_by_betas: &[ShapeDirections; N_JOINTS],
) -> ShapeDirections {
    let term = |t: &super::model::LandmarkTerm| {
        joints_by_betas[t.joint] * t.weight + skeleton.rotations[t.joint] * t.offset_directions
    };
    landmark.terms.iter().fold(ShapeDirections::zeros(), |sum, t| sum + term(t))
}

#[cfg(test)]
mod tests {
    use super::super::default_body::default_body;
    use super::super::model::Betas;
    use super::*;
    use crate::geometry::rotation::exp;

    fn some_pose() -> Pose {
        let turn =
            |j: usize| Vector3::new((j as f64 * 1.3).sin(), (j as f64 * 0.7).cos(), (j as f64 * 2.1).sin()) * 0.6;
        Pose { rotations: std::array::from_fn(|j| exp(&turn(j))), translation: Vector3::new(0.3, -0.2, 1.1) }
    }

    #[test]
    fn the_root_turns_about_the_rest_pelvis() {
        let body = default_body().shaped(&Betas::repeat(0.5));
        let mut pose = Pose::rest();
        pose.rotations[0] = exp(&(Vector3::y() * std::f64::consts::PI));
        let turned = posed(&body, &pose);
        for (rest, joint) in body.rest_joints.iter().zip(turned.joints) {
            let about = rest - body.rest_joints[0];
            let expected = body.rest_joints[0] + Vector3::new(-about.x, about.y, -about.z);
            assert!((joint - expected).norm() < 1e-9);
        }
    }

    #[test]
    fn bones_keep_their_length_in_any_pose() {
        let body = default_body().shaped(&Betas::repeat(-0.8));
        let skeleton = posed(&body, &some_pose());
        for (j, parent) in PARENTS.iter().enumerate().skip(1) {
            let p = parent.unwrap();
            let rest = (body.rest_joints[j] - body.rest_joints[p]).norm();
            assert!(((skeleton.joints[j] - skeleton.joints[p]).norm() - rest).abs() < 1e-12);
        }
    }

    /// Central differences with a step of 1e-6 are good to 1e-9; every landmark, joint and beta.
    #[test]
    fn derivatives_agree_with_central_differences() {
        let model = default_body();
        let betas = Betas::from_fn(|i, _| 0.3 * i as f64 - 1.0);
        let pose = some_pose();
        let (body, h) = (model.shaped(&betas), 1e-6);
        let skeleton = posed(&body, &pose);
        let by_betas = joints_by_betas(&model, &skeleton);
        for (joint, ancestor) in (0..N_JOINTS).flat_map(|joint| (0..N_JOINTS).map(move |ancestor| (joint, ancestor))) {
            let jacobian = joint_by_rotation(&skeleton, joint, ancestor);
            for axis in 0..3 {
                let stepped = |h: f64| {
                    let mut p = pose;
                    p.rotations[ancestor] *= exp(&Vector3::ith(axis, h));
                    posed(&body, &p).joints[joint]
                };
                let difference = (stepped(h) - stepped(-h)) / (2.0 * h);
                assert!((difference - jacobian.column(axis)).norm() < 1e-8, "{joint} about {ancestor}");
            }
        }
        for l in 0..model.landmarks.len() {
            let at = |pose: &Pose, betas: &Betas| {
                let body = model.shaped(betas);
                landmark_position(&model, &body, &posed(&body, pose), l)
            };
            for joint in 0..N_JOINTS {
                let jacobian = landmark_by_rotation(&model, &body, &skeleton, l, joint);
                for axis in 0..3 {
                    let stepped = |h: f64| {
                        let mut p = pose;
                        p.rotations[joint] *= exp(&(Vector3::ith(axis, h)));
                        at(&p, &betas)
                    };
                    let difference = (stepped(h) - stepped(-h)) / (2.0 * h);
                    assert!((difference - jacobian.column(axis)).norm() < 1e-8);
                    let moves = moving_joints(&model.landmarks[l]).contains(&joint);
                    assert!(moves || difference.norm() < 1e-9);
                }
            }
            let jacobian = landmark_by_betas(&model.landmarks[l], &skeleton, &by_betas);
            for k in 0..10 {
                let stepped = |h: f64| at(&pose, &(betas + Betas::ith(k, h)));
                let difference = (stepped(h) - stepped(-h)) / (2.0 * h);
                assert!((difference - jacobian.column(k)).norm() < 1e-8);
            }
        }
    }
}
