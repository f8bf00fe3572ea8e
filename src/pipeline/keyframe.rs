//! Keyframes: single skeletons with their observations, the input of bundle adjustment.

use nalgebra::{Vector2, Vector3};

/// One person's skeleton in one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Keyframe {
    /// Index of the person; keyframes of one person share their bone lengths.
    pub person: usize,
    /// Frame number; only its distance to other frames matters.
    pub frame: usize,
    /// Start of every keypoint, world; a keypoint without a start (`None`) is not adjusted.
    pub points: Vec<Option<Vector3<f64>>>,
    /// Detected keypoints. Those of unsolved views and of points without a start are ignored.
    pub observations: Vec<Observation>,
}

/// One keypoint detected in a single view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Index into [`Keyframe::points`].
    pub keypoint: usize,
    /// Index of the view.
    pub view: usize,
    /// Detected position, distorted, px.
    pub pixel: Vector2<f64>,
    /// Standard deviation per axis, px, from confidence, keypoint class and apparent size.
    pub sigma_px: f64,
    /// Image velocity of the keypoint, px per frame; zero where it is unknown or not needed.
    pub velocity: Vector2<f64>,
}

impl Observation {
    /// The keypoint's position at the time of its frame number, if the view's frames are `delay` frames late.
    pub(crate) fn pixel_without(&self, delay: f64) -> Vector2<f64> {
        self.pixel - self.velocity * delay
    }
}
