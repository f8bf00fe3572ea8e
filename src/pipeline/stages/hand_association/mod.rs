//! Hands that a detector gave to the wrong side, or to another person, are put back by the wrists and forearms in space.
//!
//! Every detection of a person has places for a left and a right hand. A hand fits a place by the distances of its wrist from
//! the projected wrist, and of its knuckles from where they are when the hand continues the forearm. Two hands of a view and
//! frame are exchanged where that raises their likelihood by more than exchanges are rare.

mod likelihood;

use crate::body::hand::{N_HAND_POINTS, Side, hand_keypoints};
use crate::pipeline::calibration::TrackedPeople;
use crate::session::reconstruction::{HandPlace, HandSources, StageReport};
use crate::session::{Keypoint, Session};
use likelihood::{Arm, SeenHand};

/// The session with every hand in the detection of its person and side.
pub struct AssociatedHands {
    /// Its other keypoints are as before.
    pub session: Session,
    /// From where every hand was taken.
    pub sources: HandSources,
    /// Numbers of hands whose arms are known, and of those that were moved.
    pub report: StageReport,
}

/// Twice the logarithm of the odds against an exchange: detectors exchange hands in some 5 % of the frames.
const MIN_GAIN: f64 = 6.0;

/// Finds the hands of all persons; `None` where the convention has no hands.
pub fn associated_hands(people: &TrackedPeople) -> Option<AssociatedHands> {
    let convention = people.session.convention;
    hand_keypoints(convention, Side::Left)?;
    let mut session = people.session.clone();
    let own = |n: usize| (0..n).map(|detection| Side::BOTH.map(|side| (detection, side))).collect();
    let mut sources: HandSources =
        session.views.iter().map(|view| view.frames.iter().map(|frame| own(frame.len())).collect()).collect();
    let (mut n_hands, mut n_moved) = (0, 0);
    for (view, camera) in people.cameras.iter().enumerate() {
        let Some(camera) = camera else { continue };
        let intrinsics = people.session.views[view].intrinsics;
        for (frame, sources) in sources[view].iter_mut().enumerate() {
            let places = places(people, view, frame);
            let detections = &people.session.views[view].frames[frame];
            let hand =
                |(place, _): &(HandPlace, Arm)| SeenHand::of(&detections[place.0].keypoints, convention, place.1);
            let hands: Vec<Option<SeenHand>> = places.iter().map(hand).collect();
            let misfit = |arm: &Arm, seen: &Option<SeenHand>| {
                seen.as_ref().map_or(0.0, |seen| arm.misfit(seen, camera, &intrinsics))
            };
            let misfits: Vec<Vec<f64>> =
                places.iter().map(|(_, arm)| hands.iter().map(|seen| misfit(arm, seen)).collect()).collect();
            n_hands += hands.iter().flatten().count();
            for (to, from) in exchanged(&misfits).into_iter().enumerate() {
                n_moved += usize::from(to != from && hands[from].is_some());
                let (detection, side) = places[to].0;
                sources[detection][side as usize] = places[from].0;
            }
            apply(sources, detections.iter().map(|d| d.keypoints.as_slice()).collect(), &mut session, [view, frame]);
        }
    }
    let metrics = vec![("hands", n_hands as f64), ("moved", n_moved as f64)];
    Some(AssociatedHands { session, sources, report: StageReport::new("hand_association", 0, "done", metrics) })
}

/// The places of all persons' detections of a view and frame whose arm is known, with the arm that each continues. Any hand would fit
/// another place as well as the next.
fn places(people: &TrackedPeople, view: usize, frame: usize) -> Vec<(HandPlace, Arm)> {
    let mut places = Vec::new();
    for (track, points) in people.tracks.iter().zip(people.points) {
        let of_frame = |first: usize| frame.checked_sub(first);
        let detection = of_frame(track.first.0).and_then(|t| *track.detections.get(t)?.get(view)?);
        let Some(detection) = detection else { continue };
        let row = of_frame(points.first.0).and_then(|t| points.points.get(t));
        let place = |side: Side| Some(((detection, side), Arm::of(row?, people.session.convention, side)?));
        places.extend(Side::BOTH.into_iter().filter_map(place));
    }
    places
}

/// For every place the hand that it takes: pairs are exchanged while that lowers the sum of misfits enough.
/// `misfits[place][hand]`.
fn exchanged(misfits: &[Vec<f64>]) -> Vec<usize> {
    let n = misfits.len();
    let mut order: Vec<usize> = (0..n).collect();
    // Each exchange lowers the sum, so that this ends; more than one of a hand is not expected.
    for _ in 0..n {
        let gain = |a: usize, b: usize| {
            let now = misfits[a][order[a]] + misfits[b][order[b]];
            now - misfits[a][order[b]] - misfits[b][order[a]]
        };
        let pairs = (0..n).flat_map(|a| (a + 1..n).map(move |b| (a, b)));
        let best = pairs.map(|(a, b)| (gain(a, b), a, b)).max_by(|x, y| x.0.total_cmp(&y.0));
        match best {
            Some((gain, a, b)) if gain > MIN_GAIN => order.swap(a, b),
            _ => break,
        }
    }
    order
}

/// Copies the hands of a view and frame to their places.
fn apply(sources: &[[HandPlace; 2]], before: Vec<&[Keypoint]>, session: &mut Session, [view, frame]: [usize; 2]) {
    let convention = session.convention;
    for (detection, taken) in sources.iter().enumerate() {
        for (side, (from, from_side)) in Side::BOTH.into_iter().zip(taken) {
            let is_moved = (*from, *from_side) != (detection, side);
            let ranges = hand_keypoints(convention, side).zip(hand_keypoints(convention, *from_side));
            let Some((to, source)) = ranges.filter(|_| is_moved) else { continue };
            debug_assert_eq!(source.len(), N_HAND_POINTS);
            session.views[view].frames[frame][detection].keypoints[to].copy_from_slice(&before[*from][source]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exchanges_what_fits_better_and_keeps_what_is_alike() {
        let swapped = vec![vec![50.0, 1.0, 60.0], vec![2.0, 60.0, 50.0], vec![60.0, 60.0, 3.0]];
        assert_eq!(exchanged(&swapped), [1, 0, 2]);
        let alike = vec![vec![5.0, 3.0], vec![3.0, 5.0]];
        assert_eq!(exchanged(&alike), [0, 1]);
    }
}
