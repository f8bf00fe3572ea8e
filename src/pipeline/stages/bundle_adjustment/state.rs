//! The unknowns of bundle adjustment and their values.

use crate::geometry::{Intrinsics, Rigid};
use nalgebra::Vector3;

/// Current values of a camera's unknowns, with the intrinsics that follow from them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CameraState {
    pub(super) intrinsics: Intrinsics,
    pub(super) log_focal: f64,
    /// Frames.
    pub(super) delay: f64,
    pub(super) camera_from_world: Rigid,
}

/// All unknowns.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct State {
    /// `None` for views that take no part.
    pub(super) cameras: Vec<Option<CameraState>>,
    /// [person, bone], flat.
    pub(super) log_lengths: Vec<f64>,
    /// [keyframe][slot]
    pub(super) points: Vec<Vec<Vector3<f64>>>,
}
