//! Named points on the body, as per-bone constants.
//!
//! A point of the skin is a sum over few bones, equal to the full mesh under linear blend skinning (docs/method.md): with
//! shares `r_i` of vertices and skin weights `w_ib`, bone b contributes its position times `a_b = sum_i r_i w_ib` and the
//! offset `sum_i r_i w_ib (T_i - J_b) + sum_i r_i w_ib (S_i - S_b) beta`.
//!
//! Known limit: a user's pose blend shapes are ignored here (skinning applies them); they move surface points by some
//! millimetres, joints not at all.

use super::shape::ShapeDirections;
use super::skeleton::{JOINT_NAMES, KeypointConvention, N_JOINTS};
use super::surface::{JointWeight, Surface, VertexWeight};
use nalgebra::Vector3;
use std::collections::BTreeSet;

/// Name of the landmark at SMPL's neck joint; `neck` is the detectors' point between the shoulders.
pub const NECK_JOINT: &str = "neck_joint";

/// The joints in the middle of which a keypoint lies, for those that lie between joints.
pub(super) fn ends_of_midpoint(name: &str) -> Option<[&'static str; 2]> {
    match name {
        "neck" => Some(["left_shoulder", "right_shoulder"]),
        "mid_hip" => Some(["left_hip", "right_hip"]),
        _ => None,
    }
}

/// A named point: a sum over bones that moves with them, `sum_i [ w_i p_i + G_i (a_i + A_i beta) ]`.
///
/// `p_i`, `G_i`: posed joint and `world_from_joint` rotation. The weights sum to 1. This form is exact for a point under
/// linear blend skinning, a joint, a midpoint and a point fixed to one bone.
#[derive(Debug, Clone, PartialEq)]
pub struct Landmark {
    /// Keypoint name as in the conventions.
    pub name: String,
    /// Its terms, one a bone.
    pub terms: Vec<LandmarkTerm>,
}

/// One bone's part of a [`Landmark`].
#[derive(Debug, Clone, PartialEq)]
pub struct LandmarkTerm {
    /// The joint in whose frame this part is fixed.
    pub joint: usize,
    /// Share of the joint's own position.
    pub weight: f64,
    /// Rest offset in the joint's frame at beta 0, already weighted, m.
    pub offset: Vector3<f64>,
    /// Change of the offset per beta, already weighted, m.
    pub offset_directions: ShapeDirections,
}

/// All landmarks of a body that any convention names: joints, midpoints, and named points of the skin.
///
/// The detectors' `neck` is the midpoint of the shoulders and their `mid_hip` that of the hips, unlike SMPL's joints of
/// similar names.
pub(super) fn landmarks(
    surface: &Surface,
    rest_joints: &[Vector3<f64>; N_JOINTS],
    shape_directions: &[ShapeDirections; N_JOINTS],
) -> Vec<Landmark> {
    let terms = |name: &str| -> Option<Vec<LandmarkTerm>> {
        let joint = |name: &str| JOINT_NAMES.iter().position(|n| *n == name);
        if let Some([left, right]) = ends_of_midpoint(name) {
            return Some(vec![joint_term(joint(left)?, 0.5), joint_term(joint(right)?, 0.5)]);
        }
        if name == NECK_JOINT {
            return Some(vec![joint_term(joint("neck")?, 1.0)]);
        }
        match surface.points.iter().find(|point| point.name == name) {
            Some(point) => Some(skin_terms(surface, &point.vertices, rest_joints, shape_directions)),
            None => Some(vec![joint_term(joint(name)?, 1.0)]),
        }
    };
    let conventions = KeypointConvention::ALL.iter().flat_map(|c| c.names().iter().copied());
    let names: BTreeSet<&str> = conventions.chain([NECK_JOINT]).collect();
    names.iter().filter_map(|name| Some(Landmark { name: (*name).to_owned(), terms: terms(name)? })).collect()
}

fn joint_term(joint: usize, weight: f64) -> LandmarkTerm {
    LandmarkTerm { joint, weight, offset: Vector3::zeros(), offset_directions: ShapeDirections::zeros() }
}

fn skin_terms(
    surface: &Surface,
    shares: &[VertexWeight],
    rest_joints: &[Vector3<f64>; N_JOINTS],
    shape_directions: &[ShapeDirections; N_JOINTS],
) -> Vec<LandmarkTerm> {
    let mut terms: Vec<LandmarkTerm> = (0..N_JOINTS).map(|j| joint_term(j, 0.0)).collect();
    for VertexWeight { vertex, weight: share } in shares {
        for JointWeight { joint, weight } in &surface.skin[*vertex] {
            let (weight, term) = (share * weight, &mut terms[*joint]);
            term.weight += weight;
            term.offset += (surface.vertices[*vertex] - rest_joints[*joint]) * weight;
            term.offset_directions += (surface.shape_directions[*vertex] - shape_directions[*joint]) * weight;
        }
    }
    terms.retain(|term| term.weight != 0.0);
    terms
}
