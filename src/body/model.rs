//! The body model of the fit and of the mesh: joints and landmarks, which need no vertices, and the surface that defines
//! them.

use super::landmarks::landmarks;
use super::measures::girth_direction;
use super::mocap_skeleton::mocap_from_body;
use super::skeleton::{KeypointConvention, N_JOINTS};
use super::surface::{Surface, VertexWeight};
use nalgebra::{Matrix3, Vector3};
use sha2::{Digest, Sha256};
use std::sync::Arc;

pub use super::landmarks::{Landmark, LandmarkTerm, NECK_JOINT};
pub use super::shape::{Betas, ShapeDirections};

/// A body model in SMPL's conventions: y up, facing +z, left is +x, metres; the rest pose is a T-pose with all joint
/// frames parallel to the world; joint tree and order of [`super::skeleton`].
#[derive(Debug, Clone, PartialEq)]
pub struct BodyModel {
    /// Name of the model.
    pub name: String,
    /// `J0`: rest joints of the mean shape, m.
    pub rest_joints: [Vector3<f64>; N_JOINTS],
    /// Zero pose of the mocap skeleton ([`mocap_from_body`]), computed from the joints of the loaded skin; moving joints
    /// does not change it.
    pub mocap_from_body: [Matrix3<f64>; N_JOINTS],
    /// `S`: rest joints of shape beta are `J(beta) = J0 + S beta`.
    pub shape_directions: [ShapeDirections; N_JOINTS],
    /// Named points on the body that detectors report.
    pub landmarks: Vec<Landmark>,
    /// Direction of the betas that changes girths at a constant stature, unit length.
    pub girth_direction: Betas,
    /// The mesh that defines joints and landmarks.
    pub surface: Arc<Surface>,
}

/// A body model at one shape.
#[derive(Debug, Clone, PartialEq)]
pub struct ShapedBody {
    /// `J(beta)`, m.
    pub rest_joints: [Vector3<f64>; N_JOINTS],
    /// `offsets[landmark][term]` in the bone's frame, m.
    pub landmark_offsets: Vec<Vec<Vector3<f64>>>,
}

impl BodyModel {
    /// The body of a surface; its joints are the regressor applied to the mesh.
    pub fn new(name: String, surface: Surface) -> Self {
        let row = |j: usize| surface.regressor[j].iter();
        let rest_joint = |v: &VertexWeight| surface.vertices[v.vertex] * v.weight;
        let direction = |v: &VertexWeight| surface.shape_directions[v.vertex] * v.weight;
        let rest_joints = std::array::from_fn(|j| row(j).map(rest_joint).sum());
        let shape_directions = std::array::from_fn(|j| row(j).map(direction).sum());
        let landmarks = landmarks(&surface, &rest_joints, &shape_directions);
        let mocap_from_body = mocap_from_body(&rest_joints);
        let girth_direction = girth_direction(&surface);
        Self {
            name,
            rest_joints,
            mocap_from_body,
            shape_directions,
            landmarks,
            girth_direction,
            surface: Arc::new(surface),
        }
    }

    /// The model at shape `betas`.
    pub fn shaped(&self, betas: &Betas) -> ShapedBody {
        let offset = |t: &LandmarkTerm| t.offset + t.offset_directions * betas;
        ShapedBody {
            rest_joints: std::array::from_fn(|j| self.rest_joints[j] + self.shape_directions[j] * betas),
            landmark_offsets: self.landmarks.iter().map(|l| l.terms.iter().map(offset).collect()).collect(),
        }
    }

    /// The same skin with moved rest joints: joint j moves by `shifts[j]`, m.
    ///
    /// Landmarks on the skin keep their rest positions, landmarks at joints move with them.
    pub fn with_joints_moved(&self, shifts: &[Vector3<f64>; N_JOINTS]) -> Self {
        let rest_joints = std::array::from_fn(|j| self.rest_joints[j] + shifts[j]);
        let landmarks = landmarks(&self.surface, &rest_joints, &self.shape_directions);
        Self { rest_joints, landmarks, ..self.clone() }
    }

    /// Index of a landmark by keypoint name.
    pub fn landmark_index(&self, name: &str) -> Option<usize> {
        self.landmarks.iter().position(|l| l.name == name)
    }

    /// For every named keypoint of a convention the index of its landmark, if the body has one.
    ///
    /// A detector's `neck` is the midpoint of the shoulders; `neck` of the SMPL joints is the landmark [`NECK_JOINT`].
    pub fn landmarks_of(&self, convention: KeypointConvention) -> Vec<Option<usize>> {
        let shown = |name: &&'static str| match (convention, *name) {
            (KeypointConvention::Smpl24, "neck") => NECK_JOINT,
            _ => name,
        };
        convention.names().iter().map(|name| self.landmark_index(shown(name))).collect()
    }

    /// SHA-256 over every number and name of the model, as lowercase hexadecimal digits.
    pub fn sha256(&self) -> String {
        let mut hash = Sha256::new();
        hash.update(self.name.as_bytes());
        let mut number = |value: &f64| hash.update(value.to_le_bytes());
        for j in 0..N_JOINTS {
            self.rest_joints[j].iter().chain(self.shape_directions[j].iter()).for_each(&mut number);
        }
        for landmark in &self.landmarks {
            hash.update(landmark.name.as_bytes());
            for term in &landmark.terms {
                hash.update((term.joint as u64).to_le_bytes());
                let mut number = |value: &f64| hash.update(value.to_le_bytes());
                number(&term.weight);
                term.offset.iter().chain(term.offset_directions.iter()).for_each(&mut number);
            }
        }
        self.surface.digest_into(&mut hash);
        hex::encode(hash.finalize())
    }
}

#[cfg(test)]
mod tests {
    use super::super::default_body::default_body;
    use super::super::kinematics::{Pose, landmark_position, posed};
    use super::*;

    #[test]
    fn moving_joints_keeps_the_skin_at_rest() {
        let model = default_body();
        assert_eq!(model.with_joints_moved(&[Vector3::zeros(); N_JOINTS]), model);
        let shift = Vector3::new(0.01, -0.02, 0.03);
        let moved = model.with_joints_moved(&[shift; N_JOINTS]);
        let place = |model: &BodyModel, name: &str| {
            let body = model.shaped(&Betas::repeat(0.5));
            landmark_position(model, &body, &posed(&body, &Pose::rest()), model.landmark_index(name).unwrap())
        };
        assert!((place(&moved, "left_heel") - place(&model, "left_heel")).norm() < 1e-12);
        assert!((place(&moved, "left_knee") - place(&model, "left_knee") - shift).norm() < 1e-12);
    }

    #[test]
    fn the_digest_covers_every_number() {
        let model = default_body();
        let digest = model.sha256();
        assert_eq!(digest.len(), 64);
        assert_eq!(digest, default_body().sha256());
        let mut other = model.clone();
        other.landmarks[3].terms[0].offset.x += 1e-12;
        assert_ne!(digest, other.sha256());
        let mut other = model;
        other.shape_directions[20][(2, 9)] += 1e-12;
        assert_ne!(digest, other.sha256());
    }
}
