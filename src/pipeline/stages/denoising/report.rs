//! Reports of the repairs.

use super::context::FrameRepairs;
use crate::pipeline::calibration::TrackedPeople;
use crate::session::PersonTrack;
use crate::session::reconstruction::{ConsistencyPair, ConsistencyReport, StageReport};
use crate::session::recording::PersonId;
use std::collections::BTreeMap;

/// Time without the detection of a person that does not end a swap, s.
const BRIDGED_SECS: f64 = 0.1;

/// Number of repairs per camera and person.
pub(super) fn consistency_report(
    input: &TrackedPeople,
    tracks: &[PersonTrack],
    solved: &[FrameRepairs],
) -> ConsistencyReport {
    let mut pairs: BTreeMap<(usize, PersonId), ConsistencyPair> = BTreeMap::new();
    let mut pair = |view: usize, person: PersonId, add: &dyn Fn(&mut ConsistencyPair)| {
        let camera = input.session.views[view].id.clone();
        let new = || ConsistencyPair { camera, person: person.0, ..ConsistencyPair::default() };
        add(pairs.entry((view, person)).or_insert_with(new));
    };
    for repair in solved.iter().flat_map(|frame| &frame.repairs) {
        pair(repair.at.view, tracks[repair.track].person, &|p| {
            p.flips_undone += usize::from(repair.flip > 0);
            p.rejected_joints += repair.rejected.len();
        });
    }
    for (before, after) in input.tracks.iter().zip(tracks) {
        for (was, is) in before.detections.iter().zip(&after.detections) {
            for view in (0..was.len()).filter(|&v| was[v].is_some() && was[v] != is[v]) {
                pair(view, before.person, &|p| p.rejected_detections += 1);
            }
        }
    }
    for (view, person, [first, last]) in swaps(input, tracks) {
        let number = |frame: usize| input.session.first_frame + frame as i64;
        pair(view, person, &|p| p.swaps_repaired.push([number(first), number(last)]));
    }
    let ambiguous_frames = solved.iter().filter(|s| s.is_ambiguous).count();
    ConsistencyReport { ambiguous_frames, pairs: pairs.into_values().collect(), ..ConsistencyReport::default() }
}

/// Runs of frames in which a track id of a view shows another person than it mostly does: view, person shown, and first and
/// last frame.
fn swaps(input: &TrackedPeople, tracks: &[PersonTrack]) -> Vec<(usize, PersonId, [usize; 2])> {
    let mut shown: BTreeMap<(usize, i64), Vec<(usize, PersonId)>> = BTreeMap::new();
    for track in tracks {
        for (t, assignment) in track.detections.iter().enumerate() {
            for (view, detection) in assignment.iter().enumerate().filter_map(|(v, d)| d.map(|d| (v, d))) {
                let frame = track.first.0 + t;
                if let Some(id) = input.session.views[view].frames[frame][detection].track_id {
                    shown.entry((view, id)).or_default().push((frame, track.person));
                }
            }
        }
    }
    let bridged = ((BRIDGED_SECS * input.session.fps).round() as usize).max(1);
    let mut swaps = Vec::new();
    for ((view, _), mut frames) in shown {
        frames.sort_unstable();
        let mut counts: BTreeMap<PersonId, usize> = BTreeMap::new();
        frames.iter().for_each(|(_, person)| *counts.entry(*person).or_default() += 1);
        let Some((usual, _)) = counts.into_iter().max_by_key(|(person, n)| (*n, std::cmp::Reverse(*person))) else {
            continue;
        };
        let mut run: Option<(PersonId, [usize; 2])> = None;
        for (frame, person) in frames.into_iter().filter(|(_, person)| *person != usual) {
            match &mut run {
                // Some frames without the detection do not end a swap.
                Some((current, range)) if *current == person && frame - range[1] <= bridged => range[1] = frame,
                _ => swaps.extend(run.replace((person, [frame, frame])).map(|(person, range)| (view, person, range))),
            }
        }
        swaps.extend(run.map(|(person, range)| (view, person, range)));
    }
    swaps
}

pub(super) fn stage_report(report: &ConsistencyReport, solved: &[FrameRepairs]) -> StageReport {
    let metrics = [
        ("frames_ambiguous", solved.iter().filter(|s| s.is_ambiguous).count()),
        ("detections_kept", solved.iter().map(|s| s.repairs.len()).sum()),
        ("detections_reassigned", report.pairs.iter().map(|p| p.rejected_detections).sum()),
        ("joints_rejected", report.pairs.iter().map(|p| p.rejected_joints).sum()),
        ("flips_undone", report.pairs.iter().map(|p| p.flips_undone).sum()),
        ("swaps_repaired", report.pairs.iter().map(|p| p.swaps_repaired.len()).sum()),
    ];
    StageReport::new("denoising", solved.len(), "all_frames", metrics.map(|(name, n)| (name, n as f64)))
}
