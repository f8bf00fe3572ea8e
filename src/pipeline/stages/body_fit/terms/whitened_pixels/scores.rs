//! What the errors of each channel ask of unknowns that landmarks and cameras follow.

use super::super::camera_unknowns::{ByCamera, CameraUnknowns};
use super::{Channel, PosedCamera, Positions, WhitenedPixels};
use crate::optim::robust::geman_mcclure;
use nalgebra::{DMatrix, DVector, Matrix2xX, Matrix3xX};
use rayon::prelude::*;

/// Derivatives of all that a residual depends on by some unknowns.
pub(crate) struct Movements<'a> {
    /// Of the positions of the landmarks, `[frame][observed landmark]`. [3, unknowns]
    pub landmarks: &'a [Vec<Matrix3xX<f64>>],
    /// Of the unknowns of the cameras, camera by camera. [each camera's, unknowns]
    pub cameras: &'a DMatrix<f64>,
    /// Which these are.
    pub of_camera: CameraUnknowns,
}

impl WhitenedPixels {
    /// Each channel's part in the gradient of the cost by the unknowns of `movements`, two per channel: by axis of the image.
    pub(crate) fn scores(
        &self,
        cameras: &[PosedCamera],
        positions: &Positions,
        movements: &Movements,
    ) -> Vec<DVector<f64>> {
        let of_landmark = |landmark: usize| {
            let score = |channel: &Channel| self.channel_score(channel, landmark, cameras, positions, movements);
            self.channels[landmark].iter().flat_map(score).collect::<Vec<_>>()
        };
        (0..self.landmarks.len()).into_par_iter().flat_map_iter(of_landmark).collect()
    }

    fn channel_score(
        &self,
        channel: &Channel,
        landmark: usize,
        cameras: &[PosedCamera],
        positions: &Positions,
        movements: &Movements,
    ) -> [DVector<f64>; 2] {
        let linear = channel.linearised(landmark, cameras, positions);
        let n = movements.of_camera.len();
        let of_camera = movements.cameras.rows(n * channel.camera, n);
        let mut axes = [0, 1].map(|_| DVector::zeros(movements.cameras.ncols()));
        for seen in &channel.seen {
            let Some(e) = seen.parts.combined(|i| linear[i].map(|l| l.residual)) else { continue };
            let weight = channel.weight * geman_mcclure(e.norm_squared(), self.robust_scale).weight;
            let mut by_unknowns = Matrix2xX::zeros(movements.cameras.ncols());
            for &(i, factor) in seen.parts.iter() {
                let Some(l) = linear[i] else { continue };
                let of_landmark = &movements.landmarks[channel.seen[i].frame][landmark];
                let mut by_camera = ByCamera::zeros();
                movements.of_camera.add(&l, 1.0, &mut by_camera);
                by_unknowns += (l.by_point * of_landmark + by_camera.columns(0, n) * of_camera) * factor;
            }
            for (axis, score) in axes.iter_mut().enumerate() {
                score.axpy(weight * e[axis], &by_unknowns.row(axis).transpose(), 1.0);
            }
        }
        axes
    }
}
