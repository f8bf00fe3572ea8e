//! The tracker's input: detections of all views, posed cameras, and the gates within which detections belong to persons.

use crate::body::bones::LimbBone;
use crate::geometry::Rigid;
use crate::geometry::epipolar::essential_from_pose;
use crate::matching::normalized::{NormalizedDetection, NormalizedView};
use nalgebra::{Matrix3, Vector2};

/// Gates of the tracker. Lengths are metres on a body: the depth says what a pixel is worth.
#[derive(Debug, Clone)]
pub struct TrackerConfig {
    /// A detection belongs to a prediction when their median joint distance is below this, m: three standard deviations
    /// of 0.06 m.
    pub gate: f64,
    /// The gate widens by this for every second without a detection, m/s: people turn and stop.
    pub gate_growth: f64,
    /// A view whose median residual to the triangulated skeleton exceeds this loses its detection, m.
    pub max_residual: f64,
    /// Radius within which rays of two views agree on a new person, m.
    pub agreement_radius: f64,
    /// A person must be seen by two views (by the only one of a single camera) for this long to exist, s.
    pub min_duration: f64,
    /// A person unseen for this long has left, s.
    pub max_gap: f64,
}

impl Default for TrackerConfig {
    fn default() -> Self {
        let (gate, gate_growth, max_residual, agreement_radius) = (0.18, 0.4, 0.13, 0.08);
        Self { gate, gate_growth, max_residual, agreement_radius, min_duration: 0.3, max_gap: 1.0 }
    }
}

/// A detection that shows a person.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Shown {
    /// Index in the view's list of the frame.
    pub detection: usize,
    /// Whether the detector has exchanged the person's left and right.
    pub is_exchanged: bool,
}

impl Shown {
    /// A detection with its sides as the detector has them.
    pub fn as_detected(detection: usize) -> Self {
        Self { detection, is_exchanged: false }
    }
}

/// The detection of every view that shows one person in one frame.
pub type Assignment = Vec<Option<Shown>>;

/// A detection with the sides that it has on the person it shows.
#[derive(Clone, Copy)]
pub(super) struct Seen<'a> {
    pub(super) detection: &'a NormalizedDetection,
    /// The keypoints' counterparts, where left and right are exchanged.
    mirror: Option<&'a [usize]>,
}

impl<'a> Seen<'a> {
    pub(super) fn as_detected(detection: &'a NormalizedDetection) -> Self {
        Self { detection, mirror: None }
    }

    pub(super) fn exchanged(detection: &'a NormalizedDetection, mirror: &'a [usize]) -> Self {
        Self { detection, mirror: Some(mirror) }
    }

    pub(super) fn is_exchanged(&self) -> bool {
        self.mirror.is_some()
    }

    pub(super) fn n_keypoints(&self) -> usize {
        self.detection.normalized.len()
    }

    /// Ideal normalised coordinates of a keypoint of the person.
    pub(super) fn normalized(&self, keypoint: usize) -> Vector2<f64> {
        self.detection.normalized[self.source(keypoint)]
    }

    pub(super) fn confidence(&self, keypoint: usize) -> f64 {
        self.detection.confidence[self.source(keypoint)]
    }

    /// Sum of the squared distances of the keypoints of both sides, over the squared apparent size.
    pub(super) fn sidedness(&self, mirror: &[usize]) -> f64 {
        let NormalizedDetection { normalized, confidence, size, .. } = self.detection;
        let is_pair = |k: &usize| mirror[*k] > *k && confidence[*k] > 0.0 && confidence[mirror[*k]] > 0.0;
        let pairs = (0..normalized.len()).filter(is_pair);
        pairs.map(|k| (normalized[k] - normalized[mirror[k]]).norm_squared()).sum::<f64>() / (size * size)
    }

    fn source(&self, keypoint: usize) -> usize {
        self.mirror.map_or(keypoint, |mirror| mirror[keypoint])
    }
}

/// What the tracker works on.
pub struct TrackerScene<'a> {
    /// Detections of every view.
    pub views: &'a [NormalizedView],
    /// `camera_from_world` of every view, m; `None` where the pose is not known yet.
    pub cameras: &'a [Option<Rigid>],
    /// Bones with reference lengths.
    pub bones: &'a [LimbBone],
    /// For every keypoint its left or right counterpart, itself on the midline.
    pub mirror: &'a [usize],
    /// Frames per second.
    pub fps: f64,
    /// Number of frames.
    pub n_frames: usize,
    /// Whether frames are counted from the end, so that the tracker follows people backwards in time.
    pub is_backwards: bool,
}

impl<'a> TrackerScene<'a> {
    /// The same scene with the frames in the other order.
    pub(super) fn backwards(&self) -> Self {
        Self { is_backwards: !self.is_backwards, ..*self }
    }

    /// The number of a frame in the other order.
    pub(super) fn mirrored_frame(&self, frame: usize) -> usize {
        self.n_frames - 1 - frame
    }

    /// The detections of a view in a frame.
    pub(super) fn detections(&self, view: usize, frame: usize) -> &'a [NormalizedDetection] {
        let frame = if self.is_backwards { self.mirrored_frame(frame) } else { frame };
        &self.views[view].frames[frame]
    }

    /// How many views must see a person at once to confirm it: two, or the only one.
    pub(super) fn n_confirming_views(&self) -> usize {
        self.views.len().min(2)
    }

    /// Whether enough views see a person to confirm it.
    pub(super) fn is_confirmed(&self, assignment: &[Option<Shown>]) -> bool {
        assignment.iter().flatten().count() >= self.n_confirming_views()
    }

    /// The assigned detections of a frame, with their views.
    pub(super) fn detections_of(&self, frame: usize, assignment: &[Option<Shown>]) -> Vec<(usize, Seen<'a>)> {
        let seen = |(v, shown): (usize, &Option<Shown>)| shown.map(|shown| (v, self.seen(v, frame, shown)));
        assignment.iter().enumerate().filter_map(seen).collect()
    }

    pub(super) fn seen(&self, view: usize, frame: usize, shown: Shown) -> Seen<'a> {
        let detection = &self.detections(view, frame)[shown.detection];
        if shown.is_exchanged { Seen::exchanged(detection, self.mirror) } else { Seen::as_detected(detection) }
    }

    /// The detections of a frame that are assigned to no person, per view; none of views without a camera pose.
    pub(super) fn unassigned(&self, frame: usize, assignments: &[Assignment]) -> Vec<Vec<usize>> {
        let of_view = |view: usize| {
            let n = if self.cameras[view].is_some() { self.detections(view, frame).len() } else { 0 };
            (0..n).filter(|d| !assignments.iter().any(|a| a[view].is_some_and(|shown| shown.detection == *d))).collect()
        };
        (0..self.views.len()).map(of_view).collect()
    }

    /// The essential matrix of two views; `None` where a camera pose is not known.
    pub(super) fn essential(&self, first: usize, second: usize) -> Option<Matrix3<f64>> {
        let (first, second) = (self.cameras[first].as_ref()?, self.cameras[second].as_ref()?);
        Some(essential_from_pose(&(*second * first.inverse())))
    }
}

/// A scene without cameras, for tests of tracked persons alone.
#[cfg(test)]
pub(super) const EMPTY_SCENE: TrackerScene =
    TrackerScene { views: &[], cameras: &[], bones: &[], mirror: &[], fps: 30.0, n_frames: 9, is_backwards: false };
