//! One person followed as two, each with some of the views: a track that had strayed for a moment left views free, and a
//! newcomer took them.

use super::Scene;
use super::birth::SAME_PERSON_M;
use super::person::{TrackedPerson, distance};
use crate::optim::robust::median;

/// Unites fragments that are in one place at the same time and of which no view sees both; the nearest first.
pub(super) fn united(scene: &Scene, mut fragments: Vec<TrackedPerson>) -> Vec<TrackedPerson> {
    while let Some((_, i, j)) = nearest_double(&fragments) {
        let other = fragments.swap_remove(j);
        fragments[i].unite(scene, other);
    }
    fragments
}

/// The two fragments that lie nearest to each other of all that are one person's, and how near.
fn nearest_double(fragments: &[TrackedPerson]) -> Option<(f64, usize, usize)> {
    let pairs = (0..fragments.len()).flat_map(|j| (0..j).map(move |i| (i, j)));
    let doubles = pairs.filter_map(|(i, j)| Some((distance_of_double(&fragments[i], &fragments[j])?, i, j)));
    doubles.min_by(|a, b| a.0.total_cmp(&b.0))
}

/// Median distance of two fragments over the frames that they share; `None` where they are two people's.
fn distance_of_double(one: &TrackedPerson, other: &TrackedPerson) -> Option<f64> {
    if one.last_seen() < other.first() || other.last_seen() < one.first() {
        return None;
    }
    let mut distances = Vec::new();
    for (t, (frame, claim)) in one.claims.iter().enumerate() {
        let Ok(u) = other.claims.binary_search_by_key(frame, |(frame, _)| *frame) else { continue };
        let theirs = &other.claims[u].1;
        if claim.iter().zip(theirs).any(|(a, b)| a.is_some() && b.is_some()) {
            return None;
        }
        // Only who is seen can be seen to be the same.
        if [claim, theirs].iter().any(|claim| claim.iter().flatten().next().is_none()) {
            continue;
        }
        distances.extend(distance(&one.skeletons[t], &other.skeletons[u]));
    }
    median(&mut distances).filter(|d| *d < SAME_PERSON_M)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    const SCENE: Scene = Scene { views: &[], cameras: &[], bones: &[], fps: 30.0, n_frames: 9 };

    /// A person about `x` in some frames, seen by some of four views.
    fn person(frames: std::ops::Range<usize>, x: f64, views: &[usize]) -> TrackedPerson {
        let skeleton = || (0..6).map(|k| Some(Vector3::new(x, 0.2 * f64::from(k), 0.0))).collect();
        let claim = || (0..4).map(|v| views.contains(&v).then_some(0)).collect();
        let mut frames = frames.map(|frame| TrackedPerson::new(frame, claim(), skeleton()));
        let mut whole = frames.next().unwrap();
        frames.for_each(|later| whole.continue_as(later));
        whole
    }

    /// Seed 204 of the hard captures: one of four people had two tracks for 22 frames, and two names for the rest.
    #[test]
    fn one_person_seen_by_half_of_the_views_each_is_not_two() {
        let united = |other: TrackedPerson| united(&SCENE, vec![person(0..6, 0.0, &[0, 1]), other]);
        let whole = united(person(4..9, 0.05, &[2, 3]));
        assert_eq!(whole.len(), 1);
        let frames: Vec<usize> = whole[0].claims.iter().map(|(frame, _)| *frame).collect();
        assert_eq!(frames, (0..9).collect::<Vec<_>>());
        let n_views: Vec<usize> = whole[0].claims.iter().map(|(_, claim)| claim.iter().flatten().count()).collect();
        assert_eq!(n_views, [2, 2, 2, 2, 4, 4, 2, 2, 2]);
        assert_eq!(united(person(2..4, 0.05, &[2, 3])).len(), 1, "within");
        assert_eq!(united(person(4..9, 0.05, &[1, 2])).len(), 2, "one view sees both");
        assert_eq!(united(person(4..9, 0.4, &[2, 3])).len(), 2, "elsewhere");
        assert_eq!(united(person(6..9, 0.0, &[2, 3])).len(), 2, "not at once");
    }
}
