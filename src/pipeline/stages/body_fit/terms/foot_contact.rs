//! Foot contact: standing feet do not move, hence accelerations of the ankles in the world are small.
//!
//! With smooth joint rotations alone, small errors of pelvis, hip and knee add up at a standing foot: on simulated captures
//! ankles accelerated two to three times as much as in truth, all other joints 0.8 to 1.3 times.

use super::super::config::BodyFitConfig;
use super::landmark_jacobian::BorderJacobian;
use super::speed_scaling::{sigma_growth, speeds};
use super::term::WindowTerm;
use super::unknowns::MotionState;
use super::window::{LinearisedWindow, PosedWindow, RobustAcceleration};
use crate::body::kinematics::{landmark_position, posed};
use crate::body::model::BodyModel;
use crate::optim::block_banded::{Corner, FramePanel, StripRows};
use crate::residuals::acceleration::{SECOND_DIFFERENCE, second_difference};
use nalgebra::{Matrix3, Vector3};

/// Median speed of an ankle over CMU's takes, m/s.
const ANKLE_SPEED: f64 = 0.10;

/// Robust accelerations of the ankles.
pub(crate) struct FootContact {
    /// Standard deviations by ankle and frame, m/s^2.
    sigmas: Vec<Vec<f64>>,
    robust: RobustAcceleration,
    /// s.
    frame_interval: f64,
}

/// The ankles: the tracked landmarks.
pub(crate) fn ankles(model: &BodyModel) -> Vec<usize> {
    ["left_ankle", "right_ankle"].iter().filter_map(|name| model.landmark_index(name)).collect()
}

impl FootContact {
    /// Sigmas at the typical speed, in all of `n_frames` frames.
    pub(crate) fn new(
        config: &BodyFitConfig,
        ankles: &[usize],
        robust: RobustAcceleration,
        n_frames: usize,
        frame_interval: f64,
    ) -> Self {
        let sigmas = vec![vec![config.ankle_acceleration_sigma; n_frames]; ankles.len()];
        Self { sigmas, robust, frame_interval }
    }

    /// The same with sigmas scaled by the speeds of `state`.
    pub(crate) fn speed_scaled(mut self, state: &MotionState, model: &BodyModel, ankles: &[usize]) -> Self {
        let body = model.shaped(&state.betas);
        let skeletons: Vec<_> = state.poses.iter().map(|pose| posed(&body, pose)).collect();
        for (sigmas, &ankle) in self.sigmas.iter_mut().zip(ankles) {
            let positions: Vec<Vector3<f64>> =
                skeletons.iter().map(|skeleton| landmark_position(model, &body, skeleton, ankle)).collect();
            let moved = |a: usize, b: usize| positions[b] - positions[a];
            for (sigma, speed) in sigmas.iter_mut().zip(speeds(positions.len(), self.frame_interval, moved)) {
                *sigma *= sigma_growth(speed / ANKLE_SPEED);
            }
        }
        self
    }

    /// One over the sigma of an ankle and the squared frame interval.
    fn scale(&self, ankle: usize, middle: usize) -> f64 {
        1.0 / (self.frame_interval.powi(2) * self.sigmas[ankle][middle])
    }

    fn add_ankle(&self, ankle: usize, window: &LinearisedWindow, panels: &mut [FramePanel], corner: &mut Corner) {
        let scale = self.scale(ankle, window.middle);
        let residual = second_difference(window.tracked.map(|landmarks| landmarks.positions[ankle])) * scale;
        let factors = SECOND_DIFFERENCE.map(|c| Matrix3::identity() * (c * scale));
        let jacobians = window.tracked.map(|landmarks| landmarks.jacobian(ankle));
        let by_border = BorderJacobian::sum([0, 1, 2].map(|i| (factors[i], jacobians[i].by_border)));
        let mut border_rows = StripRows::with_room();
        by_border.add_to_rows(&mut border_rows);
        let weight = self.robust.weight(&residual);
        for (i, (jacobian, factor)) in jacobians.iter().zip(&factors).enumerate() {
            let weighted = factor * weight;
            for (first, derivatives) in jacobian.by_frame {
                panels[i].add_gradient(*first, &derivatives.tr_mul(&(weighted * residual)));
            }
            for (k, (earlier, factor)) in jacobians.iter().zip(&factors).enumerate().take(i + 1) {
                panels[k].add_product(i - k, jacobian.rows, &(weighted * factor), earlier.by_frame);
            }
            panels[i].add_border_product(&border_rows, &weighted, jacobian.by_frame);
        }
        by_border.add_to_corner(&(residual * weight), &(Matrix3::identity() * weight), corner);
    }
}

impl WindowTerm for FootContact {
    fn cost(&self, window: &PosedWindow) -> f64 {
        let cost = |ankle: usize| {
            let positions = window.tracked.map(|landmarks| landmarks[ankle]);
            self.robust.cost(&(second_difference(positions) * self.scale(ankle, window.middle)))
        };
        (0..self.sigmas.len()).map(cost).sum()
    }

    fn add_to(&self, window: &LinearisedWindow, panels: &mut [FramePanel], corner: &mut Corner) {
        (0..self.sigmas.len()).for_each(|ankle| self.add_ankle(ankle, window, panels, corner));
    }
}
