//! Joints of the default skeleton from features, with the backward pass, for the training loss and the evaluation.
//!
//! The root is ignored: the pelvis is at the origin with rotation identity. Collars and hands are at identity.

use super::chart::{Chart, Features, LATENT_JOINTS, N_FEATURES};
use crate::body::skeleton::{N_JOINTS, PARENTS};
use crate::body::{Betas, default_body};
use crate::geometry::rotation;
use nalgebra::{Matrix3, Vector3};

/// Joint positions of one frame, m, pelvis at the origin.
pub type JointPositions = [Vector3<f64>; N_JOINTS];

/// Offsets from the parent joints of the default body at its mean shape, m.
#[derive(Debug, Clone, PartialEq)]
pub struct Bones([Vector3<f64>; N_JOINTS]);

/// A posed skeleton.
pub struct Posed {
    /// Joints, m.
    pub joints: JointPositions,
    /// `pelvis_from_joint`.
    pub rotations: [Matrix3<f64>; N_JOINTS],
}

impl Bones {
    /// The bones of the default body.
    pub fn of_default_body() -> Self {
        let rest = default_body().shaped(&Betas::zeros()).rest_joints;
        Self(std::array::from_fn(|j| PARENTS[j].map_or_else(Vector3::zeros, |p| rest[j] - rest[p])))
    }

    /// Forward kinematics (docs/method.md) from local rotations without the root.
    pub fn posed(&self, local: &[Matrix3<f64>; N_JOINTS]) -> Posed {
        let mut posed = Posed { joints: [Vector3::zeros(); N_JOINTS], rotations: [Matrix3::identity(); N_JOINTS] };
        for (j, parent) in PARENTS.iter().enumerate() {
            if let Some(p) = *parent {
                posed.joints[j] = posed.joints[p] + posed.rotations[p] * self.0[j];
                posed.rotations[j] = posed.rotations[p] * local[j];
            }
        }
        posed
    }

    /// Joints from features, m.
    pub fn joints(&self, chart: &Chart, features: &Features) -> JointPositions {
        self.posed(&chart.rotations(features)).joints
    }

    /// Gradient to the features from that to the joints.
    ///
    /// A right increment d of joint a moves every joint c below it by `-[p_c - p_a]x G_a d` (as in
    /// [`crate::body::kinematics::landmark_by_rotation`]), so that its gradient is `G_a^T sum (p_c - p_a) x f_c`; sums of
    /// forces and moments run from the leaves to the root. `exp(u + e) = exp(u) exp(J_r(u) e)` leads to the features.
    pub fn pull_back(
        &self,
        posed: &Posed,
        features: &Features,
        d_joints: &[Vector3<f64>; N_JOINTS],
        d_features: &mut Features,
    ) {
        let mut forces = *d_joints;
        let mut moments = [Vector3::zeros(); N_JOINTS];
        for j in (1..N_JOINTS).rev() {
            let p = PARENTS[j].unwrap_or(0);
            let (force, moment) = (forces[j], moments[j]);
            forces[p] += force;
            moments[p] += moment + (posed.joints[j] - posed.joints[p]).cross(&force);
        }
        for (i, joint) in LATENT_JOINTS.iter().enumerate() {
            let u = Vector3::from_column_slice(&features[3 * i..3 * i + 3]);
            let local = posed.rotations[*joint].tr_mul(&moments[*joint]);
            let d = rotation::right_jacobian(&u).tr_mul(&local);
            (0..3).for_each(|axis| d_features[3 * i + axis] += d[axis]);
        }
    }
}

/// Single precision rows of features as double precision frames.
pub(crate) fn frame(row: &[f32]) -> Features {
    std::array::from_fn(|i| f64::from(row[i]))
}

/// Features of frames in single precision, one after the other.
pub(crate) fn rows(features: &[Features]) -> Vec<f32> {
    let mut rows = Vec::with_capacity(features.len() * N_FEATURES);
    features.iter().for_each(|f| rows.extend(f.iter().map(|v| *v as f32)));
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Central differences with a step of 1e-6 are good to 1e-8.
    #[test]
    fn the_backward_pass_agrees_with_differences() {
        let bones = Bones::of_default_body();
        let chart = Chart { means: [rotation::exp(&Vector3::new(0.2, -0.4, 0.1)); LATENT_JOINTS.len()] };
        let features: Features = std::array::from_fn(|i| (1.7 * i as f64).sin() * 0.8);
        let pull: [Vector3<f64>; N_JOINTS] =
            std::array::from_fn(|j| Vector3::new((j as f64).sin(), 0.3, (2.0 * j as f64).cos()));
        let value =
            |features: &Features| bones.joints(&chart, features).iter().zip(&pull).map(|(p, f)| p.dot(f)).sum::<f64>();
        let posed = bones.posed(&chart.rotations(&features));
        let mut gradient = [0.0; N_FEATURES];
        bones.pull_back(&posed, &features, &pull, &mut gradient);
        for i in 0..N_FEATURES {
            let stepped = |h: f64| {
                let mut features = features;
                features[i] += h;
                value(&features)
            };
            assert!(((stepped(1e-6) - stepped(-1e-6)) / 2e-6 - gradient[i]).abs() < 1e-7, "{i}");
        }
    }
}
