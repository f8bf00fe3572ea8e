//! Limbs that no image of a window shows: the fit holds their joints, and they are as uncertain as the poses of people are.

use super::single_camera::BONES;
use super::terms::unknowns::Unknowns;
use crate::body::BodyModel;
use crate::body::kinematics::{Pose, PosedSkeleton, joint_by_rotation};
use crate::body::skeleton::N_JOINTS;
use crate::geometry::rotation;
use crate::motion_prior::MotionPrior;
use crate::motion_prior::pose_gaussian::PoseGaussian;
use nalgebra::{DMatrix, DVector};

/// The joints of limbs that are no unknowns, with the Gaussian over their rotations ([`PoseGaussian`], a marginal).
pub(super) struct UnseenLimbs {
    poses: PoseGaussian,
    /// Of the rotations, rad^2; three rows a joint.
    covariance: DMatrix<f64>,
}

impl UnseenLimbs {
    /// `None` where every limb is seen.
    pub(super) fn new(model: &BodyModel, unknowns: &Unknowns) -> Option<Self> {
        let turned = BONES.iter().map(|[turned, _]| *turned);
        let mut unseen: Vec<usize> = turned.filter(|&joint| unknowns.group(joint).is_none()).collect();
        unseen.sort_unstable();
        let basis = MotionPrior::embedded().basis();
        let poses = || PoseGaussian::over(basis, &unseen).retargeted_to(&model.mocap_from_body);
        let poses = (!unseen.is_empty()).then(poses)?;
        let covariance = poses.precision.clone().cholesky()?.inverse();
        Some(Self { poses, covariance })
    }

    /// Variances of the joints' positions, three axes together, m^2: the trace of `J (C + d d^T) J^T`, with the derivatives J by the
    /// held rotations, their covariance C, and the distance d of the held pose from the mean.
    pub(super) fn variances(&self, pose: &Pose, skeleton: &PosedSkeleton) -> [f64; N_JOINTS] {
        let PoseGaussian { joints, rotations, mean, .. } = &self.poses;
        let held = joints.iter().zip(rotations).map(|(&joint, m)| rotation::step(m, &pose.rotations[joint]));
        let off = DVector::from_iterator(mean.len(), held.flat_map(|u| u.data.0[0])) - mean;
        std::array::from_fn(|joint| {
            let mut by_rotations = DMatrix::zeros(3, mean.len());
            for (i, &ancestor) in joints.iter().enumerate() {
                by_rotations.fixed_columns_mut::<3>(3 * i).copy_from(&joint_by_rotation(skeleton, joint, ancestor));
            }
            let spread = (&by_rotations * &self.covariance).component_mul(&by_rotations).sum();
            spread + (by_rotations * &off).norm_squared()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::terms::unknowns::{Border, CameraColumns, Shape};
    use super::*;
    use crate::body::default_body;
    use crate::body::kinematics::posed;
    use crate::body::model::Betas;

    /// Knees and ankles of people behind a table were stated to 60 and 120 mm, and were 170 and 290 mm off.
    #[test]
    fn legs_that_no_image_shows_are_anywhere_below_the_hips() {
        let model = default_body();
        let border = Border { shape: Shape::Held, has_bones: false, bias: None, cameras: CameraColumns::default() };
        let pose = Pose::rest();
        let skeleton = posed(&model.shaped(&Betas::zeros()), &pose);
        let trunk_and_arms = Unknowns::new((0..22).filter(|joint| ![1, 2, 4, 5].contains(joint)), border);
        let variances = UnseenLimbs::new(&model, &trunk_and_arms).unwrap().variances(&pose, &skeleton);
        let sigma_mm = variances.map(|variance| 1e3 * variance.sqrt());
        assert_eq!([0, 1, 2, 15, 20].map(|joint| sigma_mm[joint]), [0.0; 5], "what is seen, and the hips");
        assert!([4, 5].iter().all(|&knee| (100.0..300.0).contains(&sigma_mm[knee])), "{sigma_mm:?}");
        assert!([7, 8].iter().all(|&ankle| sigma_mm[ankle] > sigma_mm[4] && sigma_mm[ankle] < 500.0), "{sigma_mm:?}");
        assert!(UnseenLimbs::new(&model, &Unknowns::new(0..22, border)).is_none());
    }
}
