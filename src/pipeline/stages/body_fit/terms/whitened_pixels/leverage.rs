//! How much of the detector's errors a person's own unknowns absorb, as the session's unknowns see it.

use super::super::camera_unknowns::ByCamera;
use super::scores::Movements;
use super::{Channel, PosedCamera, Positions, WhitenedPixels};
use crate::optim::robust::geman_mcclure;
use nalgebra::{DMatrix, Matrix3xX};
use rayon::prelude::*;

/// Sums over channels.
#[derive(Clone, Copy, Default)]
struct Leverage {
    errors: f64,
    absorbed: f64,
}

impl WhitenedPixels {
    /// Variance of the channels' scores from residuals over that from the errors, which are taken as independent innovations:
    ///
    /// `1 - sum_c |A_c^T W J_c x|^2 / sum_c tr(A_c^T W A_c)`
    ///
    /// with the derivatives `A_c = dr_c/d(movements) per_deviation` of a channel's innovations r and their weights W: a residual is
    /// `e - J x` for what the errors e move the person by, whose covariance is that of the errors that remain, `H^-1`, and x is drawn
    /// from it (the leverage of clusters; Bell and McCaffrey 2002, Survey Methodology 28:169; here one number for a person).
    ///
    /// `samples`: draws of `x`, as movements of the landmarks. `[frame][observed landmark]`, [3, samples]
    pub(crate) fn unabsorbed(
        &self,
        (cameras, positions): (&[PosedCamera], &Positions),
        movements: &Movements,
        per_deviation: &DMatrix<f64>,
        samples: &[Vec<Matrix3xX<f64>>],
    ) -> f64 {
        let of_landmark = |landmark: usize| {
            let of_channel = |channel: &Channel| {
                let axes = self.linear_innovations(channel, landmark, (cameras, positions), movements, samples);
                axes.map(|axis| axis.leverage(per_deviation)).into_iter().fold(Leverage::default(), Leverage::and)
            };
            self.channels[landmark].iter().map(of_channel).fold(Leverage::default(), Leverage::and)
        };
        let of_landmarks: Vec<Leverage> = (0..self.landmarks.len()).into_par_iter().map(of_landmark).collect();
        let Leverage { errors, absorbed } = of_landmarks.into_iter().fold(Leverage::default(), Leverage::and);
        if errors > 0.0 { 1.0 - absorbed / errors } else { 1.0 }
    }

    /// A channel's innovations by axis of the image.
    fn linear_innovations(
        &self,
        channel: &Channel,
        landmark: usize,
        (cameras, positions): (&[PosedCamera], &Positions),
        movements: &Movements,
        samples: &[Vec<Matrix3xX<f64>>],
    ) -> [LinearInnovations; 2] {
        let linear = channel.linearised(landmark, cameras, positions);
        let n = movements.of_camera.len();
        let n_samples = channel.seen.first().map_or(0, |seen| samples[seen.frame][landmark].ncols());
        let none = LinearInnovations::zeros(movements.cameras.ncols(), n_samples, channel.seen.len());
        let mut axes = [none.clone(), none];
        for (k, seen) in channel.seen.iter().enumerate() {
            let Some(e) = seen.parts.combined(|i| linear[i].map(|l| l.residual)) else { continue };
            let root = (channel.weight * geman_mcclure(e.norm_squared(), self.robust_scale).weight).sqrt();
            for (i, factor) in seen.parts.iter() {
                let Some(l) = linear[i] else { continue };
                let mut by_camera = ByCamera::zeros();
                movements.of_camera.add(&l, root * factor, &mut by_camera);
                let (frame, by_point) = (channel.seen[i].frame, l.by_point * (root * factor));
                let by_unknowns = by_point * &movements.landmarks[frame][landmark]
                    + by_camera.columns(0, n) * movements.cameras.rows(n * channel.camera, n);
                let sampled = by_point * &samples[frame][landmark];
                for (axis, innovations) in axes.iter_mut().enumerate() {
                    let mut column = innovations.by_unknowns.column_mut(k);
                    column += by_unknowns.row(axis).transpose();
                    let mut column = innovations.sampled.column_mut(k);
                    column += sampled.row(axis).transpose();
                }
            }
        }
        axes
    }
}

/// Innovations of one channel along one axis, times the square roots of their weights: one per column.
#[derive(Clone)]
struct LinearInnovations {
    /// Derivatives. [unknowns, innovations]
    by_unknowns: DMatrix<f64>,
    /// By how much they change in each sample. [samples, innovations]
    sampled: DMatrix<f64>,
}

impl LinearInnovations {
    fn zeros(n_unknowns: usize, n_samples: usize, n: usize) -> Self {
        Self { by_unknowns: DMatrix::zeros(n_unknowns, n), sampled: DMatrix::zeros(n_samples, n) }
    }

    fn leverage(&self, per_deviation: &DMatrix<f64>) -> Leverage {
        let by_deviations = per_deviation.tr_mul(&self.by_unknowns);
        let absorbed = &by_deviations * self.sampled.transpose();
        Leverage {
            errors: by_deviations.norm_squared(),
            absorbed: absorbed.norm_squared() / absorbed.ncols().max(1) as f64,
        }
    }
}

impl Leverage {
    fn and(self, other: Self) -> Self {
        Self { errors: self.errors + other.errors, absorbed: self.absorbed + other.absorbed }
    }
}
