//! What the errors of each channel ask of unknowns that landmarks and cameras follow.

use super::{Channel, PosedCamera, Positions, WhitenedPixels};
use crate::optim::robust::geman_mcclure;
use nalgebra::{DMatrix, DVector, Matrix2xX, Matrix3xX};
use rayon::prelude::*;

/// Derivatives of all that a residual depends on by some unknowns.
pub(crate) struct Movements<'a> {
    /// Of the positions of the landmarks, `[frame][observed landmark]`. [3, unknowns]
    pub landmarks: &'a [Vec<Matrix3xX<f64>>],
    /// Of the increments of the cameras. [6 cameras, unknowns]
    pub cameras: &'a DMatrix<f64>,
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
        let of_camera = movements.cameras.fixed_rows::<6>(6 * channel.camera);
        let mut axes = [0, 1].map(|_| DVector::zeros(movements.cameras.ncols()));
        for seen in &channel.seen {
            let Some(e) = seen.parts.combined(|i| linear[i].map(|l| l.residual)) else { continue };
            let weight = geman_mcclure(e.norm_squared(), self.robust_scale).weight;
            let mut by_unknowns = Matrix2xX::zeros(movements.cameras.ncols());
            for &(i, factor) in seen.parts.iter() {
                let Some(l) = linear[i] else { continue };
                let of_landmark = &movements.landmarks[channel.seen[i].frame][landmark];
                by_unknowns += (l.by_point * of_landmark + l.by_camera * of_camera) * factor;
            }
            for (axis, score) in axes.iter_mut().enumerate() {
                score.axpy(weight * e[axis], &by_unknowns.row(axis).transpose(), 1.0);
            }
        }
        axes
    }
}
