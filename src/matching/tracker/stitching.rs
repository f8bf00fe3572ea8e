//! Stitching of fragments of one person across the time in which no view saw the person.

use super::duplicate_merging;
use super::person::TrackedPerson;
use super::reidentification::{Appearance, NumbersBefore, may_be_anywhere, position_evidence, scene_spread};
use super::scene::TrackerScene;
use super::skeleton::distance;
use crate::matching::assignment::assign_by_table;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Out of sight for longer than this, s, a person is not followed: the next person nearby may be another one.
const MAX_GAP_SECS: f64 = 0.2;

/// [`MAX_GAP_SECS`] in frames.
pub(super) fn max_gap(scene: &TrackerScene) -> usize {
    (MAX_GAP_SECS * scene.fps).max(1.0) as usize
}

/// Joins fragments end to start: of all ways to do so, the one with the greatest evidence.
///
/// A path cover of least cost (Zhang, Li and Nevatia 2008) without further terms is an assignment of ends to starts.
/// Without evidence a new person is as likely as a returning one.
pub(super) fn stitch(scene: &TrackerScene, followed: Vec<TrackedPerson>) -> Vec<TrackedPerson> {
    let mut people = duplicate_merging::merged(scene, followed.into_iter().flat_map(|p| split(scene, p)).collect());
    people.sort_by_key(|p| (p.first(), p.last_seen()));
    let next = assign_by_table(&costs(scene, &people), 0.0);
    let starts: Vec<usize> = (0..people.len()).filter(|j| !next.contains(&Some(*j))).collect();
    let mut fragments: Vec<Option<TrackedPerson>> = people.into_iter().map(Some).collect();
    let chain = |start: usize| {
        let mut whole = fragments[start].take()?;
        let mut end = start;
        while let Some(later) = next[end] {
            whole.append(fragments[later].take()?);
            end = later;
        }
        Some(whole)
    };
    starts.into_iter().filter_map(chain).collect()
}

/// The pieces between gaps longer than [`MAX_GAP_SECS`].
fn split(scene: &TrackerScene, followed: TrackedPerson) -> Vec<TrackedPerson> {
    let max_gap = max_gap(scene);
    let frames: Vec<usize> = followed.assignments.iter().map(|(frame, _)| *frame).collect();
    let gaps: Vec<usize> = (1..frames.len()).filter(|&k| frames[k] - frames[k - 1] > max_gap).collect();
    if gaps.is_empty() {
        return vec![followed];
    }
    let mut start = 0;
    gaps.into_iter()
        .chain([frames.len()])
        .map(|end| followed.piece(scene, std::mem::replace(&mut start, end)..end))
        .collect()
}

/// Negative log evidence of each pair of end and start, nats; `f64::MAX` where the order in time forbids the pair.
fn costs(scene: &TrackerScene, people: &[TrackedPerson]) -> Vec<Vec<f64>> {
    let appearances: Vec<Appearance> = people.par_iter().map(|p| Appearance::of(scene, p)).collect();
    let spread = scene_spread(scene);
    let of_end = |i: usize| {
        let mut before = vec![BTreeMap::new(); scene.views.len()];
        let known = people.iter().zip(&appearances).filter(|(p, _)| p.first() <= people[i].last_seen());
        known.for_each(|(_, appearance)| appearance.count_track_ids(&mut before));
        let before: Vec<NumbersBefore> = before.into_iter().map(NumbersBefore::of).collect();
        let of_start = |j: usize| {
            let Some(position) = position(scene, &people[i], &people[j], spread) else { return f64::MAX };
            let (one, other) = (&appearances[i], &appearances[j]);
            -(position + one.build_evidence(other) + one.track_id_evidence(other, &before))
        };
        (0..people.len()).map(of_start).collect()
    };
    (0..people.len()).into_par_iter().map(of_end).collect()
}

/// Evidence of positions that `later` continues `earlier`, nats; `None` where both are seen at one time.
fn position(scene: &TrackerScene, earlier: &TrackedPerson, later: &TrackedPerson, spread: f64) -> Option<f64> {
    if later.first() <= earlier.last_seen() {
        return None;
    }
    let seconds = (later.first() - earlier.last_seen()) as f64 / scene.fps;
    // Most pairs of a long take are so far apart in time that nothing needs to be predicted.
    if may_be_anywhere(seconds, earlier.speed(), spread) {
        return Some(0.0);
    }
    let predicted = earlier.predict(later.first(), scene.fps);
    Some(
        distance(&predicted, &later.skeletons[0])
            .map_or(0.0, |d| position_evidence(d, seconds, earlier.speed(), spread)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::tracker::scene::EMPTY_SCENE;
    use nalgebra::Vector3;

    /// A person of six points about `x`, first seen at `frame`.
    fn person(frame: usize, x: f64) -> TrackedPerson {
        let skeleton = (0..6).map(|k| Some(Vector3::new(x, 0.2 * f64::from(k), 0.0))).collect();
        TrackedPerson::new(frame, Vec::new(), skeleton)
    }

    #[test]
    fn a_person_faster_than_predicted_is_not_two() {
        let n_stitched = |later: TrackedPerson| stitch(&EMPTY_SCENE, vec![person(7, 0.0), later]).len();
        assert_eq!(n_stitched(person(10, -0.4)), 1, "near");
        assert_eq!(n_stitched(person(10, 2.5)), 2, "too far");
        assert_eq!(n_stitched(person(7, 0.05)), 2, "both in sight at once");
    }

    #[test]
    fn tracks_are_split_at_long_gaps() {
        let mut followed = person(0, 0.0);
        followed.append(person(3, 0.1));
        followed.append(person(18, 0.2));
        let pieces: Vec<[usize; 2]> =
            split(&EMPTY_SCENE, followed).iter().map(|p| [p.first(), p.last_seen()]).collect();
        assert_eq!(pieces, [[0, 3], [18, 18]]);
    }

    #[test]
    fn stitching_maximises_the_evidence_of_all_pairs() {
        // Nearest first would take 0.0 -> -0.2 and leave -0.5 -> 0.3.
        let fragments = vec![person(0, 0.0), person(0, -0.5), person(9, 0.3), person(9, -0.2)];
        let stitched = stitch(&EMPTY_SCENE, fragments);
        let ends = |p: &TrackedPerson| [0, p.skeletons.len() - 1].map(|t| p.skeletons[t][0].map_or(f64::NAN, |x| x.x));
        let mut ends: Vec<[f64; 2]> = stitched.iter().map(ends).collect();
        ends.sort_by(|a, b| a[0].total_cmp(&b[0]));
        assert_eq!(ends, [[-0.5, -0.2], [0.0, 0.3]]);
    }
}
