//! What was done, camera by camera and person by person.

use super::{DenoisingInput, SolvedFrame};
use crate::session::PersonTrack;
use crate::session::reconstruction::{ConsistencyPair, ConsistencyReport};
use crate::session::recording::PersonId;
use std::collections::BTreeMap;

/// Sums it up.
pub(super) fn told(input: &DenoisingInput, tracks: &[PersonTrack], solved: &[SolvedFrame]) -> ConsistencyReport {
    let mut pairs: BTreeMap<(usize, PersonId), ConsistencyPair> = BTreeMap::new();
    let mut pair = |view: usize, person: PersonId, tell: &dyn Fn(&mut ConsistencyPair)| {
        let camera = input.session.views[view].id.clone();
        let new = || ConsistencyPair { camera, person: person.0, ..ConsistencyPair::default() };
        tell(pairs.entry((view, person)).or_insert_with(new));
    };
    for deed in solved.iter().flat_map(|frame| &frame.deeds) {
        pair(deed.at.view, tracks[deed.track].person, &|p| {
            p.flips_undone += usize::from(deed.flip > 0);
            p.rejected_joints += deed.rejected.len();
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

/// Runs of frames in which a track id of a view named somebody else than it mostly does: who was really shown, and when.
fn swaps(input: &DenoisingInput, tracks: &[PersonTrack]) -> Vec<(usize, PersonId, [usize; 2])> {
    let mut shown: BTreeMap<(usize, i64), Vec<(usize, PersonId)>> = BTreeMap::new();
    for track in tracks {
        for (t, claim) in track.detections.iter().enumerate() {
            for (view, detection) in claim.iter().enumerate().filter_map(|(v, d)| d.map(|d| (v, d))) {
                let frame = track.first.0 + t;
                if let Some(id) = input.session.views[view].frames[frame][detection].track_id {
                    shown.entry((view, id)).or_default().push((frame, track.person));
                }
            }
        }
    }
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
                // A frame without the detection does not end a swap.
                Some((who, range)) if *who == person && frame - range[1] <= 3 => range[1] = frame,
                _ => swaps.extend(run.replace((person, [frame, frame])).map(|(who, range)| (view, who, range))),
            }
        }
        swaps.extend(run.map(|(who, range)| (view, who, range)));
    }
    swaps
}
