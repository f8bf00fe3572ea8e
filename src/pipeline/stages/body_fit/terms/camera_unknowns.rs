//! The unknowns of one camera, and a residual's derivatives by them.

use crate::residuals::reprojection::Reprojection;
use nalgebra::SMatrix;

/// Most unknowns of a camera: the left increment (rho, phi) of `camera_from_world`, and the logarithm of a factor on its focal
/// lengths.
pub(crate) const MAX_UNKNOWNS: usize = 7;

/// Number of unknowns of the pose; they come first.
pub(crate) const POSE: usize = 6;

/// Place of the logarithm of the focal factor, where it is an unknown.
pub(crate) const FOCAL: usize = POSE;

/// Derivatives of a residual by a camera's unknowns; columns beyond [`CameraUnknowns::len`] are zero.
pub(crate) type ByCamera = SMatrix<f64, 2, MAX_UNKNOWNS>;

/// Which unknowns a camera has beside its pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct CameraUnknowns {
    /// Whether the focal lengths are refined.
    pub focal: bool,
}

impl CameraUnknowns {
    /// Number of unknowns.
    pub(crate) fn len(&self) -> usize {
        POSE + usize::from(self.focal)
    }

    /// Adds the derivatives of a residual, times `factor`.
    pub(crate) fn add(&self, linear: &Reprojection, factor: f64, by_camera: &mut ByCamera) {
        let mut pose = by_camera.fixed_columns_mut::<POSE>(0);
        pose += linear.by_camera * factor;
        if self.focal {
            let mut focal = by_camera.fixed_columns_mut::<1>(FOCAL);
            focal += linear.by_log_focal * factor;
        }
    }
}
