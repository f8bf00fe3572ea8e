//! Detections of every view in ideal normalised coordinates: undistorted, over the focal length, with an apparent size.

use crate::body::detector_profile::{DETECTOR, error_scale, least_error_scale};
use crate::session::{Detection, Session, View};
use nalgebra::Vector2;
use rayon::prelude::*;

/// Height from ankles to eyes of an average standing person, m: relates apparent size to depth.
pub const BODY_SPAN_M: f64 = 1.6;

/// A detection in ideal normalised coordinates.
#[derive(Debug, Clone, Default)]
pub struct NormalizedDetection {
    /// Ideal normalised image coordinates per named keypoint; meaningless where `confidence` is 0.
    pub normalized: Vec<Vector2<f64>>,
    /// Confidence per named keypoint, 0 where missing.
    pub confidence: Vec<f64>,
    /// Larger side of the bounding box of all keypoints, normalised units.
    pub size: f64,
    /// See [`least_error_scale`].
    pub least_error_scale: f64,
    /// The detector's track number.
    pub track_id: Option<i64>,
}

impl NormalizedDetection {
    /// Normalises a detection of `view`; its first `n_keypoints` keypoints are the named ones.
    pub fn from_detection(view: &View, detection: &Detection, n_keypoints: usize) -> Self {
        let mut normalized = Vec::with_capacity(n_keypoints);
        let mut confidence = Vec::with_capacity(n_keypoints);
        let (mut low, mut high) = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
        for keypoint in &detection.keypoints[..n_keypoints] {
            let usable = keypoint.confidence >= DETECTOR.min_confidence;
            let point = if usable { view.intrinsics.normalized_from_pixel(&keypoint.pixel) } else { Vector2::zeros() };
            if usable {
                low = low.inf(&point);
                high = high.sup(&point);
            }
            normalized.push(point);
            confidence.push(if usable { keypoint.confidence } else { 0.0 });
        }
        let size = if low.x.is_finite() { (high - low).max().max(MIN_SIZE) } else { MIN_SIZE };
        let least_error_scale = least_error_scale(&view.intrinsics);
        Self { normalized, confidence, size, least_error_scale, track_id: detection.track_id }
    }

    /// All keypoints seen by a common lens.
    #[cfg(test)]
    pub fn of_points(normalized: Vec<Vector2<f64>>, size: f64) -> Self {
        let confidence = vec![0.9; normalized.len()];
        Self { normalized, confidence, size, least_error_scale: 1.0, track_id: None }
    }

    /// How many times larger its errors are than on people 4 m away, by its apparent size.
    pub fn error_scale(&self) -> f64 {
        error_scale(BODY_SPAN_M / self.size, self.least_error_scale)
    }

    /// Number of usable keypoints.
    pub fn n_points(&self) -> usize {
        self.confidence.iter().filter(|c| **c > 0.0).count()
    }
}

/// Smallest apparent size, normalised units (10 px at a focal length of 1,000 px): keeps ratios finite.
const MIN_SIZE: f64 = 0.01;

/// All detections of a view.
#[derive(Debug, Clone)]
pub struct NormalizedView {
    /// Mean focal length, px.
    pub focal: f64,
    /// Detections per frame, in the session's order.
    pub frames: Vec<Vec<NormalizedDetection>>,
}

/// Normalises all views of a session.
pub fn normalized_views(session: &Session) -> Vec<NormalizedView> {
    let n_keypoints = session.convention.names().len();
    let of_view = |view: &View| NormalizedView {
        focal: view.intrinsics.focal(),
        frames: view
            .frames
            .par_iter()
            .map(|people| people.iter().map(|d| NormalizedDetection::from_detection(view, d, n_keypoints)).collect())
            .collect(),
    };
    session.views.par_iter().map(of_view).collect()
}
