//! Rotations as 57 features a frame, and back.
//!
//! Joint j turns by `R_j = M_j exp(u_j)` with its mean rotation `M_j` over the training set: three numbers a joint,
//! continuous within half a turn of the mean. The 6D form (first two columns) is curved where these are straight: at 32
//! numbers a frame its principal components have a joint error of 23 mm on the validation takes, those of `u` 3 mm.
//!
//! Along a take the branch of each joint's logarithm is continuous. The linear code gets every rotation on its shortest
//! branch (`on_shortest_branch`): mocap wrists turn up to a full turn from their mean, where it has no training data.
//!
//! The training data have collars and hands at identity; these joints are not part of the latent.

use crate::body::skeleton::N_JOINTS;
use crate::geometry::rotation;
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::{PI, TAU};

/// Local rotations `parent_from_joint` of one frame in SMPL's order; entry 0, the pelvis in the world, is ignored.
pub type LocalRotations = [Matrix3<f64>; N_JOINTS];

/// Joints that the latent describes: all except pelvis, collars and hands.
pub const LATENT_JOINTS: [usize; 19] = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 15, 16, 17, 18, 19, 20, 21];

/// Joints that the latent does not describe: collars and hands.
pub const OUTSIDE_JOINTS: [usize; 4] = [13, 14, 22, 23];

/// Numbers of one frame: a rotation vector for each of [`LATENT_JOINTS`].
pub const N_FEATURES: usize = 3 * LATENT_JOINTS.len();

/// The features of one frame, rad.
pub type Features = [f64; N_FEATURES];

/// Mean rotations `M_j` of [`LATENT_JOINTS`].
#[derive(Debug, Clone, PartialEq)]
pub struct Chart {
    /// `M_j` in the order of [`LATENT_JOINTS`].
    pub means: [Matrix3<f64>; LATENT_JOINTS.len()],
}

impl Chart {
    /// Features of one frame, each joint on the branch of the logarithm nearest to `before`.
    pub fn features(&self, rotations: &LocalRotations, before: Option<&Features>) -> Features {
        let mut features = [0.0; N_FEATURES];
        for (i, (joint, mean)) in LATENT_JOINTS.iter().zip(&self.means).enumerate() {
            let mut u = rotation::step(mean, &rotations[*joint]);
            if let Some(before) = before {
                u = nearest_branch(u, &Vector3::from_column_slice(&before[3 * i..3 * i + 3]));
            }
            features[3 * i..3 * i + 3].copy_from_slice(u.as_slice());
        }
        features
    }

    /// Features of a take, continuous in time.
    pub fn features_of_take(&self, take: &[LocalRotations]) -> Vec<Features> {
        let mut features: Vec<Features> = Vec::with_capacity(take.len());
        for rotations in take {
            features.push(self.features(rotations, features.last()));
        }
        features
    }

    /// Rotations of one frame; identity for joints outside the latent and for the pelvis.
    pub fn rotations(&self, features: &Features) -> LocalRotations {
        let mut rotations = [Matrix3::identity(); N_JOINTS];
        self.write(features, &mut rotations);
        rotations
    }

    /// Replaces the rotations of [`LATENT_JOINTS`].
    pub fn write(&self, features: &Features, rotations: &mut LocalRotations) {
        for (i, (joint, mean)) in LATENT_JOINTS.iter().zip(&self.means).enumerate() {
            rotations[*joint] = mean * rotation::exp(&Vector3::from_column_slice(&features[3 * i..3 * i + 3]));
        }
    }
}

/// Longest rotation vector of a feature: beyond it a whole turn is nearer than half a turn, and there the direction is
/// undefined.
const LONGEST: f64 = 1.5 * PI;

/// The rotation vector of the same rotation, a full turn shorter or longer, that lies nearest to `before`.
fn nearest_branch(u: Vector3<f64>, before: &Vector3<f64>) -> Vector3<f64> {
    let other = unwound(&u, 1.0);
    if (other - before).norm() < (u - before).norm() && other.norm() < LONGEST { other } else { u }
}

/// `(1 - 2 pi k / |u|) u`: k turns shorter; a zero rotation has one branch only.
fn unwound(u: &Vector3<f64>, turns: f64) -> Vector3<f64> {
    let angle = u.norm();
    if angle < 1e-6 { *u } else { u * (1.0 - turns * TAU / angle) }
}

/// Whole turns nearest to a rotation vector's length.
fn whole_turns(u: &Vector3<f64>) -> f64 {
    (u.norm() / TAU).round()
}

/// Rows of features with every joint on its shortest branch.
pub(crate) fn on_shortest_branch(mut features: Vec<f32>) -> Vec<f32> {
    for values in features.chunks_exact_mut(3) {
        let u = joint(values);
        if whole_turns(&u) > 0.0 {
            write_joint(values, &unwound(&u, whole_turns(&u)));
        }
    }
    features
}

fn joint(values: &[f32]) -> Vector3<f64> {
    Vector3::from_fn(|axis, _| f64::from(values[axis]))
}

fn write_joint(values: &mut [f32], u: &Vector3<f64>) {
    (0..3).for_each(|axis| values[axis] = u[axis] as f32);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart() -> Chart {
        let turn = |i: usize| rotation::exp(&Vector3::new(0.1 * i as f64, -0.05 * i as f64, 0.3));
        Chart { means: std::array::from_fn(turn) }
    }

    #[test]
    fn features_and_rotations_are_inverse_beyond_half_a_turn() {
        let chart = chart();
        let features: Vec<Features> = (0..60).map(|t| [0.045 * t as f64; N_FEATURES]).collect();
        assert!((PI..LONGEST).contains(&(features[59][0] * 3.0_f64.sqrt())));
        let take: Vec<LocalRotations> = features.iter().map(|f| chart.rotations(f)).collect();
        for (found, given) in chart.features_of_take(&take).iter().zip(&features) {
            assert!(found.iter().zip(given).all(|(a, b)| (a - b).abs() < 1e-9));
        }
    }

    #[test]
    fn features_change_branch_after_a_long_turn() {
        let chart = chart();
        let take: Vec<LocalRotations> = (0..100).map(|t| chart.rotations(&[0.05 * t as f64; N_FEATURES])).collect();
        for (features, rotations) in chart.features_of_take(&take).iter().zip(&take) {
            assert!(features.chunks_exact(3).all(|u| u.iter().map(|x| x * x).sum::<f64>().sqrt() < LONGEST));
            let back = chart.rotations(features);
            assert!(LATENT_JOINTS.iter().all(|&j| (back[j] - rotations[j]).norm() < 1e-9));
        }
    }

    /// Three joints: one inside, one past half a turn, one at rest.
    #[test]
    fn the_shortest_branch_is_the_same_rotation() {
        let features = vec![0.4, -0.3, 1.0, 2.0, -2.5, 1.5, 0.0, 0.0, 0.0];
        let shortest = on_shortest_branch(features.clone());
        assert_eq!((&shortest[..3], &shortest[6..]), (&features[..3], &features[6..]));
        assert!(joint(&shortest[3..6]).norm() < PI);
        let turn = |f: &[f32]| rotation::exp(&joint(&f[3..6]));
        assert!((turn(&shortest) - turn(&features)).norm() < 1e-6);
    }

    #[test]
    fn latent_and_outside_joints_cover_the_body() {
        let mut all: Vec<usize> = LATENT_JOINTS.iter().chain(&OUTSIDE_JOINTS).copied().collect();
        all.sort_unstable();
        assert_eq!(all, (1..N_JOINTS).collect::<Vec<_>>());
    }
}
