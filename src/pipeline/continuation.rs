//! What a solve with corrections continues from: cameras and people of the solve of the same session without them.
//!
//! It holds what the solve decided on cameras and people, and nothing that follows from it: points, trajectories and repaired
//! detections are computed anew. Corrections are applied to its association, the one place where identities are
//! decided. A corrected solve gives the same bytes whether its continuation was stored by an earlier solve or was computed by
//! itself.

use super::calibration::{Association, Calibration};
use super::checkpoints::{opened, sealed};
use super::config::Options;
use super::focal_lengths::FocalLengths;
use super::passes::synchronisation::Timing;
use super::repair::with_repairs;
use super::result::FittedResult;
use crate::session::reconstruction::{ConsistencyReport, DetectionRepairs};
use crate::session::{JointTrajectory, Session, Suspicion};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::borrow::Cow;

/// Cameras and people of a solve without corrections.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Continuation {
    /// Mistakes in the recording's files that were undone first, in this order.
    repairs: Vec<Suspicion>,
    timing: Timing,
    focal_lengths: FocalLengths,
    /// Without points.
    calibration: Calibration,
    heldout_px: Option<f64>,
    /// Mistakes that the solution shows.
    found: Vec<Suspicion>,
}

/// Cameras and people before their scale, world and bodies.
pub struct Placed {
    /// Time offsets that were applied to the session.
    pub timing: Timing,
    /// Focal lengths that were applied to the session.
    pub focal_lengths: FocalLengths,
    /// Cameras and people.
    pub calibration: Calibration,
    /// The detections that they explain, where these are not the session's own.
    pub observed: Option<Session>,
    /// Repairs of detections; `None` where that pass is switched off.
    pub repairs: Option<(ConsistencyReport, DetectionRepairs)>,
    /// Error of the cameras on frames that they were not adjusted to, px.
    pub heldout_px: Option<f64>,
    /// Smooth trajectories.
    pub paths: Vec<JointTrajectory>,
    /// Mistakes that the solution shows.
    pub found: Vec<Suspicion>,
}

impl Continuation {
    /// What remains valid of a solution, which was found after `repairs`.
    pub(super) fn of(placed: &Placed, repairs: &[Suspicion]) -> Self {
        let association = &placed.calibration.association;
        let association = Association { points: Vec::new(), tracks: association.tracks.clone(), ..*association };
        let mut calibration = Calibration { association, ..placed.calibration.clone() };
        if let Some(adjusted) = &mut calibration.adjusted {
            adjusted.points = Vec::new();
        }
        Self {
            repairs: repairs.to_vec(),
            timing: placed.timing.clone(),
            focal_lengths: placed.focal_lengths.clone(),
            calibration,
            heldout_px: placed.heldout_px,
            found: placed.found.clone(),
        }
    }

    /// With the cameras and focal lengths that were adjusted together with the bodies.
    pub(super) fn with_cameras(mut self, fitted: FittedResult, focal_lengths: FocalLengths) -> Self {
        self.calibration.take_over(&fitted.cameras, fitted.covariance.as_ref(), 1.0);
        self.calibration.with_bodies = fitted.covariance;
        Self { focal_lengths, ..self }
    }

    /// Session and options without the mistakes that were undone first.
    pub(super) fn repaired<'s>(&self, session: &'s Session, options: &Options) -> (Cow<'s, Session>, Options) {
        with_repairs(session, options, &self.repairs)
    }

    pub(super) fn repairs(&self) -> &[Suspicion] {
        &self.repairs
    }

    pub(super) fn timing(&self) -> &Timing {
        &self.timing
    }

    pub(super) fn focal_lengths(&self) -> &FocalLengths {
        &self.focal_lengths
    }

    pub(super) fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    pub(super) fn heldout_px(&self) -> Option<f64> {
        self.heldout_px
    }

    pub(super) fn found(&self) -> &[Suspicion] {
        &self.found
    }

    /// The text of a file from which solves of this session with these options and any corrections continue.
    ///
    /// `session_sha256`: digest of the session's file.
    ///
    /// # Errors
    /// None in practice: every part can be written as JSON.
    pub fn to_text(&self, session_sha256: &str, options: &Options) -> Result<String, serde_json::Error> {
        sealed(&key(session_sha256, options), self)
    }

    /// Reads [`Self::to_text`]; `None` where the text is damaged, or of another session, release or other options that matter.
    pub fn from_text(text: &str, session_sha256: &str, options: &Options) -> Option<Self> {
        opened(text, &key(session_sha256, options))
    }
}

/// Identifies the solve that a continuation is of.
fn key(session_sha256: &str, options: &Options) -> String {
    let options = serde_json::to_string(&options.without_corrections()).unwrap_or_default(); // always serialises
    let run = [env!("CARGO_PKG_VERSION"), "continuation", session_sha256, &options].join("\n");
    hex::encode(Sha256::digest(run.as_bytes()))
}
