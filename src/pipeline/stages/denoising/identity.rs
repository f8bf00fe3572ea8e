//! Who every detection of a frame shows, judged against everybody's whole path.

use super::scene::Scene;
use super::{Ground, Place};
use crate::matching::assignment::assign;
use crate::matching::consistency::{Agreement, GEOMETRY_WEIGHT, PHYSICS_WEIGHT, geometry_affinity, physics_affinity};
use crate::matching::convex::{MatcherConfig, match_all};
use nalgebra::DMatrix;

/// A detection that agrees less than this with a person does not show them: strangers reach 0.1 to 0.3.
const MIN_AFFINITY: f64 = 0.3;

/// Two people (or two detections) closer in agreement than this leave a choice.
const CLEAR_MARGIN: f64 = 0.2;

/// What the tracker's own word is worth against an affinity: it has seen the frame before, in 2D and in colour.
const HELD_BONUS: f64 = 0.03;

/// Who is who in one frame.
pub(super) struct FrameIdentities {
    /// `claims[person][view]`: the detection that shows them, by person present.
    pub claims: Vec<Vec<Option<usize>>>,
    /// Whether the frame left a choice and was solved as a whole.
    pub is_ambiguous: bool,
}

/// Solves one frame.
pub(super) fn identities(ground: &Ground, scene: &Scene) -> FrameIdentities {
    let agreement: Vec<Vec<Vec<Agreement>>> = (0..scene.views.len()).map(|v| agreements(ground, scene, v)).collect();
    let is_ambiguous = agreement.iter().any(|of_view| leaves_a_choice(of_view));
    let mut claims = vec![vec![None; scene.views.len()]; scene.present.len()];
    if is_ambiguous {
        for (person, view, detection) in matched(ground, scene, &agreement) {
            claims[person][view] = Some(detection);
        }
    } else {
        for (view, of_view) in agreement.iter().enumerate() {
            let cost = |p: usize, d: usize| 1.0 - of_view[p][d].affinity;
            let n_detections = scene.views[view].seen.len();
            for (p, d) in assign(of_view.len(), n_detections, 1.0 - MIN_AFFINITY, cost).into_iter().enumerate() {
                claims[p][view] = d;
            }
        }
    }
    for (view, of_view) in agreement.iter().enumerate() {
        prefer_the_whole(of_view, view, &mut claims);
    }
    FrameIdentities { claims, is_ambiguous }
}

/// `[person][detection]` in one view, under the better of the ways round.
fn agreements(ground: &Ground, scene: &Scene, view: usize) -> Vec<Vec<Agreement>> {
    let of_view = &scene.views[view];
    let of_person = |(&person, expected): (&usize, &Vec<_>)| {
        let track = &ground.input.tracks[person];
        let held = scene.frame.checked_sub(track.first.0).and_then(|t| track.detections.get(t)?[view]);
        let of_detection = |(detection, seen)| {
            let ways = ground.flips.iter();
            let ways = ways.filter_map(|flip| physics_affinity(seen, expected, ground.input.noise, &flip.order));
            let best = ways.reduce(|best, way| if way.affinity > best.affinity { way } else { best })?;
            let bonus = if held == Some(detection) { HELD_BONUS } else { 0.0 };
            Some(Agreement { affinity: best.affinity + bonus, ..best })
        };
        of_view.seen.iter().enumerate().map(|seen| of_detection(seen).unwrap_or_default()).collect()
    };
    scene.present.iter().zip(&of_view.expected).map(of_person).collect()
}

/// Where a detector found a person twice, a part and the rest, the part agrees better the less it says. Whoever holds the
/// part gets the one that more speaks for: the keypoints that agree beyond what a stranger's would.
fn prefer_the_whole(of_view: &[Vec<Agreement>], view: usize, claims: &mut [Vec<Option<usize>>]) {
    for (person, of_person) in of_view.iter().enumerate() {
        let Some(held) = claims[person][view] else { continue };
        let evidence = |d: usize| (of_person[d].affinity - MIN_AFFINITY) * of_person[d].n_shared as f64;
        let is_free = |d: &usize| claims.iter().all(|of_person| of_person[view] != Some(*d));
        let better = (0..of_person.len()).filter(is_free).filter(|d| evidence(*d) > evidence(held));
        if let Some(whole) = better.max_by(|a, b| evidence(*a).total_cmp(&evidence(*b))) {
            claims[person][view] = Some(whole);
        }
    }
}

/// Whether some person has two near candidates in a view, or some detection two near people.
fn leaves_a_choice(agreement: &[Vec<Agreement>]) -> bool {
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

/// All detections and all people of a frame as one matching: people are the candidates of one more view. Person, view and
/// detection of each claim.
fn matched(ground: &Ground, scene: &Scene, agreement: &[Vec<Vec<Agreement>>]) -> Vec<(usize, usize, usize)> {
    let of_view =
        |(view, seen): (usize, usize)| (0..seen).map(move |detection| Place { view, frame: scene.frame, detection });
    let places: Vec<Place> = scene.views.iter().map(|v| v.seen.len()).enumerate().flat_map(of_view).collect();
    let n_people = scene.present.len();
    let group: Vec<usize> =
        (0..n_people).map(|_| agreement.len()).chain(places.iter().map(|place| place.view)).collect();
    let shown = |p: usize, at: &Place| agreement[at.view][p][at.detection].affinity;
    let mut affinity = DMatrix::zeros(group.len(), group.len());
    for (i, a) in places.iter().enumerate() {
        for p in 0..n_people {
            let value = if shown(p, a) < MIN_AFFINITY { 0.0 } else { shown(p, a).min(1.0) };
            affinity[(p, n_people + i)] = value;
            affinity[(n_people + i, p)] = value;
        }
        for (j, b) in places[..i].iter().enumerate().filter(|(_, b)| b.view != a.view) {
            let geometry = geometry_affinity(scene.seen(*a), scene.seen(*b), ground.input.noise).unwrap_or(0.0);
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A body with one leg drawn wrong (11 of 19 keypoints agree) and the leg as a detection of its own.
    #[test]
    fn a_legs_own_detection_does_not_cost_the_person_the_rest() {
        let body = Agreement { affinity: 0.55, n_shared: 19 };
        let leg = Agreement { affinity: 0.9, n_shared: 5 };
        let stranger = Agreement { affinity: 0.31, n_shared: 25 };
        let claimed = |of_view: &[Vec<Agreement>], mut claims: Vec<Vec<Option<usize>>>| {
            prefer_the_whole(of_view, 0, &mut claims);
            claims.into_iter().map(|of_person| of_person[0]).collect::<Vec<_>>()
        };
        assert_eq!(claimed(&[vec![body, leg, stranger]], vec![vec![Some(1)]]), [Some(0)]);
        assert_eq!(claimed(&[vec![stranger, leg]], vec![vec![Some(1)]]), [Some(1)]);
        let nobody = Agreement::default();
        let both = [vec![body, leg], vec![body, nobody]];
        assert_eq!(claimed(&both, vec![vec![Some(1)], vec![Some(0)]]), [Some(1), Some(0)], "it is somebody else's");
        assert_eq!(claimed(&[vec![body, leg]], vec![vec![None]]), [None]);
    }
}
