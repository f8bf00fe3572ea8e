//! Cost of a pose under a Gaussian over poses.

use crate::body::skeleton::N_JOINTS;
use crate::geometry::rotation;
use crate::motion_prior::pose_gaussian::PoseGaussian;
use crate::optim::robust::{Robust, charbonnier};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use std::ops::Range;

/// Weight and robust knee of the pose cost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseWeights {
    /// Factor on the squared distance in standard deviations.
    pub weight: f64,
    /// Root mean square over the features, in standard deviations, above which the cost grows linearly, so that poses far
    /// from all recorded ones are not bent towards them.
    pub knee: f64,
}

/// Derivatives of a pose cost by the right increments `R_j <- R_j exp(d_j)` of the Gaussian's joints.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseDerivatives<'a> {
    precision: &'a DMatrix<f64>,
    /// Of the features, by joint.
    jacobians: Vec<Matrix3<f64>>,
    /// Precision times the deviation.
    pulled: DVector<f64>,
    /// Of half the squared distance in standard deviations.
    weight: f64,
}

impl PoseDerivatives<'_> {
    /// Gradient of the cost by the Gaussian's joint `i`, per rad.
    pub fn gradient(&self, i: usize) -> Vector3<f64> {
        self.jacobians[i].tr_mul(&self.pulled.fixed_rows::<3>(3 * i)) * self.weight
    }

    /// Gauss-Newton approximation of the second derivative by joint `i` and each of `others`, per rad^2; positive semi-definite.
    pub fn hessian(&self, i: usize, others: Range<usize>) -> impl Iterator<Item = Matrix3<f64>> {
        let left = self.jacobians[i].transpose() * self.weight;
        others.map(move |k| left * self.precision.fixed_view::<3, 3>(3 * i, 3 * k) * self.jacobians[k])
    }
}

/// Cost of a pose.
///
/// With `e = u - m`, n numbers, precision P: `rho = w n k^2 (r - 1)`, `r = sqrt(1 + e^T P e / (n k^2))`; near the mean
/// `w e^T P e / 2`.
pub fn pose_cost(rotations: &[Matrix3<f64>; N_JOINTS], poses: &PoseGaussian, weights: &PoseWeights) -> f64 {
    let off = deviation(&features(rotations, poses), poses);
    robust(off.dot(&(&poses.precision * &off)), off.len(), weights).cost
}

/// Derivatives of [`pose_cost`]; those of the features are `d u / d d = J_r^-1(u)` (method.md 9.2).
pub fn pose_derivatives<'a>(
    rotations: &[Matrix3<f64>; N_JOINTS],
    poses: &'a PoseGaussian,
    weights: &PoseWeights,
) -> PoseDerivatives<'a> {
    let features = features(rotations, poses);
    let off = deviation(&features, poses);
    let jacobians = features.iter().map(rotation::right_jacobian_inverse).collect();
    let pulled = &poses.precision * &off;
    let weight = robust(off.dot(&pulled), off.len(), weights).weight;
    PoseDerivatives { precision: &poses.precision, jacobians, pulled, weight }
}

/// `u_j = log(M_j^T R_j)`, rad.
fn features(rotations: &[Matrix3<f64>; N_JOINTS], poses: &PoseGaussian) -> Vec<Vector3<f64>> {
    let feature = |(joint, mean): (&usize, &Matrix3<f64>)| rotation::step(mean, &rotations[*joint]);
    poses.joints.iter().zip(&poses.rotations).map(feature).collect()
}

/// `e = u - m`.
fn deviation(features: &[Vector3<f64>], poses: &PoseGaussian) -> DVector<f64> {
    let mut off = -poses.mean.clone();
    for (i, u) in features.iter().enumerate() {
        let mut rows = off.fixed_rows_mut::<3>(3 * i);
        rows += u;
    }
    off
}

fn robust(squared: f64, n: usize, weights: &PoseWeights) -> Robust {
    charbonnier(weights.weight, squared, n as f64 * weights.knee.powi(2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion_prior::MotionPrior;
    use crate::residuals::derivative_check::assert_gradient;

    fn poses() -> PoseGaussian {
        PoseGaussian::over(MotionPrior::embedded().basis(), &[1, 4, 12, 16, 18, 20])
    }

    #[test]
    fn gradient_matches_differences_near_and_far() {
        let (poses, weights) = (poses(), PoseWeights { weight: 0.3, knee: 1.5 });
        for size in [0.2, 1.2] {
            let turn = |j: usize| rotation::exp(&(Vector3::new((j as f64).sin(), (j as f64).cos(), 0.3) * size));
            let rotations: [Matrix3<f64>; N_JOINTS] = std::array::from_fn(turn);
            let found = pose_derivatives(&rotations, &poses, &weights);
            let gradient: Vec<f64> = (0..poses.joints.len()).flat_map(|i| found.gradient(i).data.0[0]).collect();
            assert_gradient(&gradient, |d| {
                let mut moved = rotations;
                for (joint, d) in poses.joints.iter().zip(d.chunks_exact(3)) {
                    moved[*joint] *= rotation::exp(&Vector3::from_column_slice(d));
                }
                pose_cost(&moved, &poses, &weights)
            });
        }
    }

    #[test]
    fn the_mean_costs_nothing() {
        let poses = poses();
        let mut rotations = [Matrix3::identity(); N_JOINTS];
        for (i, (joint, mean)) in poses.joints.iter().zip(&poses.rotations).enumerate() {
            rotations[*joint] = mean * rotation::exp(&poses.mean.fixed_rows::<3>(3 * i).into_owned());
        }
        let weights = PoseWeights { weight: 1.0, knee: 2.0 };
        assert!(pose_cost(&rotations, &poses, &weights) < 1e-12);
        let found = pose_derivatives(&rotations, &poses, &weights);
        assert!((0..poses.joints.len()).all(|i| found.gradient(i).norm() < 1e-9));
    }
}
