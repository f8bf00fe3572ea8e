//! The solution that the check tests.

use crate::body::bones::LENGTH_SIGMA;
use crate::geometry::{Intrinsics, Rigid};
use crate::pipeline::calibration::{Calibration, TrackedPeople};
use crate::pipeline::capture::Capture;
use crate::pipeline::stages::bundle_adjustment::input::Bone;
use crate::pipeline::stages::recording_check::lens::{Lens, SeenPeople};
use crate::session::{JointTrajectory, Session, Suspicion, View};
use rayon::prelude::*;

/// Keyframes of an adjustment that tests other parameters: half of those of the last adjustment give standard errors that are 1.4
/// times as large, still far below what counts.
pub(super) const MAX_KEYFRAMES: usize = 250;

/// Length of an independent block of one person, s.
const BLOCK_SECS: f64 = 2.0;

/// The solution that is tested.
pub struct Solved<'a> {
    /// The recording as given, before detections were repaired.
    pub given: &'a Capture<'a>,
    /// The recording with repaired detections.
    pub repaired: &'a Session,
    /// Cameras and persons.
    pub calibration: &'a Calibration,
    /// Smooth trajectories of the persons.
    pub paths: &'a [JointTrajectory],
    /// What the files alone have shown.
    pub known: &'a [Suspicion],
}

impl Solved<'_> {
    /// The recording as given.
    pub(super) fn session(&self) -> &Session {
        self.given.session
    }

    /// Names of cameras.
    pub(super) fn ids(&self, views: &[usize]) -> Vec<String> {
        views.iter().map(|&v| self.session().views[v].id.clone()).collect()
    }

    /// Whether a suspicion names the camera.
    pub(super) fn is_named(&self, view: usize, found: &[Suspicion]) -> bool {
        self.known.iter().chain(found).any(|s| s.cameras.contains(&self.session().views[view].id))
    }

    /// Views with a pose that no suspicion names so far.
    pub(super) fn unnamed(&self, found: &[Suspicion]) -> Vec<usize> {
        let placed = (0..self.calibration.cameras.len()).filter(|&v| self.calibration.cameras[v].is_some());
        placed.filter(|&v| !self.is_named(v, found)).collect()
    }

    /// By view the share of its detections that show a person.
    pub(super) fn assigned_shares(&self) -> Vec<f64> {
        let tracks = &self.calibration.association.tracks;
        let share = |(view, seen): (usize, &View)| {
            let n_seen = seen.frames.iter().flatten().filter(|d| d.has_points()).count();
            let assigned = tracks.iter().flat_map(|track| &track.detections).filter(|people| people[view].is_some());
            assigned.count() as f64 / n_seen.max(1) as f64
        };
        self.session().views.iter().enumerate().map(share).collect()
    }

    /// Length of an independent block of one person, frames.
    pub(super) fn independent_frames(&self) -> usize {
        ((BLOCK_SECS * self.session().fps).round() as usize).max(1)
    }

    /// Bones of all people.
    pub(super) fn bones(&self) -> Vec<Bone> {
        self.given.bones.iter().map(|bone| Bone { a: bone.a, b: bone.b, sigma: LENGTH_SIGMA }).collect()
    }

    /// Detections as given with the persons and trajectories of the solution.
    pub(super) fn people(&self) -> TrackedPeople<'_> {
        self.calibration.people(self.session(), self.paths)
    }

    /// Per view the focal length and pose under which the unnamed cameras show the people best; `None` where those given are as
    /// good.
    pub(super) fn resections(&self) -> Vec<Option<Lens>> {
        let (people, unnamed) = (self.people(), self.unnamed(&[]));
        let lens = |view: usize| {
            let seen = unnamed.contains(&view).then(|| SeenPeople::of(&people, view)).flatten()?;
            seen.resected()
        };
        let lenses: Vec<Option<Lens>> = (0..self.calibration.cameras.len()).into_par_iter().map(lens).collect();
        tracing::debug!(?lenses, "resections");
        lenses
    }

    /// The given intrinsics and `cameras`, with those of `resections` where there are any.
    pub(super) fn resected(
        &self,
        resections: &[Option<Lens>],
        mut cameras: Vec<Option<Rigid>>,
    ) -> (Vec<Intrinsics>, Vec<Option<Rigid>>) {
        let mut intrinsics = self.given.intrinsics();
        for ((lens, intrinsics), camera) in resections.iter().zip(&mut intrinsics).zip(&mut cameras) {
            if let Some(lens) = lens {
                *intrinsics = intrinsics.with_focal_factor(lens.factor);
                *camera = Some(lens.camera_from_world);
            }
        }
        (intrinsics, cameras)
    }
}
