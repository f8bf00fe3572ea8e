//! What the errors of each channel ask of unknowns that landmarks and cameras follow.

use super::super::camera_unknowns::{CameraUnknowns, MAX_UNKNOWNS};
use super::{Channel, PosedCamera, Positions, WhitenedPixels};
use crate::optim::robust::Curvature;
use nalgebra::{DMatrix, DVector, Matrix3xX, SVector, Vector3};
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
    /// Of the cost of all innovations.
    pub(crate) fn curvature(&self, cameras: &[PosedCamera], positions: &Positions) -> Curvature {
        let of_channel = |landmark: usize, channel: &Channel| {
            let linear = channel.linearised(landmark, cameras, positions);
            let innovations = self.linear_innovations(channel, &linear);
            innovations.fold(Curvature::default(), |sum, innovation| sum.with(&innovation.robust, channel.weight))
        };
        let of_landmark = |(landmark, channels): (usize, &Vec<Channel>)| {
            channels.iter().fold(Curvature::default(), |sum, channel| sum.and(of_channel(landmark, channel)))
        };
        self.channels.iter().enumerate().map(of_landmark).fold(Curvature::default(), Curvature::and)
    }

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
        // What is asked of the landmark's position in each frame, and of the camera, comes first: the movements are the larger part
        // of the work, and each is then read once.
        let mut of_positions = vec![[Vector3::zeros(); 2]; channel.seen.len()];
        let mut of_camera = [SVector::<f64, MAX_UNKNOWNS>::zeros(); 2];
        for innovation in self.linear_innovations(channel, &linear) {
            let asked = innovation.e * innovation.weight;
            let by_camera = innovation.by_camera(movements.of_camera);
            for axis in 0..2 {
                of_camera[axis] += by_camera.row(axis).transpose() * asked[axis];
            }
            for (i, l, factor) in innovation.parts() {
                for axis in 0..2 {
                    of_positions[i][axis] += l.by_point.row(axis).transpose() * (asked[axis] * factor);
                }
            }
        }
        [0, 1].map(|axis| {
            let camera = movements.cameras.rows(n * channel.camera, n);
            let mut score = camera.tr_mul(&of_camera[axis].rows(0, n));
            for (seen, asked) in channel.seen.iter().zip(&of_positions) {
                score.gemv_tr(1.0, &movements.landmarks[seen.frame][landmark], &asked[axis], 1.0);
            }
            score
        })
    }
}
