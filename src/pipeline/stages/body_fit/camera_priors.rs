//! What is known of the cameras beside the detections, and the directions in which they move.

use super::camera_pose_prior::CameraPosePrior;
use super::config::KnownCameras;
use super::focal_prior::FocalPrior;
use super::terms::camera_unknowns::{CameraUnknowns, FOCAL, POSE};
use super::terms::unknowns::CameraColumns;
use crate::geometry::{Rigid, free_network};
use crate::optim::block_banded::Corner;
use crate::pipeline::calibration::PosedCamera;
use nalgebra::{DMatrix, DVector};

/// How many times the joint problem counts what it shows of the cameras, before that has been measured. On realistic noise the mean
/// square error of focal lengths is 4.3 times their stated variance, 3 to 7 times by session.
const OVERCOUNT: f64 = 5.0;

/// Priors of the cameras' unknowns.
#[derive(Debug, Clone)]
pub(super) struct CameraPriors {
    /// Of the focal lengths; `None`: they are held.
    pub focal: Option<FocalPrior>,
    /// Of the poses; `None`: nothing is known, and the cameras move in a free network.
    pub poses: Option<CameraPosePrior>,
    /// How many times the joint problem counts what it shows of the cameras: errors of the detector that are slower than the model
    /// of the noise, or constant, are not in it. Priors count as often.
    pub overcount: f64,
}

impl CameraPriors {
    /// With focal lengths of which nothing but the order of magnitude is known to be right.
    pub(super) fn new(known: &KnownCameras) -> Self {
        let focal = |given: &Vec<f64>| FocalPrior::wide(given.clone(), known.is_focal_guessed);
        let poses = |given: &Vec<Rigid>| CameraPosePrior { given: given.clone() };
        Self { focal: known.focal_px.as_ref().map(focal), poses: known.poses.as_ref().map(poses), overcount: OVERCOUNT }
    }

    /// Those of the poses alone: focal lengths are held.
    pub(super) fn of_poses(known: &KnownCameras) -> Self {
        Self { focal: None, ..Self::new(known) }
    }

    /// Whether the focal lengths of both spread alike.
    pub(super) fn has_spread_of(&self, other: &Self) -> bool {
        let spread = |priors: &Self| priors.focal.as_ref().map(|prior| prior.spread);
        spread(self) == spread(other)
    }

    /// The unknowns of `n_cameras` cameras.
    pub(super) fn columns(&self, n_cameras: usize) -> CameraColumns {
        CameraColumns { n_cameras, unknowns: CameraUnknowns { focal: self.focal.is_some() } }
    }

    /// Half of squared standard deviations, [`Self::overcount`] times.
    pub(super) fn cost(&self, cameras: &[PosedCamera]) -> f64 {
        let of_focal = self.focal.as_ref().map_or(0.0, |prior| prior.cost(&prior.log_factors(cameras)));
        self.overcount * (of_focal + self.poses.as_ref().map_or(0.0, |prior| prior.cost(cameras)))
    }

    /// Adds gradient and Hessian; the unknowns of the cameras begin at `first`.
    pub(super) fn add_to(&self, cameras: &[PosedCamera], first: usize, corner: &mut Corner) {
        if let Some(prior) = &self.poses {
            let gradients = prior.gradients(cameras).into_iter().flat_map(<[f64; POSE]>::from);
            for (at, gradient) in self.pose_columns(cameras.len()).zip(gradients) {
                corner.gradient[first + at] += self.overcount * gradient;
            }
        }
        if let Some(prior) = &self.focal {
            let gradients = prior.precision() * prior.log_factors(cameras) * self.overcount;
            for (at, gradient) in self.focal_columns(cameras.len()).zip(&gradients) {
                corner.gradient[first + at] += gradient;
            }
        }
        let precision = self.precision(cameras.len());
        let mut hessian = corner.hessian.view_mut((first, first), precision.shape());
        hessian += precision;
    }

    /// Hessian of all priors by the unknowns of the cameras.
    pub(super) fn precision(&self, n_cameras: usize) -> DMatrix<f64> {
        let of_both = [self.precisions_of_poses(n_cameras), self.precision_of_focal(n_cameras)];
        let n = self.columns(n_cameras).len();
        of_both.into_iter().flatten().fold(DMatrix::zeros(n, n), |sum, precision| sum + precision)
    }

    /// Hessian of the prior of the focal lengths by the unknowns of the cameras.
    pub(super) fn precision_of_focal(&self, n_cameras: usize) -> Option<DMatrix<f64>> {
        let of_focal = self.focal.as_ref()?.precision() * self.overcount;
        let (n, columns) = (self.columns(n_cameras).len(), self.focal_columns(n_cameras));
        let mut hessian = DMatrix::zeros(n, n);
        for (i, row) in columns.clone().enumerate() {
            for (j, column) in columns.clone().enumerate() {
                hessian[(row, column)] = of_focal[(i, j)];
            }
        }
        Some(hessian)
    }

    /// Hessian of the prior of the poses by the unknowns of the cameras, all of which are then free.
    pub(super) fn precisions_of_poses(&self, n_cameras: usize) -> Option<DMatrix<f64>> {
        self.poses.as_ref()?;
        let n = self.columns(n_cameras).len();
        let mut hessian = DMatrix::zeros(n, n);
        let precisions = CameraPosePrior::precisions().into_iter().cycle();
        self.pose_columns(n_cameras).zip(precisions).for_each(|(at, p)| hessian[(at, at)] = self.overcount * p);
        Some(hessian)
    }

    /// Columns of the poses' increments among those of the cameras.
    fn pose_columns(&self, n_cameras: usize) -> impl Iterator<Item = usize> + use<> {
        let n = self.columns(n_cameras).unknowns.len();
        (0..n_cameras).flat_map(move |camera| n * camera..n * camera + POSE)
    }

    /// Columns of the focal factors' logarithms among those of the cameras.
    pub(super) fn focal_columns(&self, n_cameras: usize) -> impl Iterator<Item = usize> + Clone {
        let n = self.columns(n_cameras).unknowns.len();
        (0..n_cameras).map(move |camera| n * camera + FOCAL)
    }

    /// All directions of `n_others` unknowns, then those of the cameras: a free network, and each camera's focal length.
    ///
    /// A longer focal length of all cameras looks like people who are farther away: the cameras' distances grow by the mean of
    /// the factors, so that people keep their size. With a prior of the poses all directions are free.
    pub(super) fn basis(&self, n_others: usize, cameras: &[PosedCamera]) -> DMatrix<f64> {
        if self.poses.is_some() {
            let n = n_others + self.columns(cameras.len()).len();
            return DMatrix::identity(n, n);
        }
        let poses: Vec<Rigid> = cameras.iter().map(|camera| camera.camera_from_world).collect();
        let (network, columns) = (free_network::basis(&poses), self.columns(cameras.len()));
        let growth = free_network::similarity_directions(&poses).column(6) / cameras.len().max(1) as f64;
        let n = columns.unknowns.len();
        let spread = |of_poses: &DVector<f64>| {
            let mut of_cameras = DVector::zeros(columns.len());
            for camera in 0..cameras.len() {
                of_cameras.rows_mut(n * camera, POSE).copy_from(&of_poses.rows(POSE * camera, POSE));
            }
            of_cameras
        };
        let mut directions: Vec<DVector<f64>> =
            network.column_iter().map(|direction| spread(&direction.into_owned())).collect();
        if self.focal.is_some() {
            directions.extend(self.focal_columns(cameras.len()).map(|column| {
                let mut direction = spread(&growth);
                direction[column] = 1.0;
                direction
            }));
        }
        let mut basis = DMatrix::zeros(n_others + columns.len(), n_others + directions.len());
        basis.view_mut((0, 0), (n_others, n_others)).fill_with_identity();
        for (k, direction) in directions.iter().enumerate() {
            basis.view_mut((n_others, n_others + k), (columns.len(), 1)).copy_from(direction);
        }
        basis
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Intrinsics, rotation};
    use crate::pipeline::stages::body_fit::session_state::SessionState;
    use crate::residuals::derivative_check::assert_gradient;
    use nalgebra::Vector3;

    fn cameras() -> Vec<PosedCamera> {
        let pose = |k: usize| Rigid {
            rotation: rotation::exp(&Vector3::new(0.1, 1.3 * k as f64, 0.02)),
            translation: Vector3::new(0.1, -0.3, 4.0 + 0.2 * k as f64),
        };
        (0..4).map(|k| PosedCamera { intrinsics: Intrinsics::PLAIN, camera_from_world: pose(k) }).collect()
    }

    fn moved(cameras: &[PosedCamera], priors: &CameraPriors, step: &DVector<f64>) -> Vec<PosedCamera> {
        let state = SessionState { offsets: Vec::new(), cameras: cameras.to_vec() };
        state.moved(step, priors.columns(cameras.len())).cameras
    }

    #[test]
    fn gradient_of_the_priors_matches_differences() {
        let cameras = cameras();
        let given = |camera: &PosedCamera| {
            camera.camera_from_world.perturbed_left(&Vector3::new(0.01, 0.02, -0.01), &Vector3::new(0.002, 0.0, -0.001))
        };
        let priors = CameraPriors::new(&KnownCameras {
            focal_px: Some(vec![1010.0, 990.0, 1000.0, 1030.0]),
            is_focal_guessed: false,
            poses: Some(cameras.iter().map(given).collect()),
        });
        let n = priors.columns(cameras.len()).len();
        let mut corner = Corner::zeros(n);
        priors.add_to(&cameras, 0, &mut corner);
        assert_gradient(corner.gradient.as_slice(), |d| {
            priors.cost(&moved(&cameras, &priors, &DVector::from_column_slice(d)))
        });
    }

    /// Focal lengths that are longer by a hundredth put the cameras a hundredth farther away from what they see.
    #[test]
    fn cameras_move_away_as_focal_lengths_grow() {
        let cameras = cameras();
        let priors = CameraPriors::new(&KnownCameras { focal_px: Some(vec![1000.0; 4]), ..KnownCameras::default() });
        let basis = priors.basis(0, &cameras);
        let n_free = 6 * 4 - 7;
        assert_eq!(basis.shape(), (28, n_free + 4));
        let grown = moved(&cameras, &priors, &(basis.columns(n_free, 4).column_sum() * 0.01));
        let center = |cameras: &[PosedCamera]| {
            cameras.iter().map(|c| c.camera_from_world.center()).sum::<Vector3<f64>>() / cameras.len() as f64
        };
        for (before, after) in cameras.iter().zip(&grown) {
            let arm = |c: &PosedCamera, of: &[PosedCamera]| (c.camera_from_world.center() - center(of)).norm();
            assert!((arm(after, &grown) / arm(before, &cameras) - 1.01).abs() < 1e-6);
            assert!((after.intrinsics.focal() / 1000.0 - 0.01f64.exp()).abs() < 1e-9);
        }
    }
}
