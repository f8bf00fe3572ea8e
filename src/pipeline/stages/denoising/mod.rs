//! Stage 3: physics-geometry consistency. Detections that contradict everything else seen are given to somebody else,
//! turned the right way round, or lose the joints that are wrong.
//!
//! A person's expected place is their smooth path over the whole take (from all views, past and future), so that an
//! identity is judged by all time at once and not by the frame before. Frames in which that leaves a choice are solved
//! as one cycle-consistent matching of all detections and all people ([`crate::matching::convex`]).

mod flips;
mod identity;
mod joints;
mod scene;
mod told;

use crate::body::detector_noise::DetectorNoise;
use crate::geometry::Rigid;
use crate::matching::normalized::NormalizedView;
use crate::progress::{Canceled, Progress};
use crate::session::reconstruction::{ConsistencyReport, StageReport};
use crate::session::{JointTrajectory, PersonTrack, Session};
use flips::{Flip, flips};
use identity::FrameIdentities;
use rayon::prelude::*;
use scene::Scene;
use std::collections::BTreeMap;

/// What the stage reads.
#[derive(Clone, Copy)]
pub struct DenoisingInput<'a> {
    /// The detections as they came.
    pub session: &'a Session,
    /// The same as rays.
    pub views: &'a [NormalizedView],
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
    let solved: Vec<SolvedFrame> = frames
        .map(|frame| {
            if frame % 64 == 0 {
                progress.check()?;
            }
            Ok(ground.solved(&Scene::at(&input, frame)))
        })
        .collect::<Result<_, Canceled>>()?;
    let mut session = input.session.clone();
    let mut tracks: Vec<PersonTrack> = input.tracks.iter().map(unclaimed).collect();
    for deed in solved.iter().flat_map(|frame| &frame.deeds) {
        let Place { view, frame, detection } = deed.at;
        let track = &mut tracks[deed.track];
        track.detections[frame - track.first.0][view] = Some(detection);
        let keypoints = &mut session.views[view].frames[frame][detection].keypoints;
        ground.flips[deed.flip].apply(keypoints);
        deed.rejected.iter().for_each(|&k| keypoints[k].confidence = 0.0);
    }
    let told = told::told(&input, &tracks, &solved);
    let report = stage_report(&told, &solved);
    Ok(Denoised { session, tracks, told, report })
}

/// The same people at the same time, without what was given to them.
fn unclaimed(track: &PersonTrack) -> PersonTrack {
    let nothing = |of_frame: &Vec<_>| vec![None; of_frame.len()];
    PersonTrack { detections: track.detections.iter().map(nothing).collect(), ..track.clone() }
}

/// One frame, solved.
struct SolvedFrame {
    deeds: Vec<Deed>,
    is_ambiguous: bool,
}

/// A detection given to a person, and what was done to it.
struct Deed {
    /// Index of the track.
    track: usize,
    at: Place,
    /// Index of the way round.
    flip: usize,
    /// Keypoints, after the flip.
    rejected: Vec<usize>,
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

impl Ground<'_> {
    /// Gives a frame's detections to people and mends them.
    fn solved(&self, scene: &Scene) -> SolvedFrame {
        let FrameIdentities { claims, is_ambiguous } = identity::identities(self, scene);
        let mut deeds = Vec::new();
        for (person, claim) in claims.iter().enumerate() {
            for (view, detection) in claim.iter().enumerate().filter_map(|(v, d)| d.map(|d| (v, d))) {
                let at = Place { view, frame: scene.frame, detection };
                let track = scene.present[person];
                let (seen, expected) = (scene.seen(at), &scene.views[view].expected[person]);
                let path = &self.input.paths[track];
                let flip = flips::best(self, seen, expected);
                let rejected = joints::rejected(self, seen, expected, &path.n_views[scene.frame - path.first.0], flip);
                deeds.push(Deed { track, at, flip, rejected });
            }
        }
        SolvedFrame { deeds, is_ambiguous }
    }
}

fn stage_report(told: &ConsistencyReport, solved: &[SolvedFrame]) -> StageReport {
    let figures = [
        ("frames_ambiguous", solved.iter().filter(|s| s.is_ambiguous).count()),
        ("detections_kept", solved.iter().map(|s| s.deeds.len()).sum()),
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
