//! Who every detection of a frame shows, judged against everybody's whole path.

use super::{Ground, Place};
use crate::matching::assignment::assign;
use crate::matching::consistency::{GEOMETRY_WEIGHT, PHYSICS_WEIGHT, geometry_affinity, physics_affinity};
use crate::matching::convex::{MatcherConfig, match_all};
use crate::session::PersonTrack;
use nalgebra::DMatrix;

/// A detection that agrees less than this with a person does not show them: strangers reach 0.1 to 0.3.
const MIN_AFFINITY: f64 = 0.3;

/// Two people (or two detections) closer in agreement than this leave a choice.
const CLEAR_MARGIN: f64 = 0.2;

/// What the tracker's own word is worth against an affinity: it has seen the frame before, in 2D and in colour.
const HELD_BONUS: f64 = 0.03;

/// The detections of one frame.
pub(super) struct FrameIdentities {
    /// `claims[person][view]`: the detection that shows them.
    pub claims: Vec<Vec<Option<usize>>>,
    /// Whether the frame left a choice and was solved as a whole.
    pub is_ambiguous: bool,
}

/// Solves one frame.
pub(super) fn identities_at(ground: &Ground, frame: usize) -> FrameIdentities {
    let (n_people, n_views) = (ground.input.tracks.len(), ground.input.views.len());
    let present: Vec<usize> = (0..n_people).filter(|&p| ground.expected(p, frame).is_some()).collect();
    let agreement: Vec<Vec<Vec<f64>>> = (0..n_views).map(|v| agreements(ground, &present, v, frame)).collect();
    let is_ambiguous = agreement.iter().any(|of_view| leaves_a_choice(of_view));
    let mut claims = vec![vec![None; n_views]; n_people];
    if is_ambiguous {
        for (p, view, detection) in matched(ground, frame, &present, &agreement) {
            claims[present[p]][view] = Some(detection);
        }
    } else {
        for (view, of_view) in agreement.iter().enumerate() {
            let n_detections = of_view.first().map_or(0, Vec::len);
            let cost = |p: usize, d: usize| 1.0 - of_view[p][d];
            for (p, d) in assign(present.len(), n_detections, 1.0 - MIN_AFFINITY, cost).into_iter().enumerate() {
                claims[present[p]][view] = d;
            }
        }
    }
    FrameIdentities { claims, is_ambiguous }
}

/// `[person][detection]` in one view, under the better of the ways round.
fn agreements(ground: &Ground, present: &[usize], view: usize, frame: usize) -> Vec<Vec<f64>> {
    let n = if ground.input.cameras[view].is_some() { ground.input.views[view].frames[frame].len() } else { 0 };
    let of_person = |&person: &usize| {
        let track = &ground.input.tracks[person];
        let held = frame.checked_sub(track.first.0).and_then(|t| track.detections.get(t)?[view]);
        let of_detection = |detection: usize| {
            let seen = ground.seen(Place { view, frame, detection })?;
            let points = ground.expected(person, frame)?;
            let ways = ground.flips.iter().filter_map(|f| physics_affinity(seen, points, ground.input.noise, &f.order));
            let best = ways.reduce(f64::max)?;
            Some(best + if held == Some(detection) { HELD_BONUS } else { 0.0 })
        };
        (0..n).map(|d| of_detection(d).unwrap_or(0.0)).collect()
    };
    present.iter().map(of_person).collect()
}

/// Whether some person has two near candidates in a view, or some detection two near people.
fn leaves_a_choice(agreement: &[Vec<f64>]) -> bool {
    let is_close = |values: &mut dyn Iterator<Item = f64>| {
        let (mut first, mut second) = (0.0, 0.0);
        for value in values {
            if value > first {
                (first, second) = (value, first);
            } else if value > second {
                second = value;
            }
        }
        second > MIN_AFFINITY && first - second < CLEAR_MARGIN
    };
    let n_detections = agreement.first().map_or(0, Vec::len);
    agreement.iter().any(|of_person| is_close(&mut of_person.iter().copied()))
        || (0..n_detections).any(|d| is_close(&mut agreement.iter().map(|of_person| of_person[d])))
}

/// All detections and all people of a frame as one matching: people are the candidates of one more view.
fn matched(
    ground: &Ground,
    frame: usize,
    present: &[usize],
    agreement: &[Vec<Vec<f64>>],
) -> Vec<(usize, usize, usize)> {
    let places: Vec<Place> = agreement
        .iter()
        .enumerate()
        .flat_map(|(view, of_view)| {
            let n = of_view.first().map_or(0, Vec::len);
            (0..n).map(move |detection| Place { view, frame, detection })
        })
        .collect();
    let n_people = present.len();
    let group: Vec<usize> =
        (0..n_people).map(|_| agreement.len()).chain(places.iter().map(|place| place.view)).collect();
    let shown = |p: usize, at: &Place| agreement[at.view][p][at.detection];
    let mut affinity = DMatrix::zeros(group.len(), group.len());
    for (i, a) in places.iter().enumerate() {
        for p in 0..n_people {
            let value = if shown(p, a) < MIN_AFFINITY { 0.0 } else { shown(p, a).min(1.0) };
            affinity[(p, n_people + i)] = value;
            affinity[(n_people + i, p)] = value;
        }
        for (j, b) in places[..i].iter().enumerate().filter(|(_, b)| b.view != a.view) {
            let (Some(one), Some(other)) = (ground.seen(*a), ground.seen(*b)) else { continue };
            let geometry = geometry_affinity(one, other, ground.input.noise).unwrap_or(0.0);
            let physics = (0..n_people).map(|p| shown(p, a).min(shown(p, b))).fold(0.0, f64::max).min(1.0);
            let value = GEOMETRY_WEIGHT * geometry + PHYSICS_WEIGHT * physics;
            affinity[(n_people + i, n_people + j)] = value;
            affinity[(n_people + j, n_people + i)] = value;
        }
    }
    let mut found = Vec::new();
    for members in match_all(&affinity, &group, &MatcherConfig::default()) {
        let Some(&person) = members.first().filter(|&&k| k < n_people) else { continue };
        for at in members[1..].iter().map(|&k| &places[k - n_people]) {
            if shown(person, at) >= MIN_AFFINITY {
                found.push((person, at.view, at.detection));
            }
        }
    }
    found
}

/// The tracks with the frames' identities.
pub(super) fn retraced(tracks: &[PersonTrack], solved: &[FrameIdentities]) -> Vec<PersonTrack> {
    let claim = |person: usize, track: &PersonTrack, t: usize| solved[track.first.0 + t].claims[person].clone();
    let retrace = |(person, track): (usize, &PersonTrack)| PersonTrack {
        detections: (0..track.detections.len()).map(|t| claim(person, track, t)).collect(),
        ..track.clone()
    };
    tracks.iter().enumerate().map(retrace).collect()
}
