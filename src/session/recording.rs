//! What was filmed: a session of views, each with its camera's intrinsics and the people detected frame by frame.

use crate::body::skeleton::KeypointConvention;
use crate::geometry::{Intrinsics, Rigid};
use nalgebra::Vector2;

/// Position of a frame on the session's dense time line, from 0; the session's own number is `first_frame + index`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
pub struct FrameIndex(pub usize);

/// A person of the result, numbered from 0 in order of support.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
pub struct PersonId(pub usize);

/// One detected point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keypoint {
    /// Pixels, as detected (distorted); meaningless where `confidence` is 0.
    pub pixel: Vector2<f64>,
    /// 0 (missing) to 1.
    pub confidence: f64,
}

impl Keypoint {
    /// Whether the detector reported the point at all.
    pub fn is_present(&self) -> bool {
        self.confidence > 0.0
    }
}

/// One person as one detector saw them in one image.
#[derive(Debug, Clone, PartialEq)]
pub struct Detection {
    /// The detector's own identity, if it gave one: evidence, never truth.
    pub track_id: Option<i64>,
    /// One entry per keypoint of the session's convention.
    pub keypoints: Vec<Keypoint>,
}

/// One camera and what it saw.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// The camera's name; unique in the session, kept byte for byte.
    pub id: String,
    /// Known intrinsics.
    pub intrinsics: Intrinsics,
    /// `camera_from_world`, metres, where the session gives it.
    pub camera_from_world: Option<Rigid>,
    /// When its frames were taken: frame number `n` at `n / fps + time_offset`, s.
    pub time_offset: f64,
    /// Detections by [`FrameIndex`]; empty where the camera has no such frame. Length `n_frames`.
    pub frames: Vec<Vec<Detection>>,
    /// The frames the camera delivered, in the order of its file.
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

/// A validated capture session.
#[derive(Debug, Clone, PartialEq)]
pub struct Session {
    /// For people to read.
    pub name: String,
    /// Frames per second.
    pub fps: f64,
    /// The session's own number of frame index 0.
    pub first_frame: i64,
    /// Length of the time line.
    pub n_frames: usize,
    /// What the keypoints are.
    pub convention: KeypointConvention,
    /// Up axis of the given world, where extrinsics are given.
    pub up_axis: Option<UpAxis>,
    /// SMPTE time code of frame number 0, `HH:MM:SS:FF` (drop frame: `HH:MM:SS;FF`), where the session gives it.
    pub start_timecode: Option<String>,
    /// The cameras, in the session's order.
    pub views: Vec<View>,
}

impl Session {
    /// The session's own number of a frame.
    pub fn frame_number(&self, frame: FrameIndex) -> i64 {
        self.first_frame + frame.0 as i64
    }

    /// Duration of one frame, s.
    pub fn frame_interval(&self) -> f64 {
        1.0 / self.fps
    }
}
