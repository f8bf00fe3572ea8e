//! Smoothness: accelerations of the pelvis and of the joint rotations.

use super::super::config::BodyFitConfig;
use super::speed_scaling::{rotation_speeds, sigma_growth, speeds};
use super::term::WindowTerm;
use super::unknowns::{MotionState, Unknowns};
use super::window::{LinearisedWindow, PosedWindow, RobustAcceleration, Window};
use crate::body::joint_ranges::JointRange;
use crate::body::skeleton::N_JOINTS;
use crate::optim::block_banded::{Corner, FramePanel};
use crate::residuals::acceleration::{SECOND_DIFFERENCE, jacobians_of_change, second_difference};
use nalgebra::{Matrix3, Vector3};

/// Standard deviations of one frame's accelerations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct AccelerationSigmas {
    /// Of the pelvis, m/s^2.
    pub pelvis: f64,
    /// Of the joint rotations, rad/s^2.
    pub rotations: [f64; N_JOINTS],
}

/// Robust accelerations of the pelvis and of every free joint.
pub(crate) struct Smoothness {
    /// By frame.
    sigmas: Vec<AccelerationSigmas>,
    /// Group and joint of the free rotations.
    rotations: Vec<(usize, usize)>,
    /// Group of the translation.
    translation: usize,
    robust: RobustAcceleration,
    /// s.
    frame_interval: f64,
}

/// Median speed of the pelvis over CMU's takes, m/s.
const PELVIS_SPEED: f64 = 0.27;

/// Median angular speed of a joint over its typical acceleration, s: of spine, neck, hip, shoulder, elbow and ankle the same
/// within a third.
const ROTATION_SECS: f64 = 0.08;

/// Factor on the pelvis's accelerations where cameras leave its course open: accelerations last over some frames, so that over gaps of
/// 15, 30, 60 and 90 frames of CMU's takes the pelvis is 2.0, 1.95, 1.5 and 1.2 times as far from the smoothest course as accelerations
/// that change from frame to frame would bring it.
const LASTING: f64 = 1.9;

impl Smoothness {
    /// Sigmas at typical speeds, in all of `n_frames` frames.
    pub(crate) fn new(
        config: &BodyFitConfig,
        ranges: &[JointRange; N_JOINTS],
        unknowns: &Unknowns,
        robust: RobustAcceleration,
        n_frames: usize,
        frame_interval: f64,
    ) -> Self {
        let typical = AccelerationSigmas {
            pelvis: config.pelvis_acceleration_sigma,
            rotations: ranges.each_ref().map(|range| range.acceleration * config.angular_acceleration_factor),
        };
        let (rotations, translation) = (unknowns.rotations().collect(), unknowns.translation());
        Self { sigmas: vec![typical; n_frames], rotations, translation, robust, frame_interval }
    }

    /// The same with sigmas scaled by the speeds of `state`, of `joints` alone: the others keep the typical ones.
    pub(crate) fn speed_scaled(
        mut self,
        state: &MotionState,
        joints: &[usize],
        ranges: &[JointRange; N_JOINTS],
    ) -> Self {
        let (poses, dt) = (&state.poses, self.frame_interval);
        let moved = |a: usize, b: usize| poses[b].translation - poses[a].translation;
        for (sigmas, speed) in self.sigmas.iter_mut().zip(speeds(poses.len(), dt, moved)) {
            sigmas.pelvis *= sigma_growth(speed / PELVIS_SPEED);
        }
        for &joint in joints {
            let typical = ROTATION_SECS * ranges[joint].acceleration;
            for (sigmas, speed) in self.sigmas.iter_mut().zip(rotation_speeds(poses, joint, dt)) {
                sigmas.rotations[joint] *= sigma_growth(speed / typical);
            }
        }
        self
    }

    /// The same with wider accelerations of the pelvis in frames that are open.
    pub(crate) fn loosened(mut self, is_open: &[bool]) -> Self {
        let open = self.sigmas.iter_mut().zip(is_open).filter(|(_, is_open)| **is_open);
        open.for_each(|(sigmas, _)| sigmas.pelvis *= LASTING);
        self
    }

    /// Standardised acceleration of the pelvis, and one over its sigma and the squared frame interval.
    fn pelvis<L, T>(&self, window: &Window<L, T>) -> (Vector3<f64>, f64) {
        let scale = 1.0 / (self.frame_interval.powi(2) * self.sigmas[window.middle].pelvis);
        (second_difference(window.poses.map(|pose| pose.translation)) * scale, scale)
    }

    /// One over the sigma of a joint and the squared frame interval.
    fn rotation_scale(&self, middle: usize, joint: usize) -> f64 {
        1.0 / (self.frame_interval.powi(2) * self.sigmas[middle].rotations[joint])
    }
}

impl WindowTerm for Smoothness {
    fn cost(&self, window: &PosedWindow) -> f64 {
        let joint_cost = |&(group, joint): &(usize, usize)| {
            let [before, after] = window.turns.map(|turns| turns[group]);
            self.robust.cost(&((after - before) * self.rotation_scale(window.middle, joint)))
        };
        self.robust.cost(&self.pelvis(window).0) + self.rotations.iter().map(joint_cost).sum::<f64>()
    }

    fn add_to(&self, window: &LinearisedWindow, panels: &mut [FramePanel], _: &mut Corner) {
        let (residual, scale) = self.pelvis(window);
        let jacobians = SECOND_DIFFERENCE.map(|c| Matrix3::identity() * (c * scale));
        self.robust.add_to(&residual, 3 * self.translation, &jacobians, panels);
        for &(group, joint) in &self.rotations {
            let [before, after] = window.turns.map(|turns| &turns[group]);
            let scale = self.rotation_scale(window.middle, joint);
            let jacobians = jacobians_of_change(before, after).map(|jacobian| jacobian * scale);
            self.robust.add_to(&((after.value - before.value) * scale), 3 * group, &jacobians, panels);
        }
    }
}
