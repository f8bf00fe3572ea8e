//! A channel's innovations, linearised.

use super::super::camera_unknowns::{ByCamera, CameraUnknowns};
use super::scores::Movements;
use super::{Channel, Seen, WhitenedPixels};
use crate::optim::robust::{Robust, geman_mcclure};
use crate::residuals::reprojection::Reprojection;
use nalgebra::{DMatrix, Vector2};

/// An innovation and the residuals that it is made of.
pub(super) struct LinearInnovation<'a> {
    /// In standard deviations.
    pub e: Vector2<f64>,
    pub robust: Robust,
    /// With which its square enters the normal equations.
    pub weight: f64,
    seen: &'a Seen,
    linear: &'a [Option<Reprojection>],
}

impl WhitenedPixels {
    /// Of a channel whose residuals are `linear`, those that have all of them, ascending in time.
    pub(super) fn linear_innovations<'a>(
        &self,
        channel: &'a Channel,
        linear: &'a [Option<Reprojection>],
    ) -> impl Iterator<Item = LinearInnovation<'a>> {
        let robust_scale = self.robust_scale;
        channel.seen.iter().filter_map(move |seen| {
            let e = seen.parts.combined(|i| linear[i].map(|l| l.residual))?;
            let robust = geman_mcclure(e.norm_squared(), robust_scale);
            Some(LinearInnovation { e, robust, weight: channel.weight * robust.weight, seen, linear })
        })
    }

    /// By how much a channel's innovations change with the unknowns of `movements`, times the square roots of their weights: by axis of
    /// the image. [unknowns, innovations]
    pub(super) fn moved_innovations(
        &self,
        channel: &Channel,
        (landmark, linear): (usize, &[Option<Reprojection>]),
        movements: &Movements,
    ) -> [DMatrix<f64>; 2] {
        let n = movements.of_camera.len();
        let camera = movements.cameras.rows(n * channel.camera, n);
        let mut axes = [0; 2].map(|_| DMatrix::zeros(camera.ncols(), channel.seen.len()));
        for (k, innovation) in self.linear_innovations(channel, linear).enumerate() {
            let root = innovation.weight.sqrt();
            let by_camera = innovation.by_camera(movements.of_camera);
            for (axis, moved) in axes.iter_mut().enumerate() {
                let mut column = moved.column_mut(k);
                column.gemv_tr(root, &camera, &by_camera.columns(0, n).row(axis).transpose(), 0.0);
                for (i, l, factor) in innovation.parts() {
                    let of_landmark = &movements.landmarks[channel.seen[i].frame][landmark];
                    column.gemv_tr(root * factor, of_landmark, &l.by_point.row(axis).transpose(), 1.0);
                }
            }
        }
        axes
    }
}

impl<'a> LinearInnovation<'a> {
    /// Positions in the channel, residuals and their factors.
    pub(super) fn parts(&self) -> impl Iterator<Item = (usize, &'a Reprojection, f64)> {
        let linear = self.linear;
        self.seen.parts.iter().filter_map(move |(i, factor)| Some((i, linear[i].as_ref()?, factor)))
    }

    /// Derivatives by the unknowns of the camera.
    pub(super) fn by_camera(&self, unknowns: CameraUnknowns) -> ByCamera {
        let mut by_camera = ByCamera::zeros();
        self.parts().for_each(|(_, l, factor)| unknowns.add(l, factor, &mut by_camera));
        by_camera
    }
}
