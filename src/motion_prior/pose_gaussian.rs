//! A Gaussian over the joints' rotations of single frames, from the linear code.
//!
//! The linear code ([`super::basis`]) has `u - m = F^T z + e` with `z ~ N(0, I)` and the residual `e` of each feature, so
//! that `u ~ N(m, F^T F + diag(spread^2 - diag(F^T F)))`: the latent prior `|z|^2` of the paper and a
//! residual for every joint, with z eliminated in closed form.

use super::basis::{Basis, LATENT_DIM};
use super::chart::{LATENT_JOINTS, N_FEATURES};
use crate::body::mocap_skeleton::retargeted;
use crate::body::skeleton::N_JOINTS;
use nalgebra::{Cholesky, DMatrix, DVector, Matrix3};

/// Smallest standard deviation of a joint given all others, rad (4 degrees): rotations about axes that the mocap skeleton
/// fixes occur in people.
const FLOOR: f64 = 0.07;

/// A Gaussian over the features `u_j = log(M_j^T R_j)` of some of [`LATENT_JOINTS`].
#[derive(Debug, Clone, PartialEq)]
pub struct PoseGaussian {
    /// The joints, in SMPL's order.
    pub joints: Vec<usize>,
    /// `M_j` of each.
    pub rotations: Vec<Matrix3<f64>>,
    /// Mean of the features, rad; three a joint.
    pub mean: DVector<f64>,
    /// Inverse of their covariance, rad^-2.
    pub precision: DMatrix<f64>,
}

impl PoseGaussian {
    /// The marginal over those of `joints` that the latent describes.
    pub fn over(basis: &Basis, joints: &[usize]) -> Self {
        let places: Vec<usize> = (0..LATENT_JOINTS.len()).filter(|&i| joints.contains(&LATENT_JOINTS[i])).collect();
        let features: Vec<usize> = places.iter().flat_map(|i| 3 * i..3 * i + 3).collect();
        let covariance = covariance(basis).select_rows(&features).select_columns(&features);
        let factor = Cholesky::new(covariance).expect("a sum of squares and a positive diagonal");
        Self {
            joints: places.iter().map(|&i| LATENT_JOINTS[i]).collect(),
            rotations: places.iter().map(|&i| basis.chart.means[i]).collect(),
            mean: DVector::from_iterator(features.len(), features.iter().map(|&i| f64::from(basis.mean[i]))),
            precision: factor.inverse(),
        }
    }

    /// The Gaussian retargeted to a body with the zero pose `Q_j` ([`mocap_from_body`]): `M_j <- Q_p^T M_j Q_j` and `u_j <- Q_j^T u_j`.
    ///
    /// [`mocap_from_body`]: crate::body::mocap_skeleton::mocap_from_body
    pub fn retargeted_to(mut self, mocap_from_body: &[Matrix3<f64>; N_JOINTS]) -> Self {
        let mut mocap_from_own = DMatrix::zeros(self.mean.len(), self.mean.len());
        for (i, (&joint, rotation)) in self.joints.iter().zip(&mut self.rotations).enumerate() {
            *rotation = retargeted(rotation, joint, mocap_from_body);
            mocap_from_own.fixed_view_mut::<3, 3>(3 * i, 3 * i).copy_from(&mocap_from_body[joint]);
        }
        self.mean = mocap_from_own.tr_mul(&self.mean);
        self.precision = mocap_from_own.tr_mul(&self.precision) * mocap_from_own;
        self
    }
}

/// Covariance of all features, rad^2.
fn covariance(basis: &Basis) -> DMatrix<f64> {
    let code = DMatrix::from_fn(LATENT_DIM, N_FEATURES, |k, i| f64::from(basis.features_from_code[k * N_FEATURES + i]));
    let mut covariance = code.tr_mul(&code);
    for (i, spread) in basis.spread.iter().enumerate() {
        let left = f64::from(*spread).powi(2) - covariance[(i, i)];
        covariance[(i, i)] += left.max(0.0) + FLOOR * FLOOR;
    }
    covariance
}

#[cfg(test)]
mod tests {
    use super::super::MotionPrior;
    use super::*;
    use crate::body::default_body;
    use crate::geometry::rotation::{exp, log};
    use nalgebra::Vector3;

    #[test]
    fn joints_have_their_measured_spread_without_collars() {
        let basis = MotionPrior::embedded().basis();
        let gaussian = PoseGaussian::over(basis, &[1, 13, 4, 21]);
        assert_eq!(gaussian.joints, [1, 4, 21]);
        let covariance = gaussian.precision.clone().try_inverse().unwrap();
        let measured = |row: usize| f64::from(basis.spread[if row < 3 { row } else { 3 * 3 + row - 3 }]);
        for row in 0..6 {
            let expected = measured(row).powi(2) + FLOOR * FLOOR;
            assert!((covariance[(row, row)] / expected - 1.0).abs() < 0.02, "{row}");
        }
        assert!(covariance[(0, 3)].abs() > 0.01, "a lifted thigh and a bent knee go together");
    }

    /// A retargeted pose has the same likelihood: only the zero pose differs.
    #[test]
    fn a_pose_is_as_likely_in_another_skeleton() {
        let mocap = PoseGaussian::over(MotionPrior::embedded().basis(), &[1, 4, 7, 10, 16]);
        let turns = default_body().mocap_from_body;
        let own = mocap.clone().retargeted_to(&turns);
        let turn = |i: usize| mocap.rotations[i] * exp(&Vector3::new(0.3, -0.1 * i as f64, 0.2));
        let distance = |gaussian: &PoseGaussian, turn: &dyn Fn(usize) -> Matrix3<f64>| {
            let off = |i: usize| log(&(gaussian.rotations[i].transpose() * turn(i)));
            let features: Vec<f64> = (0..5).flat_map(|i| off(i).data.0[0]).collect();
            let off = DVector::from_vec(features) - &gaussian.mean;
            off.dot(&(&gaussian.precision * &off))
        };
        let on_mocap = distance(&mocap, &turn);
        let as_own = distance(&own, &|i| retargeted(&turn(i), mocap.joints[i], &turns));
        assert!((as_own / on_mocap - 1.0).abs() < 1e-9, "{as_own} and {on_mocap}");
        assert!((distance(&own, &turn) / on_mocap - 1.0).abs() > 0.05);
    }
}
