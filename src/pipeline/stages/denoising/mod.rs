//! Repair of detections by physics-geometry consistency: detections that contradict all others are assigned to another
//! person, flipped left to right, or lose the keypoints that are wrong.
//!
//! The expected pose of a person is the smooth trajectory over the whole recording (all views, past and future), so that an
//! identity is judged on all frames at once and not by the previous frame. Ambiguous frames are solved as one
//! cycle-consistent matching of all detections and all persons ([`crate::matching::convex`]).

mod context;
mod flips;
mod frame_view;
mod identity;
mod report;

use crate::body::detector_noise::DetectorNoise;
use crate::geometry::projection::NormalizedProjection;
use crate::matching::consistency::{PosedDetection, squared_misfit};
use crate::matching::normalized::NormalizedView;
use crate::pipeline::calibration::TrackedPeople;
use crate::progress::{Canceled, Progress};
use crate::session::reconstruction::{ConsistencyReport, StageReport};
use crate::session::{Keypoint, PersonTrack, Session};
use context::{Context, DetectionIndex, FrameRepairs, Repair};
use flips::UNCHANGED;
use frame_view::FrameView;
use identity::FrameIdentities;
use rayon::prelude::*;

/// Result of the stage.
pub struct Denoised {
    /// The detections with flipped parts turned back: same frames and order, and only keypoints of these parts move.
    pub unflipped: Session,
    /// Keypoints that are wrong.
    pub rejected: Vec<Rejected>,
    /// The association after the repair.
    pub tracks: Vec<PersonTrack>,
    /// Repairs per camera and person.
    pub report: ConsistencyReport,
    /// Statistics of the stage.
    pub stage_report: StageReport,
}

/// Rejected keypoints of one detection, after the flip.
pub struct Rejected {
    at: DetectionIndex,
    keypoints: Vec<usize>,
}

/// The repaired detections: `unflipped` where rejected keypoints lose their confidence.
pub fn without_rejected(mut unflipped: Session, rejected: &[Rejected]) -> Session {
    for Rejected { at, keypoints } in rejected {
        let detection = &mut unflipped.views[at.view].frames[at.frame][at.detection];
        keypoints.iter().for_each(|&k| detection.keypoints[k].confidence = 0.0);
    }
    unflipped
}

/// Repairs the detections and the association; `input` holds the smooth trajectories, `views` the detections in normalised
/// coordinates. The same input gives the same bytes whatever the number of threads.
pub fn denoise(input: TrackedPeople, views: &[NormalizedView], progress: &Progress) -> Result<Denoised, Canceled> {
    let context = Context::new(input, views);
    let frames = (0..input.session.n_frames).into_par_iter();
    let solved: Vec<FrameRepairs> = frames
        .map(|frame| {
            if frame % 64 == 0 {
                progress.check()?;
            }
            Ok(repaired_frame(&context, &FrameView::new(&context, frame)))
        })
        .collect::<Result<_, Canceled>>()?;
    let mut unflipped = input.session.clone();
    let mut tracks: Vec<PersonTrack> = input.tracks.iter().map(without_detections).collect();
    let repairs = || solved.iter().flat_map(|frame| &frame.repairs);
    for Repair { track, at: DetectionIndex { view, frame, detection }, flip, .. } in repairs() {
        let track = &mut tracks[*track];
        track.detections[frame - track.first.0][*view] = Some(*detection);
        let keypoints = &mut unflipped.views[*view].frames[*frame][*detection].keypoints;
        context.flips[*flip].apply(keypoints);
        if *flip != UNCHANGED && input.session.dense.is_some() {
            // Which of the dense landmarks were exchanged is unknown.
            keypoints[input.session.convention.n_keypoints()..].fill(Keypoint::MISSING);
        }
    }
    let report = report::consistency_report(&input, &tracks, &solved);
    let stage_report = report::stage_report(&report, &solved);
    let rejected = solved.into_iter().flat_map(|frame| frame.repairs).filter(|repair| !repair.rejected.is_empty());
    let rejected = rejected.map(|Repair { at, rejected, .. }| Rejected { at, keypoints: rejected }).collect();
    Ok(Denoised { unflipped, rejected, tracks, report, stage_report })
}

/// The same person and frames without detections.
fn without_detections(track: &PersonTrack) -> PersonTrack {
    let nothing = |of_frame: &Vec<_>| vec![None; of_frame.len()];
    PersonTrack { detections: track.detections.iter().map(nothing).collect(), ..track.clone() }
}

/// Assigns a frame's detections to persons and repairs them.
fn repaired_frame(context: &Context, frame: &FrameView) -> FrameRepairs {
    let FrameIdentities { assignments, is_ambiguous } = identity::identities(context, frame);
    let mut repairs = Vec::new();
    for (person, assignment) in assignments.iter().enumerate() {
        for (view, detection) in assignment.iter().enumerate().filter_map(|(v, d)| d.map(|d| (v, d))) {
            let at = DetectionIndex { view, frame: frame.frame, detection };
            let track = frame.present[person];
            let (seen, expected) = (frame.seen(at), &frame.views[view].expected[person]);
            let trajectory = &context.input.points[track];
            let n_views = &trajectory.n_views[frame.frame - trajectory.first.0];
            let flip = flips::best(&context.flips, context.input.noise, seen, expected);
            let order = &context.flips[flip].order;
            let rejected = rejected(context.input.noise, seen, expected, n_views, order);
            repairs.push(Repair { track, at, flip, rejected });
        }
    }
    FrameRepairs { repairs, is_ambiguous }
}

/// Distance from the person's trajectory beyond which a keypoint is wrong, standard deviations. Errors of what is hidden or hard to
/// see are up to 2.5 times the usual ones, and still say where it is: at 5, cameras come 1 to 5 % and the joints of a person in three
/// views 2 % worse. From 7 on mistakes in the files are named less often, from 10 on cameras from 4 s of real detections come worse.
const MAX_SIGMAS: f64 = 6.0;

/// Smallest number of views of the keypoint: with fewer it is unknown which of them is wrong.
const MIN_VIEWS: u8 = 3;

/// Keypoints that contradict all other views; `order`: the permutation of the flip.
fn rejected(
    noise: &DetectorNoise,
    seen: &PosedDetection,
    expected: &[Option<NormalizedProjection>],
    n_views: &[u8],
    order: &[usize],
) -> Vec<usize> {
    let is_wrong = |k: &usize| {
        let misfit = expected[*k].and_then(|point| squared_misfit(seen, order[*k], &point, noise, *k));
        n_views[*k] >= MIN_VIEWS && misfit.is_some_and(|e2| e2 > MAX_SIGMAS * MAX_SIGMAS)
    };
    (0..expected.len()).filter(is_wrong).collect()
}
