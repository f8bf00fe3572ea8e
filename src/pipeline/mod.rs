//! The stages, in order; whoever reads this page knows what the program does.

pub mod association;
pub mod body_fit;
pub mod bundle_adjustment;
pub mod calibration;
pub mod camera_init;
pub mod config;
pub mod fit_figures;
pub mod instants;
pub mod joint_trajectories;
pub mod verdict;
pub mod world_frame;

use crate::body::bones::{Bone, limb_bones};
use crate::geometry::Rigid;
use crate::matching::sightings::{ViewSightings, sightings};
use crate::matching::tracker::Scene;
use crate::progress::{Canceled, Progress};
use crate::session::Session;
pub use config::Options;

/// Why a capture cannot be solved at all.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// The caller asked to stop.
    #[error(transparent)]
    Canceled(#[from] Canceled),
    /// An option asks for what the session does not hold.
    #[error("{option}: {reason}")]
    Option {
        /// JSON pointer into the options.
        option: &'static str,
        /// What is missing and the remedy.
        reason: String,
    },
    /// Nothing to solve.
    #[error("{reason}")]
    Unsolvable {
        /// Machine-readable code.
        code: &'static str,
        /// What is missing and the remedy.
        reason: String,
    },
}

/// What every stage reads: the recording as rays, and what the options ask for.
pub struct Capture<'a> {
    /// The recording.
    pub session: &'a Session,
    /// What the user asked for.
    pub options: &'a Options,
    /// Every detection as rays.
    pub views: Vec<ViewSightings>,
    /// Limb bones with reference lengths.
    pub bones: Vec<Bone>,
    /// The same bones as the adjustment knows them.
    pub adjusted_bones: Vec<bundle_adjustment::Bone>,
}

/// Relative spread of a limb's length over time as detectors see it: 20 mm of noise at either end of 0.35 m.
const BONE_SIGMA: f64 = 0.08;

impl<'a> Capture<'a> {
    /// Prepares a session.
    pub fn new(session: &'a Session, options: &'a Options) -> Self {
        let bones = limb_bones(session.convention);
        let adjusted_bones =
            bones.iter().map(|b| bundle_adjustment::Bone { a: b.a, b: b.b, sigma: BONE_SIGMA }).collect();
        Self { session, options, views: sightings(session), bones, adjusted_bones }
    }

    /// The session under given cameras.
    pub fn scene<'b>(&'b self, cameras: &'b [Option<Rigid>]) -> Scene<'b> {
        let (fps, n_frames) = (self.session.fps, self.session.n_frames);
        Scene { views: &self.views, cameras, bones: &self.bones, fps, n_frames }
    }
}
