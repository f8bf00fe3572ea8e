//! What a pose costs under what is known of people's poses.

use crate::body::skeleton::N_JOINTS;
use crate::geometry::rotation;
use crate::motion_prior::pose_gaussian::PoseGaussian;
use nalgebra::{DMatrix, DVector, Matrix3};
use serde::{Deserialize, Serialize};

/// How firmly a pose is held to what is likely.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PoseWeights {
    /// Factor on the squared distance in standard deviations.
    pub weight: f64,
    /// Root mean square over the features, in standard deviations, from where on the cost grows linearly: poses that are
    /// nowhere near what was captured are not bent towards it.
    pub knee: f64,
}

/// A cost over the right increments `R_j <- R_j exp(d_j)` of the Gaussian's joints, to second order.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseCost {
    /// `weight n k^2 (r - 1)`.
    pub cost: f64,
    /// Its derivative; three numbers a joint.
    pub gradient: DVector<f64>,
    /// Gauss-Newton's positive semi-definite second derivative.
    pub hessian: DMatrix<f64>,
}

/// With `e = u - m`, n numbers, precision P: `rho = w n k^2 (r - 1)`, `r = sqrt(1 + e^T P e / (n k^2))`; near the mean
/// `w e^T P e / 2`. Derivative of the features: `d u / d d = J_r^-1(u)` (method.md 9.2).
pub fn pose_cost(rotations: &[Matrix3<f64>; N_JOINTS], poses: &PoseGaussian, weights: &PoseWeights) -> PoseCost {
    let n = poses.mean.len();
    let mut off = -poses.mean.clone();
    let mut jacobians = Vec::with_capacity(poses.joints.len());
    for (i, (joint, mean)) in poses.joints.iter().zip(&poses.rotations).enumerate() {
        let u = rotation::log(&(mean.transpose() * rotations[*joint]));
        let mut rows = off.fixed_rows_mut::<3>(3 * i);
        rows += u;
        jacobians.push(rotation::right_jacobian_inverse(&u));
    }
    let pulled = &poses.precision * &off;
    let knee_squared = n as f64 * weights.knee.powi(2);
    let root = (1.0 + off.dot(&pulled) / knee_squared).sqrt();
    let weight = weights.weight / root;
    let (mut gradient, mut hessian) = (DVector::zeros(n), DMatrix::zeros(n, n));
    for (i, a) in jacobians.iter().enumerate() {
        let left = a.transpose() * weight;
        gradient.fixed_rows_mut::<3>(3 * i).copy_from(&(left * pulled.fixed_rows::<3>(3 * i)));
        for (k, b) in jacobians.iter().enumerate() {
            let block = left * poses.precision.fixed_view::<3, 3>(3 * i, 3 * k) * b;
            hessian.fixed_view_mut::<3, 3>(3 * i, 3 * k).copy_from(&block);
        }
    }
    PoseCost { cost: weights.weight * knee_squared * (root - 1.0), gradient, hessian }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion_prior::MotionPrior;
    use nalgebra::Vector3;

    fn poses() -> PoseGaussian {
        PoseGaussian::over(MotionPrior::embedded().basis(), &[1, 4, 12, 16, 18, 20])
    }

    #[test]
    fn the_gradient_agrees_with_central_differences_near_and_far() {
        let (poses, weights) = (poses(), PoseWeights { weight: 0.3, knee: 1.5 });
        for size in [0.2, 1.2] {
            let turn = |j: usize| rotation::exp(&(Vector3::new((j as f64).sin(), (j as f64).cos(), 0.3) * size));
            let rotations: [Matrix3<f64>; N_JOINTS] = std::array::from_fn(turn);
            let found = pose_cost(&rotations, &poses, &weights);
            for (i, &joint) in poses.joints.iter().enumerate() {
                for axis in 0..3 {
                    let at = |h: f64| {
                        let mut moved = rotations;
                        moved[joint] *= rotation::exp(&Vector3::ith(axis, h));
                        pose_cost(&moved, &poses, &weights).cost
                    };
                    let difference = (at(1e-6) - at(-1e-6)) / 2e-6;
                    assert!((difference - found.gradient[3 * i + axis]).abs() < 1e-6 * (1.0 + found.gradient.norm()));
                }
            }
        }
    }

    #[test]
    fn the_mean_costs_nothing() {
        let poses = poses();
        let mut rotations = [Matrix3::identity(); N_JOINTS];
        for (i, (joint, mean)) in poses.joints.iter().zip(&poses.rotations).enumerate() {
            rotations[*joint] = mean * rotation::exp(&poses.mean.fixed_rows::<3>(3 * i).into_owned());
        }
        let found = pose_cost(&rotations, &poses, &PoseWeights { weight: 1.0, knee: 2.0 });
        assert!(found.cost < 1e-12 && found.gradient.norm() < 1e-9);
    }
}
