//! Fragments of one person, joined: across the time in which nobody saw them, and where they are one person seen twice.

use super::likeness::{Likeness, place_evidence, room};
use super::person::{TrackedPerson, distance};
use super::{Scene, doubles};
use crate::matching::assignment::assign;
use std::collections::BTreeMap;

/// Joins fragments end to start: of all ways to do so, the one with the most evidence.
///
/// A path cover of least cost (Zhang, Li and Nevatia 2008) without further terms is an assignment of ends to starts.
/// Where nothing speaks for anything, a newcomer is as likely as a return.
pub(super) fn join_fragments(scene: &Scene, followed: Vec<TrackedPerson>) -> Vec<TrackedPerson> {
    let mut people = doubles::united(scene, followed.iter().flat_map(|p| split(scene, p)).collect());
    people.sort_by_key(|p| (p.first(), p.last_seen()));
    let costs = costs(scene, &people);
    let next = assign(people.len(), people.len(), 0.0, |i, j| costs[i][j]);
    let starts: Vec<usize> = (0..people.len()).filter(|j| !next.contains(&Some(*j))).collect();
    let mut fragments: Vec<Option<TrackedPerson>> = people.into_iter().map(Some).collect();
    let chain = |start: usize| {
        let mut whole = fragments[start].take()?;
        let mut end = start;
        while let Some(later) = next[end] {
            whole.continue_as(fragments[later].take()?);
            end = later;
        }
        Some(whole)
    };
    starts.into_iter().filter_map(chain).collect()
}

/// Out of sight for longer than this, s, nobody is followed: whoever turns up near by may be another.
const MAX_HOLE: f64 = 0.2;

/// The pieces of uninterrupted sight.
fn split(scene: &Scene, followed: &TrackedPerson) -> Vec<TrackedPerson> {
    let max_hole = (MAX_HOLE * scene.fps).max(1.0) as usize;
    let frames: Vec<usize> = followed.claims.iter().map(|(frame, _)| *frame).collect();
    let ends = (1..frames.len()).filter(|&k| frames[k] - frames[k - 1] > max_hole).chain([frames.len()]);
    let mut start = 0;
    ends.map(|end| followed.piece(scene, std::mem::replace(&mut start, end)..end)).collect()
}

/// Evidence against each pair of end and start, nats; large where the order in time forbids it.
fn costs(scene: &Scene, people: &[TrackedPerson]) -> Vec<Vec<f64>> {
    let likeness: Vec<Likeness> = people.iter().map(|p| Likeness::of(scene, p)).collect();
    let room = room(scene);
    let of_end = |i: usize| {
        let mut before = vec![BTreeMap::new(); scene.views.len()];
        let known = people.iter().zip(&likeness).filter(|(p, _)| p.first() <= people[i].last_seen());
        known.for_each(|(_, likeness)| likeness.count_numbers(&mut before));
        let of_start = |j: usize| {
            let Some(place) = place(scene, &people[i], &people[j], room) else { return f64::MAX };
            let (one, other) = (&likeness[i], &likeness[j]);
            -(place + one.build_evidence(other) + one.number_evidence(other, &before))
        };
        (0..people.len()).map(of_start).collect()
    };
    (0..people.len()).map(of_end).collect()
}

/// Evidence of where `earlier` should be for `later` being the same; `None` where they are seen at once.
fn place(scene: &Scene, earlier: &TrackedPerson, later: &TrackedPerson, room: f64) -> Option<f64> {
    if later.first() <= earlier.last_seen() {
        return None;
    }
    let seconds = (later.first() - earlier.last_seen()) as f64 / scene.fps;
    let predicted = earlier.predict(later.first(), scene.fps);
    Some(distance(&predicted, &later.skeletons[0]).map_or(0.0, |d| place_evidence(d, seconds, room)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    /// A person of six points about `x`, first seen at `frame`.
    fn person(frame: usize, x: f64) -> TrackedPerson {
        let skeleton = (0..6).map(|k| Some(Vector3::new(x, 0.2 * f64::from(k), 0.0))).collect();
        TrackedPerson::new(frame, Vec::new(), skeleton)
    }

    const SCENE: Scene = Scene { views: &[], cameras: &[], bones: &[], fps: 30.0, n_frames: 3 };

    #[test]
    fn somebody_who_moved_faster_than_predicted_is_not_two_people() {
        let joined = |later: TrackedPerson| join_fragments(&SCENE, vec![person(7, 0.0), later]).len();
        assert_eq!(joined(person(10, -0.4)), 1, "near");
        assert_eq!(joined(person(10, 2.5)), 2, "too far");
        assert_eq!(joined(person(7, 0.05)), 2, "who is in sight does not come back");
    }

    #[test]
    fn somebody_who_comes_where_another_went_is_judged_by_all_that_was_seen_of_both() {
        let mut followed = person(0, 0.0);
        followed.continue_as(person(3, 0.1));
        followed.continue_as(person(18, 0.2));
        let pieces: Vec<[usize; 2]> = split(&SCENE, &followed).iter().map(|p| [p.first(), p.last_seen()]).collect();
        assert_eq!(pieces, [[0, 3], [18, 18]]);
    }

    #[test]
    fn fragments_are_joined_by_the_most_evidence_of_all_and_not_by_the_best_pair_first() {
        // Nearest first would take 0.0 -> -0.2 and leave -0.5 -> 0.3.
        let fragments = vec![person(0, 0.0), person(0, -0.5), person(9, 0.3), person(9, -0.2)];
        let joined = join_fragments(&SCENE, fragments);
        let ends = |p: &TrackedPerson| [0, p.skeletons.len() - 1].map(|t| p.skeletons[t][0].map_or(f64::NAN, |x| x.x));
        let mut ends: Vec<[f64; 2]> = joined.iter().map(ends).collect();
        ends.sort_by(|a, b| a[0].total_cmp(&b[0]));
        assert_eq!(ends, [[-0.5, -0.2], [0.0, 0.3]]);
    }
}
