//! Input and settings of bundle adjustment.

use crate::geometry::{Intrinsics, Rigid};
use crate::optim::robust::GraduatedScale;
use crate::pipeline::calibration::CameraFreedom;
use crate::pipeline::keyframe::Keyframe;

/// Two keypoints at a nearly constant distance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bone {
    /// Keypoint at one end.
    pub a: usize,
    /// Keypoint at the other end.
    pub b: usize,
    /// Relative standard deviation of the length over time: detector noise and soft tissue.
    pub sigma: f64,
}

/// Input of [`adjust`](super::adjust).
#[derive(Debug, Clone, PartialEq)]
pub struct AdjustmentInput<'a> {
    /// Per view.
    pub intrinsics: &'a [Intrinsics],
    /// `camera_from_world` per view; an unsolved view (`None`) stays unsolved.
    pub cameras: Vec<Option<Rigid>>,
    /// In any order; the result has the same order.
    pub keyframes: Vec<Keyframe>,
    /// The same for all persons; empty for independent points.
    pub bones: &'a [Bone],
    /// Whether poses are adjusted.
    pub camera_freedom: CameraFreedom,
    /// Whether each moving camera has a factor on its focal lengths.
    pub refine_focal: bool,
    /// Whether each moving camera has a delay; only differences between cameras are determined.
    pub refine_delays: bool,
    /// Length of the take, frames, over which each moving camera's delay changes linearly ([`AdjustedCamera::drift`]); `None`: delays
    /// are constant.
    ///
    /// [`AdjustedCamera::drift`]: crate::pipeline::calibration::AdjustedCamera::drift
    pub drift_over: Option<usize>,
    /// Whether the first radial coefficient of each moving camera's lens is changed.
    pub refine_radial: bool,
}

/// Settings of [`adjust`](super::adjust).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdjustmentConfig {
    /// Robust scales in standard deviations.
    pub scale: GraduatedScale,
    /// Largest number of steps at every scale but the last; the next scale moves the minimum anyway.
    pub iterations_per_scale: usize,
    /// Largest number of steps at the last scale.
    pub final_iterations: usize,
    /// Relative decrease of the cost below which the solver stops.
    pub relative_decrease: f64,
    /// Standard deviation of the logarithm of a focal factor; used where focal lengths are refined.
    pub focal_sigma: f64,
    /// Standard deviation of a delay, and of a drift, frames; used where these are refined.
    pub delay_sigma: f64,
    /// Standard deviation of the change of a radial coefficient; used where these are refined.
    pub radial_sigma: f64,
    /// Length of a block of one person's frames, the unit with independent errors in the cameras' uncertainty; `None`: the
    /// uncertainty is not computed, which saves as much time as some ten iterations.
    pub uncertainty_block_frames: Option<usize>,
}

impl Default for AdjustmentConfig {
    fn default() -> Self {
        Self {
            // 30 sigma: a camera 5 degrees off, at 1000 px focal length and 3 px noise. 4 sigma: keeps 95 % of the
            // efficiency on Gaussian noise, and an outlier of 10 sigma has 2 % of its weight.
            scale: GraduatedScale { start: 30.0, end: 4.0, steps: 5 },
            iterations_per_scale: 5,
            final_iterations: 30,
            // 1e-6 of the cost is below 0.1 sigma of any parameter with more than 100 observations.
            relative_decrease: 1e-6,
            // A guessed angle of view. How far the focal lengths really are off is decided afterwards.
            focal_sigma: 0.1,
            // The path of a keypoint is straight for some two frames.
            delay_sigma: 2.0,
            // Lenses of action cameras have -0.3, others between -0.2 and 0.1.
            radial_sigma: 0.2,
            // 2 s at 25 Hz: detector errors are correlated over some 10 frames (AR(0.9)); a block must span several.
            uncertainty_block_frames: Some(50),
        }
    }
}
