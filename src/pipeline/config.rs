//! What a user may ask for. Stored with the job, so that a run can be repeated.

use crate::session::reconstruction::ExportFormat;
use crate::session::recording::UpAxis;
use serde::{Deserialize, Serialize};

/// Options of one job; names and defaults are the HTTP contract's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// How many people there are, where it is known.
    pub people: Option<usize>,
    /// What to do with the cameras' poses.
    pub extrinsics: Extrinsics,
    /// What to do with the cameras' intrinsics.
    pub intrinsics: IntrinsicsMode,
    /// Where the metric scale comes from.
    pub scale: ScaleSource,
    /// Up axis of the result's world.
    pub up_axis: UpAxis,
    /// Physics-geometry consistency stage.
    pub denoise: bool,
    /// Latent motion prior.
    pub motion_prior: bool,
    /// Bodies do not pass through each other.
    pub collision: bool,
    /// Name of a registered body model.
    pub body: String,
    /// Time offsets between cameras.
    pub sync: Sync,
    /// Seed of every random choice.
    pub seed: u64,
    /// Formats to write beside the JSON files.
    pub exports: Vec<ExportFormat>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            people: None,
            extrinsics: Extrinsics::Estimate,
            intrinsics: IntrinsicsMode::Fixed,
            scale: ScaleSource::Body,
            up_axis: UpAxis::Y,
            denoise: true,
            motion_prior: true,
            collision: true,
            body: "default".to_owned(),
            sync: Sync::Given,
            seed: 0,
            exports: vec![ExportFormat::SmplNpz],
        }
    }
}

/// `options.extrinsics`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Extrinsics {
    /// From nothing.
    Estimate,
    /// Those of the session, untouched.
    Fixed,
    /// Those of the session as a start.
    Refine,
}

/// `options.intrinsics`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum IntrinsicsMode {
    /// As given.
    Fixed,
    /// One focal factor per camera is refined.
    RefineFocal,
}

/// `options.scale`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "from", rename_all = "snake_case", deny_unknown_fields)]
pub enum ScaleSource {
    /// From the people's bones.
    Body,
    /// One person's standing height is known.
    Height {
        /// Height, m.
        metres: f64,
        /// `tallest` or a track id.
        who: String,
    },
    /// The distance between two cameras is known.
    CameraDistance {
        /// Camera ids.
        cameras: [String; 2],
        /// Distance of their centres, m.
        metres: f64,
    },
}

/// `options.sync`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Sync {
    /// Frames of equal number were taken at the same time.
    Given,
    /// Offsets are estimated.
    Estimate,
}
