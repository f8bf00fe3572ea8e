//! The recording: a session of views, each with its camera's intrinsics and the people detected in every frame.

use crate::body::BodyModel;
use crate::body::dense_landmarks::DenseLandmarks;
use crate::body::skeleton::KeypointConvention;
use crate::geometry::{Intrinsics, PixelCovariance, Rigid};
use nalgebra::{Matrix2, Vector2, Vector3};
use std::sync::Arc;

/// Range of frame rates, frames per second: from time lapse to high speed.
pub const FPS_RANGE: [f64; 2] = [0.1, 2000.0];

/// Index of a frame on the session's dense time line, from 0; the session's own frame number is `first_frame + index`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
pub struct FrameIndex(pub usize);

/// Number of a person of the result, from 0, in descending order of the number of detections.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
pub struct PersonId(pub usize);

/// One detected 2D point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keypoint {
    /// Position, px, as detected (distorted); meaningless where `confidence` is 0.
    pub pixel: Vector2<f64>,
    /// Confidence of the detector, 0 (missing) to 1.
    pub confidence: f64,
    /// Covariance of the position as the detector states it, px^2; `None` where it states none.
    pub covariance: Option<PixelCovariance>,
}

impl Keypoint {
    /// A point that was not detected.
    pub const MISSING: Self = Self::new(Vector2::new(0.0, 0.0), 0.0);

    /// A point at `pixel`, without a covariance.
    pub const fn new(pixel: Vector2<f64>, confidence: f64) -> Self {
        Self { pixel, confidence, covariance: None }
    }

    /// The point after an affine map of the image's pixels.
    pub fn mapped(&self, map: impl Fn(Vector2<f64>) -> Vector2<f64>) -> Self {
        let pixel = map(self.pixel);
        let along = |axis: Vector2<f64>| map(self.pixel + axis) - pixel;
        let jacobian = || Matrix2::from_columns(&[along(Vector2::x()), along(Vector2::y())]);
        Self { pixel, covariance: self.covariance.and_then(|covariance| covariance.mapped(&jacobian())), ..*self }
    }

    /// Whether the detector reported the point.
    pub fn is_present(&self) -> bool {
        self.confidence > 0.0
    }
}

/// One person in a view and frame, as detected.
#[derive(Debug, Clone, PartialEq)]
pub struct Detection {
    /// Track number that the detector assigned, if any. Used as an observation, since detectors swap numbers.
    pub track_id: Option<i64>,
    /// One entry per keypoint of the session's convention, then one per dense landmark.
    pub keypoints: Vec<Keypoint>,
}

impl Detection {
    /// Whether any keypoint was detected.
    pub fn has_points(&self) -> bool {
        self.keypoints.iter().any(Keypoint::is_present)
    }

    /// The same with left and right exchanged; `twins`: [`Session::mirror`]. Points after those stay as they are: hands are given to
    /// their sides later.
    pub fn with_sides_exchanged(&self, twins: &[usize]) -> Self {
        let rest = self.keypoints.iter().skip(twins.len());
        Self {
            keypoints: twins.iter().map(|&twin| &self.keypoints[twin]).chain(rest).copied().collect(),
            ..self.clone()
        }
    }

    /// Whether both are of one person or thing at one place: three quarters of their common points among the first `n` are nearer to
    /// each other than 8 % of its size. A detector errs by up to 4 % per axis (Rayleigh's third quartile of the difference is 9 %);
    /// of 1.1 million detections of people who pass each other 54 were so near to another one, at most 0.2 % of a recording.
    pub fn coincides_with(&self, other: &Self, n: usize) -> bool {
        const NEAR: f64 = 0.08;
        const MIN_COMMON: usize = 4;
        let n_present = |detection: &Self| detection.keypoints[..n].iter().filter(|k| k.is_present()).count();
        let common = self.keypoints[..n].iter().zip(&other.keypoints).filter(|(a, b)| a.is_present() && b.is_present());
        let mut distances: Vec<f64> = common.map(|(a, b)| (a.pixel - b.pixel).norm()).collect();
        let n_common = distances.len();
        if n_common < MIN_COMMON || 2 * n_common < n_present(self).min(n_present(other)) {
            return false;
        }
        let third_quartile = *distances.select_nth_unstable_by(3 * n_common / 4, f64::total_cmp).1;
        third_quartile < NEAR * self.size_px(n).max(other.size_px(n))
    }

    /// Larger side of the bounding box of the first `n` points, px; 0 without any.
    pub(super) fn size_px(&self, n: usize) -> f64 {
        let points = || self.keypoints[..n].iter().filter(|k| k.is_present()).map(|k| k.pixel);
        let (low, high) = (points().reduce(|a, b| a.inf(&b)), points().reduce(|a, b| a.sup(&b)));
        low.zip(high).map_or(0.0, |(low, high)| (high - low).max())
    }
}

/// One camera and its detections.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// The camera's name; unique in the session, preserved byte for byte.
    pub id: String,
    /// Intrinsics as given by the session, else [`Intrinsics::guessed`].
    pub intrinsics: Intrinsics,
    /// Whether the session gives `K`.
    pub has_intrinsics: bool,
    /// Camera pose `camera_from_world`, metres, where the session gives it.
    pub camera_from_world: Option<Rigid>,
    /// Time offset of the camera, s: frame number `n` was taken at `n / fps + time_offset`.
    pub time_offset: f64,
    /// Detections by [`FrameIndex`], length `n_frames`; empty where the camera has no such frame.
    pub frames: Vec<Vec<Detection>>,
    /// The frames that the camera delivered, in the order of its file.
    pub delivered: Vec<FrameIndex>,
}

/// The up axis of a given world.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum UpAxis {
    /// +x is up.
    X,
    /// +y is up.
    Y,
    /// +z is up.
    Z,
}

impl UpAxis {
    /// Of the coordinate that is the height.
    pub fn index(self) -> usize {
        match self {
            Self::X => 0,
            Self::Y => 1,
            Self::Z => 2,
        }
    }

    /// Unit vector of the way up.
    pub fn direction(self) -> Vector3<f64> {
        Vector3::ith(self.index(), 1.0)
    }
}

/// A validated capture session.
#[derive(Debug, Clone, PartialEq)]
pub struct Session {
    /// Name of the session, for display.
    pub name: String,
    /// Frames per second.
    pub fps: f64,
    /// Frame number of frame index 0.
    pub first_frame: i64,
    /// Number of frames of the time line.
    pub n_frames: usize,
    /// Keypoint convention of all detections.
    pub convention: KeypointConvention,
    /// Points of every detection behind those of the convention; people are found by the convention's points, bodies and cameras
    /// are fitted to all.
    pub dense: Option<Arc<DenseLandmarks>>,
    /// Up axis of the given world, where extrinsics are given.
    pub up_axis: Option<UpAxis>,
    /// SMPTE time code of frame number 0, `HH:MM:SS:FF` (drop frame: `HH:MM:SS;FF`), where given.
    pub start_timecode: Option<String>,
    /// The cameras, in the session's order.
    pub views: Vec<View>,
}

impl Session {
    /// Frame number of a frame index.
    pub fn frame_number(&self, frame: FrameIndex) -> i64 {
        self.first_frame + frame.0 as i64
    }

    /// Number of points of every detection.
    pub fn n_points(&self) -> usize {
        self.convention.n_keypoints() + self.dense.as_ref().map_or(0, |dense| dense.landmarks.len())
    }

    /// For every point the index of its landmark, if the body has one; `model` has dense landmarks where
    /// [`DenseLandmarks::on`] has added them.
    pub fn landmarks_on(&self, model: &BodyModel) -> Vec<Option<usize>> {
        let mut landmarks = model.landmarks_of(self.convention);
        if let Some(dense) = &self.dense {
            landmarks.resize(self.convention.n_keypoints(), None);
            landmarks.extend(dense.places(model));
        }
        landmarks
    }

    /// For each point its left/right counterpart: of the convention's named keypoints, then of the dense landmarks.
    pub fn mirror(&self) -> Vec<usize> {
        let (of_convention, n) = (self.convention.mirror(), self.convention.n_keypoints());
        let Some(dense) = &self.dense else { return of_convention };
        of_convention.into_iter().chain(dense.mirror().into_iter().map(|twin| n + twin)).collect()
    }

    /// Duration of one frame, s.
    pub fn frame_interval(&self) -> f64 {
        1.0 / self.fps
    }

    /// The session with the keypoints of two views exchanged, whose positions are `a` and `b`.
    pub(crate) fn with_keypoints_exchanged(&self, a: usize, b: usize) -> Self {
        let mut exchanged = self.clone();
        for (to, from) in [(a, b), (b, a)] {
            exchanged.views[to].frames.clone_from(&self.views[from].frames);
            exchanged.views[to].delivered.clone_from(&self.views[from].delivered);
        }
        exchanged
    }
}
