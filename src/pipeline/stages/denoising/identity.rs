//! Persons of all detections of a frame, judged against the persons' smooth trajectories.

use super::context::{Context, DetectionIndex};
use super::frame_view::FrameView;
use crate::matching::assignment::assign;
use crate::matching::consistency::{Agreement, GEOMETRY_WEIGHT, PHYSICS_WEIGHT, geometry_affinity, physics_affinity};
use crate::matching::convex::{MatcherConfig, match_all};
use nalgebra::DMatrix;

/// Smallest agreement between a detection and its person; other persons reach 0.1 to 0.3.
const MIN_AFFINITY: f64 = 0.3;

/// Two persons (or two detections) whose agreement differs by less than this are ambiguous.
const CLEAR_MARGIN: f64 = 0.2;

/// Bonus on the affinity of the tracker's own assignment: it used the previous frame, in 2D and in colour.
const HELD_BONUS: f64 = 0.03;

/// Assignment of one frame.
pub(super) struct FrameIdentities {
    /// `assignments[person][view]`: index of the detection, by person present.
    pub assignments: Vec<Vec<Option<usize>>>,
    /// Whether the frame was ambiguous and solved as one matching.
    pub is_ambiguous: bool,
}

/// Solves one frame.
pub(super) fn identities(context: &Context, frame: &FrameView) -> FrameIdentities {
    let agreement: Vec<Vec<Vec<Agreement>>> = (0..frame.views.len()).map(|v| agreements(context, frame, v)).collect();
    let is_ambiguous = agreement.iter().any(|of_view| is_ambiguous_view(of_view));
    let mut assignments = vec![vec![None; frame.views.len()]; frame.present.len()];
    if is_ambiguous {
        for (person, view, detection) in matched(context, frame, &agreement) {
            assignments[person][view] = Some(detection);
        }
    } else {
        for (view, of_view) in agreement.iter().enumerate() {
            let cost = |p: usize, d: usize| 1.0 - of_view[p][d].affinity;
            let n_detections = frame.views[view].seen.len();
            for (p, d) in assign(of_view.len(), n_detections, 1.0 - MIN_AFFINITY, cost).into_iter().enumerate() {
                assignments[p][view] = d;
            }
        }
    }
    for (view, of_view) in agreement.iter().enumerate() {
        prefer_whole_detections(of_view, view, &mut assignments);
    }
    FrameIdentities { assignments, is_ambiguous }
}

/// Agreement `[person][detection]` in a single view, under the best flip.
fn agreements(context: &Context, frame: &FrameView, view: usize) -> Vec<Vec<Agreement>> {
    let of_view = &frame.views[view];
    let of_person = |(&person, expected): (&usize, &Vec<_>)| {
        let track = &context.input.tracks[person];
        let held = frame.frame.checked_sub(track.first.0).and_then(|t| track.detections.get(t)?[view]);
        let of_detection = |(detection, seen)| {
            let flips = context.flips.iter();
            let flips = flips.filter_map(|flip| physics_affinity(seen, expected, context.input.noise, &flip.order));
            let best = flips.reduce(|best, flip| if flip.affinity > best.affinity { flip } else { best })?;
            let bonus = if held == Some(detection) { HELD_BONUS } else { 0.0 };
            Some(Agreement { affinity: best.affinity + bonus, ..best })
        };
        of_view.seen.iter().enumerate().map(|seen| of_detection(seen).unwrap_or_default()).collect()
    };
    frame.present.iter().zip(&of_view.expected).map(of_person).collect()
}

/// A person detected twice, as a part and as the rest: a small part agrees better because it has fewer keypoints. Replaces
/// the part by the detection with more support, the number of keypoints times their agreement above that of others.
fn prefer_whole_detections(of_view: &[Vec<Agreement>], view: usize, assignments: &mut [Vec<Option<usize>>]) {
    for (person, of_person) in of_view.iter().enumerate() {
        let Some(held) = assignments[person][view] else { continue };
        let support = |d: usize| (of_person[d].affinity - MIN_AFFINITY) * of_person[d].n_shared as f64;
        let is_free = |d: &usize| assignments.iter().all(|of_person| of_person[view] != Some(*d));
        let better = (0..of_person.len()).filter(is_free).filter(|d| support(*d) > support(held));
        if let Some(whole) = better.max_by(|a, b| support(*a).total_cmp(&support(*b))) {
            assignments[person][view] = Some(whole);
        }
    }
}

/// Whether some person has two similar candidates in a view, or some detection two similar persons.
fn is_ambiguous_view(agreement: &[Vec<Agreement>]) -> bool {
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
    agreement.iter().any(|of_person| is_close(&mut of_person.iter().map(|a| a.affinity)))
        || (0..n_detections).any(|d| is_close(&mut agreement.iter().map(|of_person| of_person[d].affinity)))
}

/// Solves the detections and persons of a frame as matchings, one per group of confusable people, with the persons as one more view.
/// Returns person, view and detection of each assignment.
fn matched(context: &Context, frame: &FrameView, agreement: &[Vec<Vec<Agreement>>]) -> Vec<(usize, usize, usize)> {
    let of_view = |(view, seen): (usize, usize)| {
        (0..seen).map(move |detection| DetectionIndex { view, frame: frame.frame, detection })
    };
    let places: Vec<DetectionIndex> = frame.views.iter().map(|v| v.seen.len()).enumerate().flat_map(of_view).collect();
    let shown = |p: usize, at: &DetectionIndex| agreement[at.view][p][at.detection].affinity;
    let candidates = |at: &DetectionIndex| (0..frame.present.len()).filter(|&p| shown(p, at) >= MIN_AFFINITY).collect();
    let candidates: Vec<Vec<usize>> = places.iter().map(candidates).collect();
    let mut found = Vec::new();
    for people in confusable(frame.present.len(), &candidates) {
        let of_these = |(place, who): (&DetectionIndex, &Vec<usize>)| people.contains(who.first()?).then_some(*place);
        let places: Vec<DetectionIndex> = places.iter().zip(&candidates).filter_map(of_these).collect();
        let (affinity, group) = affinities(context, frame, &places, &people, &shown);
        for members in match_all(&affinity, &group, &MatcherConfig::default()) {
            let Some(&person) = members.first().and_then(|&k| people.get(k)) else { continue };
            for at in members[1..].iter().map(|&k| &places[k - people.len()]) {
                if shown(person, at) >= MIN_AFFINITY {
                    found.push((person, at.view, at.detection));
                }
            }
        }
    }
    found
}

/// Groups of people who share candidates, directly or by way of others. `candidates`: by detection, the people it may show.
fn confusable(n_people: usize, candidates: &[Vec<usize>]) -> Vec<Vec<usize>> {
    let mut group_of: Vec<usize> = (0..n_people).collect();
    for pair in candidates.iter().flat_map(|people| people.windows(2)) {
        let (a, b) = (group_of[pair[0]], group_of[pair[1]]);
        group_of.iter_mut().filter(|group| **group == b).for_each(|group| *group = a);
    }
    let members = |group: usize| (0..n_people).filter(|&p| group_of[p] == group).collect::<Vec<_>>();
    (0..n_people).map(members).filter(|people| !people.is_empty()).collect()
}

/// Affinities of some people, then of detections, and the group of each: its view, for people one more.
fn affinities(
    context: &Context,
    frame: &FrameView,
    places: &[DetectionIndex],
    people: &[usize],
    shown: &impl Fn(usize, &DetectionIndex) -> f64,
) -> (DMatrix<f64>, Vec<usize>) {
    let n_people = people.len();
    let group: Vec<usize> =
        people.iter().map(|_| frame.views.len()).chain(places.iter().map(|place| place.view)).collect();
    let mut affinity = DMatrix::zeros(group.len(), group.len());
    for (i, a) in places.iter().enumerate() {
        for (k, &p) in people.iter().enumerate() {
            let value = if shown(p, a) < MIN_AFFINITY { 0.0 } else { shown(p, a).min(1.0) };
            affinity[(k, n_people + i)] = value;
            affinity[(n_people + i, k)] = value;
        }
        for (j, b) in places[..i].iter().enumerate().filter(|(_, b)| b.view != a.view) {
            let geometry = geometry_affinity(frame.seen(*a), frame.seen(*b), context.input.noise).unwrap_or(0.0);
            let physics = people.iter().map(|&p| shown(p, a).min(shown(p, b))).fold(0.0, f64::max).min(1.0);
            let value = GEOMETRY_WEIGHT * geometry + PHYSICS_WEIGHT * physics;
            affinity[(n_people + i, n_people + j)] = value;
            affinity[(n_people + j, n_people + i)] = value;
        }
    }
    (affinity, group)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A body with one wrong leg (11 of 19 keypoints agree), and the leg as a separate detection.
    #[test]
    fn a_separate_leg_does_not_replace_the_whole_body() {
        let body = Agreement { affinity: 0.55, n_shared: 19 };
        let leg = Agreement { affinity: 0.9, n_shared: 5 };
        let stranger = Agreement { affinity: 0.31, n_shared: 25 };
        let assigned = |of_view: &[Vec<Agreement>], mut assignments: Vec<Vec<Option<usize>>>| {
            prefer_whole_detections(of_view, 0, &mut assignments);
            assignments.into_iter().map(|of_person| of_person[0]).collect::<Vec<_>>()
        };
        assert_eq!(assigned(&[vec![body, leg, stranger]], vec![vec![Some(1)]]), [Some(0)]);
        assert_eq!(assigned(&[vec![stranger, leg]], vec![vec![Some(1)]]), [Some(1)]);
        let none = Agreement::default();
        let both = [vec![body, leg], vec![body, none]];
        assert_eq!(
            assigned(&both, vec![vec![Some(1)], vec![Some(0)]]),
            [Some(1), Some(0)],
            "it belongs to another person"
        );
        assert_eq!(assigned(&[vec![body, leg]], vec![vec![None]]), [None]);
    }

    /// Of 30 people all 180 candidates were matched at once, which took nearly half of the solve.
    #[test]
    fn people_without_a_common_candidate_are_matched_apart() {
        let candidates = [vec![0, 3], vec![], vec![1], vec![3, 4], vec![2]];
        assert_eq!(confusable(5, &candidates), [vec![0, 3, 4], vec![1], vec![2]]);
        assert_eq!(confusable(3, &[vec![1, 2], vec![0, 1]]), [vec![0, 1, 2]]);
    }
}
