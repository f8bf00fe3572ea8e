//! Merging of duplicates: one person followed as two, each with some of the views. It happens where a track strays for
//! a moment and leaves views unassigned, from which a second person is started.

use super::person::TrackedPerson;
use super::scene::TrackerScene;
use super::skeleton::{SAME_PERSON_M, distance};
use crate::optim::robust::median;
use rayon::prelude::*;

/// Merges fragments that are in one place at the same time and share no view, the nearest first.
pub(super) fn merged(scene: &TrackerScene, mut fragments: Vec<TrackedPerson>) -> Vec<TrackedPerson> {
    let of_row = |j: usize| (0..j).map(|i| duplicate_distance(&fragments[i], &fragments[j])).collect();
    let mut distances: Vec<Vec<Option<f64>>> = (0..fragments.len()).into_par_iter().map(of_row).collect();
    while let Some((i, j)) = nearest_duplicates(&distances) {
        let other = fragments.swap_remove(j);
        fragments[i].merge(scene, other);
        distances.pop();
        // The last fragment has taken the place of the merged one.
        for changed in [i, j].into_iter().filter(|changed| *changed < fragments.len()) {
            for k in (0..fragments.len()).filter(|k| *k != changed) {
                let (first, second) = (k.min(changed), k.max(changed));
                distances[second][first] = duplicate_distance(&fragments[first], &fragments[second]);
            }
        }
    }
    fragments
}

/// The nearest two fragments of one person. `distances[j][i]`: for `i < j`, `None` of two persons.
fn nearest_duplicates(distances: &[Vec<Option<f64>>]) -> Option<(usize, usize)> {
    let pairs = distances.iter().enumerate().flat_map(|(j, row)| row.iter().enumerate().map(move |(i, d)| (i, j, *d)));
    let duplicates = pairs.filter_map(|(i, j, distance)| Some((distance?, i, j)));
    duplicates.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, i, j)| (i, j))
}

/// Median distance of two fragments over the frames that they share; `None` where they show two persons.
fn duplicate_distance(one: &TrackedPerson, other: &TrackedPerson) -> Option<f64> {
    if one.last_seen() < other.first() || other.last_seen() < one.first() {
        return None;
    }
    let mut distances = Vec::new();
    for (t, (frame, assignment)) in one.assignments.iter().enumerate() {
        let Ok(u) = other.assignments.binary_search_by_key(frame, |(frame, _)| *frame) else { continue };
        let others = &other.assignments[u].1;
        if assignment.iter().zip(others).any(|(a, b)| a.is_some() && b.is_some()) {
            return None;
        }
        // Frames in which one of the fragments has no detection hold predictions only.
        if [assignment, others].iter().any(|assignment| assignment.iter().flatten().next().is_none()) {
            continue;
        }
        distances.extend(distance(&one.skeletons[t], &other.skeletons[u]));
    }
    median(&mut distances).filter(|d| *d < SAME_PERSON_M)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::tracker::scene::{EMPTY_SCENE, Shown};
    use nalgebra::Vector3;

    /// A person about `x` in some frames, seen by some of four views.
    fn person(frames: std::ops::Range<usize>, x: f64, views: &[usize]) -> TrackedPerson {
        let skeleton = || (0..6).map(|k| Some(Vector3::new(x, 0.2 * f64::from(k), 0.0))).collect();
        let assignment = || (0..4).map(|v| views.contains(&v).then(|| Shown::as_detected(0))).collect();
        let mut frames = frames.map(|frame| TrackedPerson::new(frame, assignment(), skeleton()));
        let mut whole = frames.next().unwrap();
        frames.for_each(|later| whole.append(later));
        whole
    }

    /// Seed 204 of the hard captures: one of four people had two tracks for 22 frames, and two identities for the rest.
    #[test]
    fn merges_one_person_seen_by_two_halves_of_the_views() {
        let merged = |other: TrackedPerson| merged(&EMPTY_SCENE, vec![person(0..6, 0.0, &[0, 1]), other]);
        let whole = merged(person(4..9, 0.05, &[2, 3]));
        assert_eq!(whole.len(), 1);
        let frames: Vec<usize> = whole[0].assignments.iter().map(|(frame, _)| *frame).collect();
        assert_eq!(frames, (0..9).collect::<Vec<_>>());
        let n_views: Vec<usize> = whole[0].assignments.iter().map(|(_, a)| a.iter().flatten().count()).collect();
        assert_eq!(n_views, [2, 2, 2, 2, 4, 4, 2, 2, 2]);
        assert_eq!(merged(person(2..4, 0.05, &[2, 3])).len(), 1, "within");
        assert_eq!(merged(person(4..9, 0.05, &[1, 2])).len(), 2, "a view sees both");
        assert_eq!(merged(person(4..9, 0.4, &[2, 3])).len(), 2, "elsewhere");
        assert_eq!(merged(person(6..9, 0.0, &[2, 3])).len(), 2, "at another time");
    }
}
