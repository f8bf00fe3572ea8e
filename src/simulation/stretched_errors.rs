//! Errors that are stretched along changing axes, and a detector that states their covariances.
//!
//! The error of a keypoint becomes `A e` with the symmetric `A = g R diag(sqrt r, 1 / sqrt r) R^T`: a size g that changes by three
//! times, an elongation r of one to three and a direction, each of which drifts. The detector states `sigma^2 A^2`; outliers are
//! not in it.

use super::config::SimulationConfig;
use super::keypoint_errors::Disturbed;
use super::processes::{Drift, white};
use super::projection::Projected;
use super::random::{Purpose, normal, stream};
use crate::geometry::PixelCovariance;
use nalgebra::{Matrix2, Rotation2, Vector2};
use rand_chacha::ChaCha8Rng;

/// Largest size over the smallest, and largest elongation.
const RANGE: f64 = 3.0;
/// Time after which sizes and directions are correlated by 1/e, s. Chosen: between motion blur and occlusion.
const STRETCH_SECS: f64 = 0.5;

/// The stretches of one person's errors in a view.
pub(super) struct StretchedErrors {
    rng: ChaCha8Rng,
    drift: Drift,
    /// By keypoint, standard normal.
    sizes: Vec<f64>,
    elongations: Vec<f64>,
    /// Twice the angle of the long axis is that of these.
    directions: Vec<Vector2<f64>>,
}

impl StretchedErrors {
    pub(super) fn new(view: usize, person: usize, config: &SimulationConfig) -> Self {
        let mut rng = stream(config.seed, Purpose::Covariances, view, person);
        let n = config.point_names().len();
        let mut numbers = || (0..n).map(|_| normal(&mut rng, 1.0)).collect();
        let (sizes, elongations) = (numbers(), numbers());
        let directions = (0..n).map(|_| white(&mut rng)).collect();
        Self { drift: Drift::with_time(STRETCH_SECS, config.fps), sizes, elongations, directions, rng }
    }

    /// Advances by one frame.
    pub(super) fn advance(&mut self) {
        self.drift.advance_numbers(&mut self.sizes, &mut self.rng);
        self.drift.advance_numbers(&mut self.elongations, &mut self.rng);
        self.drift.advance(&mut self.directions, &mut self.rng);
    }

    /// Stretches the errors of `disturbed` and returns what the detector states of them.
    pub(super) fn apply(&self, points: &[Projected], disturbed: &mut [Disturbed]) -> Vec<Option<PixelCovariance>> {
        let stretch = |(k, (point, found)): (usize, (&Projected, &mut Disturbed))| {
            let stretch = self.stretch(k);
            if !found.is_outlier {
                found.pixel = point.pixel + stretch * (found.pixel - point.pixel);
            }
            let covariance = stretch * stretch * found.sigma_px.powi(2);
            PixelCovariance::new([covariance[(0, 0)], covariance[(0, 1)], covariance[(1, 1)]])
        };
        points.iter().zip(disturbed).enumerate().map(stretch).collect()
    }

    fn stretch(&self, k: usize) -> Matrix2<f64> {
        let size = RANGE.powf(quantile(self.sizes[k]) - 0.5);
        let root = RANGE.powf(0.5 * quantile(self.elongations[k]));
        let turn = Rotation2::new(0.5 * self.directions[k].y.atan2(self.directions[k].x));
        turn * Matrix2::from_diagonal(&Vector2::new(size * root, size / root)) * turn.inverse()
    }
}

/// About the share of standard normal numbers below `x`: nearly uniform.
fn quantile(x: f64) -> f64 {
    0.5 * (1.0 + (0.8 * x).tanh())
}

#[cfg(test)]
mod tests {
    use crate::simulation::{NoiseConfig, Preset, SimulationConfig, simulate};

    /// Errors over the stated standard deviations have unit variance: 5 people-views of 60 frames, slow in part.
    #[test]
    fn stated_covariances_are_those_of_the_errors() {
        let noise = NoiseConfig { jitter_of_size: 0.012, covariances: true, ..NoiseConfig::NONE };
        let config = SimulationConfig { noise, frames: 60, ..SimulationConfig::preset(Preset::Paper) };
        let exact = simulate(&SimulationConfig { noise: NoiseConfig::NONE, ..config.clone() }).unwrap().session;
        let stretched = simulate(&config).unwrap().session;
        let (mut squares, mut n, mut sizes) = (0.0, 0.0, Vec::new());
        for (exact, stretched) in exact.views.iter().zip(&stretched.views) {
            for (exact, stretched) in exact.frames.iter().flatten().zip(stretched.frames.iter().flatten()) {
                for (exact, found) in exact.keypoints.iter().zip(&stretched.keypoints) {
                    assert_eq!(found.covariance.is_some(), found.is_present());
                    let Some(covariance) = found.covariance.filter(|_| exact.is_present()) else { continue };
                    let whitened = covariance.whitening(1.0) * (found.pixel - exact.pixel) / covariance.size();
                    (squares, n) = (squares + whitened.norm_squared(), n + 2.0);
                    sizes.push(covariance.size());
                }
            }
        }
        assert!(n > 5_000.0 && (squares / n - 1.0).abs() < 0.05, "{} of {n}", squares / n);
        sizes.sort_by(f64::total_cmp);
        assert!(sizes[sizes.len() * 19 / 20] > 2.0 * sizes[sizes.len() / 20]);
    }
}
