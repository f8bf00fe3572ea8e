//! Matching of the result's people to true people, frame by frame.

use super::camera_error::mean;
use super::shelf14::Shelf14;
use serde::Serialize;
use std::collections::BTreeMap;

/// People of one frame, by name.
pub type People<J> = BTreeMap<String, J>;
/// People of every frame, by the session's frame number.
pub type Frames<J> = BTreeMap<i64, People<J>>;

/// How people of the result are matched to true people in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Matching {
    /// Each true person is matched to the nearest one; several may share it. The rule of the literature.
    Nearest,
    /// One to one, greedily by distance.
    One2one,
}

/// Mean distance over the common joints, m; `None` where there are none.
pub(super) fn mean_distance(truth: &Shelf14, solved: &Shelf14) -> Option<f64> {
    mean(truth.iter().zip(solved).filter_map(|(t, s)| Some(((*t)? - (*s)?).norm())))
}

/// Calls `visit(true person, true pose, matched pose)` for every true person of every frame.
pub(super) fn for_each_match<'a>(
    truth: &'a Frames<Shelf14>,
    solved: &'a Frames<Shelf14>,
    matching: Matching,
    mut visit: impl FnMut(&'a str, &'a Shelf14, Option<&'a Shelf14>),
) {
    let no_people = People::new();
    for (frame, true_people) in truth {
        let people = solved.get(frame);
        let matches = matched(true_people, people.unwrap_or(&no_people), matching);
        for (actor, pose) in true_people {
            let found = matches.get(actor.as_str()).and_then(|name| people.and_then(|people| people.get(*name)));
            visit(actor, pose, found);
        }
    }
}

/// The matched name in the result for each true person with a match.
pub(super) fn matched<'a>(
    truth: &'a People<Shelf14>,
    solved: &'a People<Shelf14>,
    matching: Matching,
) -> BTreeMap<&'a str, &'a str> {
    let mut distances: Vec<(&str, &str, f64)> = Vec::with_capacity(truth.len() * solved.len());
    for (actor, true_pose) in truth {
        for (name, pose) in solved {
            // A pair without a common joint is not matched.
            distances.extend(mean_distance(true_pose, pose).map(|d| (actor.as_str(), name.as_str(), d)));
        }
    }
    distances.sort_by(|a, b| a.2.total_cmp(&b.2));
    let mut matches = BTreeMap::new();
    for (actor, name, _) in distances {
        let taken = matching == Matching::One2one && matches.values().any(|other| *other == name);
        if !taken && !matches.contains_key(actor) {
            matches.insert(actor, name);
        }
    }
    matches
}
