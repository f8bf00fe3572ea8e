//! The prepared session that all stages read.

use super::config::{Extrinsics, Options};
use crate::body::bones::{LimbBone, limb_bones};
use crate::geometry::{Intrinsics, Rigid};
use crate::matching::normalized::{NormalizedView, normalized_views};
use crate::matching::tracker::TrackerScene;
use crate::matching::tracklets::{Tracklet, TrackletConfig, tracklets};
use crate::session::Session;
use rayon::prelude::*;

/// A session with its options and what stages derive from it once.
pub struct Capture<'a> {
    /// The session.
    pub session: &'a Session,
    /// The user's options.
    pub options: &'a Options,
    /// Every view's detections in normalised coordinates.
    pub views: Vec<NormalizedView>,
    /// Limb bones with reference lengths.
    pub bones: Vec<LimbBone>,
    /// For every keypoint its left or right counterpart, itself on the midline.
    pub mirror: Vec<usize>,
}

impl<'a> Capture<'a> {
    /// Prepares a session.
    pub fn new(session: &'a Session, options: &'a Options) -> Self {
        let (bones, mirror) = (limb_bones(session.convention), session.convention.mirror());
        Self { session, options, views: normalized_views(session), bones, mirror }
    }

    /// The tracker's input under these cameras (`camera_from_world` per view).
    pub fn scene<'b>(&'b self, cameras: &'b [Option<Rigid>]) -> TrackerScene<'b> {
        let (fps, n_frames) = (self.session.fps, self.session.n_frames);
        TrackerScene {
            views: &self.views,
            cameras,
            bones: &self.bones,
            mirror: &self.mirror,
            fps,
            n_frames,
            is_backwards: false,
        }
    }

    /// People followed within each view.
    pub fn tracklets(&self) -> Vec<Vec<Tracklet>> {
        let (fps, config) = (self.session.fps, TrackletConfig::default());
        self.views.par_iter().map(|view| tracklets(view, fps, &config)).collect()
    }

    /// Intrinsics per view.
    pub fn intrinsics(&self) -> Vec<Intrinsics> {
        self.session.views.iter().map(|view| view.intrinsics).collect()
    }

    /// Whether the cameras' poses are estimated without a start.
    pub fn estimates_extrinsics(&self) -> bool {
        self.options.extrinsics == Extrinsics::Estimate
    }
}
