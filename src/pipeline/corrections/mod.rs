//! Corrections: what a person that looked at a result knows better than the solve (`options.corrections`).
//!
//! Corrections are applied in their order to the people of the solve *without* corrections, at one place: the association at the
//! end of the passes that decide on identities ([`super::continuation`]). A person keeps its number through all corrections; the
//! part that a split cuts off gets the next free number. So a list of corrections stays valid when another one is appended, and
//! the last one is undone by leaving it out.
//!
//! Merging, splitting and exchanging people leaves unchanged which detections of a frame show one person, on which the cameras
//! depend: they, and what was measured under them, stay valid. Exclusions remove detections, so that cameras are adjusted again,
//! from where they are, together with the bodies.

pub mod forms;
mod identities;
#[cfg(test)]
mod tests;

pub use identities::{CorrectedPeople, corrected_people};
use serde::{Deserialize, Serialize};

/// One correction. People have the numbers of the result, frames those of the session.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "service", derive(utoipa::ToSchema))]
#[serde(tag = "action", rename_all = "snake_case", deny_unknown_fields)]
pub enum Correction {
    /// Names a person.
    Rename {
        /// The person.
        person: usize,
        /// The new name.
        name: String,
    },
    /// Makes one person of several.
    Merge {
        /// The people, at least two; the first one's number stays.
        people: Vec<usize>,
    },
    /// Makes a new person of the later part of a person.
    Split {
        /// The person that keeps the earlier part.
        person: usize,
        /// First frame of the new person.
        frame: i64,
    },
    /// Exchanges two people.
    Exchange {
        /// The two people.
        #[cfg_attr(feature = "service", schema(min_items = 2, max_items = 2))]
        people: [usize; 2],
        /// First frame in which they are exchanged.
        frame: i64,
        /// Last such frame; to the end without it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        #[cfg_attr(feature = "service", schema(nullable = false))]
        last_frame: Option<i64>,
    },
    /// Leaves a camera out.
    ExcludeCamera {
        /// The camera.
        camera: String,
    },
    /// Leaves a person out.
    ExcludePerson {
        /// The person.
        person: usize,
    },
    /// Leaves detections of a range of frames out.
    ExcludeFrames {
        /// First and last frame.
        #[cfg_attr(feature = "service", schema(min_items = 2, max_items = 2))]
        frames: [i64; 2],
        /// Only those of this camera.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        #[cfg_attr(feature = "service", schema(nullable = false))]
        camera: Option<String>,
        /// Only those of this person.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        #[cfg_attr(feature = "service", schema(nullable = false))]
        person: Option<usize>,
    },
    /// States a person's standing height, from which the metric scale follows.
    SetHeight {
        /// The person.
        person: usize,
        /// Height without shoes, m.
        metres: f64,
    },
}

impl Correction {
    /// Value of the field `action`.
    pub fn action(&self) -> &'static str {
        match self {
            Self::Rename { .. } => "rename",
            Self::Merge { .. } => "merge",
            Self::Split { .. } => "split",
            Self::Exchange { .. } => "exchange",
            Self::ExcludeCamera { .. } => "exclude_camera",
            Self::ExcludePerson { .. } => "exclude_person",
            Self::ExcludeFrames { .. } => "exclude_frames",
            Self::SetHeight { .. } => "set_height",
        }
    }

    /// Whether detections are left out, on which the cameras depend.
    pub fn excludes(&self) -> bool {
        matches!(self, Self::ExcludeCamera { .. } | Self::ExcludePerson { .. } | Self::ExcludeFrames { .. })
    }

    /// The error that this correction, of index `index` in the list, cannot be applied.
    pub fn error(&self, index: usize, reason: String) -> CorrectionError {
        CorrectionError { number: index + 1, action: self.action(), reason }
    }

    /// The camera that the correction names.
    pub fn camera(&self) -> Option<&str> {
        match self {
            Self::ExcludeCamera { camera } | Self::ExcludeFrames { camera: Some(camera), .. } => Some(camera),
            _ => None,
        }
    }
}

/// A correction that cannot be applied.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("correction {number} ({action}): {reason}")]
pub struct CorrectionError {
    /// Number of the correction in the list, from 1.
    pub number: usize,
    /// Its action.
    pub action: &'static str,
    /// What is wrong and what to do about it.
    pub reason: String,
}
