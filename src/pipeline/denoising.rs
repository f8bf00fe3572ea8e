//! Stage 3: physics-geometry consistency. Detections that contradict everything else seen are given to somebody else,
//! turned the right way round, or lose the joints that are wrong.
//!
//! A person's expected place is their smooth path over the whole take (from all views, past and future), so that an
//! identity is judged by all time at once and not by the frame before. Frames in which that leaves a choice are solved
//! as one cycle-consistent matching of all detections and all people ([`crate::matching::convex`]).

mod flips;
mod identity;
mod joints;
mod told;

use crate::body::detector_noise::DetectorNoise;
use crate::geometry::Rigid;
use crate::matching::consistency::Seen;
use crate::matching::sightings::ViewSightings;
use crate::progress::{Canceled, Progress};
use crate::session::reconstruction::{ConsistencyReport, StageReport};
use crate::session::{JointTrajectory, PersonTrack, Session};
use flips::{Flip, flips};
use nalgebra::Vector3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// What the stage reads.
#[derive(Clone, Copy)]
pub struct DenoisingInput<'a> {
    /// The detections as they came.
    pub session: &'a Session,
    /// The same as rays.
    pub views: &'a [ViewSightings],
    /// `camera_from_world`, metres as far as bones tell.
    pub cameras: &'a [Option<Rigid>],
    /// Who is who so far.
    pub tracks: &'a [PersonTrack],
    /// Everybody's smooth path, in the order of the tracks.
    pub paths: &'a [JointTrajectory],
    /// How far the detector errs.
    pub noise: &'a DetectorNoise,
}

/// What the stage leaves.
pub struct Denoised {
    /// The detections, cleaned: same frames, same order, nothing moved but keypoints of flipped parts, nothing lost but
    /// the confidence of rejected joints.
    pub session: Session,
    /// Who is who.
    pub tracks: Vec<PersonTrack>,
    /// What was done.
    pub told: ConsistencyReport,
    /// Figures.
    pub report: StageReport,
}

/// Cleans the detections and repairs who is who. The same input gives the same bytes whatever the thread count.
///
/// # Errors
/// [`Canceled`].
pub fn denoise(input: DenoisingInput, progress: &Progress) -> Result<Denoised, Canceled> {
    let ground = Ground { input, flips: flips(input.session.convention) };
    let frames = (0..input.session.n_frames).into_par_iter();
    let solved: Vec<identity::FrameIdentities> = frames
        .map(|frame| {
            if frame % 64 == 0 {
                progress.check()?;
            }
            Ok(identity::identities_at(&ground, frame))
        })
        .collect::<Result<_, Canceled>>()?;
    let tracks = identity::retraced(input.tracks, &solved);
    let mut session = input.session.clone();
    let mut deeds = Vec::new();
    for (track, path) in tracks.iter().zip(input.paths) {
        for (t, claim) in track.detections.iter().enumerate() {
            for (view, detection) in claim.iter().enumerate().filter_map(|(v, d)| d.map(|d| (v, d))) {
                let at = Place { view, frame: track.first.0 + t, detection };
                let Some(seen) = ground.seen(at) else { continue };
                let points = &path.points[t];
                let flip = flips::best(&ground, seen, points);
                let rejected = joints::rejected(&ground, seen, points, &path.n_views[t], flip);
                let keypoints = &mut session.views[view].frames[at.frame][detection].keypoints;
                ground.flips[flip].apply(keypoints);
                rejected.iter().for_each(|&k| keypoints[k].confidence = 0.0);
                deeds.push(told::Deed { person: track.person, at, is_flipped: flip > 0, n_rejected: rejected.len() });
            }
        }
    }
    let told = told::told(&input, &tracks, &deeds, &solved);
    let report = stage_report(&told, &deeds, &solved);
    Ok(Denoised { session, tracks, told, report })
}

/// A detection's place in the session.
#[derive(Debug, Clone, Copy)]
struct Place {
    view: usize,
    frame: usize,
    detection: usize,
}

/// What every step reads.
struct Ground<'a> {
    input: DenoisingInput<'a>,
    /// The first leaves everything as it is.
    flips: Vec<Flip>,
}

impl<'a> Ground<'a> {
    fn seen(&self, at: Place) -> Option<Seen<'a>> {
        let camera = self.input.cameras[at.view].as_ref()?;
        Some(Seen { camera, sighting: &self.input.views[at.view].frames[at.frame][at.detection] })
    }

    /// Where a person is expected at a frame.
    fn expected(&self, person: usize, frame: usize) -> Option<&'a [Option<Vector3<f64>>]> {
        let path = &self.input.paths[person];
        path.points.get(frame.checked_sub(path.first.0)?).map(Vec::as_slice)
    }
}

fn stage_report(told: &ConsistencyReport, deeds: &[told::Deed], solved: &[identity::FrameIdentities]) -> StageReport {
    let figures = [
        ("frames_ambiguous", solved.iter().filter(|s| s.is_ambiguous).count()),
        ("detections_kept", deeds.len()),
        ("detections_reassigned", told.pairs.iter().map(|p| p.rejected_detections).sum()),
        ("joints_rejected", told.pairs.iter().map(|p| p.rejected_joints).sum()),
        ("flips_undone", told.pairs.iter().map(|p| p.flips_undone).sum()),
        ("swaps_repaired", told.pairs.iter().map(|p| p.swaps_repaired.len()).sum()),
    ];
    StageReport {
        stage: "denoising".to_owned(),
        iterations: solved.len(),
        cost_before: None,
        cost_after: None,
        termination: "all_frames".to_owned(),
        metrics: figures.into_iter().map(|(name, n)| (name.to_owned(), n as f64)).collect::<BTreeMap<_, _>>(),
    }
}
