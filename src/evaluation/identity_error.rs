//! Who was taken for whom: identities of detections against the truth.

use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// One detection.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct IdentityRow {
    /// Who it really is.
    pub truth: Option<i64>,
    /// Who the result says it is; `None`: rejected.
    pub given: Option<String>,
    /// What the tracker called it.
    pub track_id: Option<i64>,
}

/// How well detections were given to people.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct IdentityError {
    /// Detections given to the right person / given to anyone.
    pub accuracy: f64,
    /// Detections given to anyone / all.
    pub coverage: f64,
    /// Detections.
    pub n: usize,
    /// People in the result.
    pub people_predicted: usize,
    /// Detections whose track id names somebody else; `None` where track ids do not name true people at all.
    pub n_swapped: Option<usize>,
    /// Of them given to the right person.
    pub swapped_recall: Option<f64>,
}

/// Compares identities. People of the result are mapped one to one onto true people, greedily by the most shared
/// detections over the whole session; ties go to the pair met first in `rows`.
pub fn identity_error(rows: &[IdentityRow]) -> IdentityError {
    let truth_of = true_person_of(rows);
    let is_right =
        |row: &&IdentityRow| row.given.as_deref().is_some_and(|given| truth_of.get(given) == Some(&row.truth));
    let given = rows.iter().filter(|row| row.given.is_some()).count();
    let right = rows.iter().filter(is_right).count();
    let swapped: Vec<&IdentityRow> =
        rows.iter().filter(|row| row.track_id.is_some() && row.track_id != row.truth).collect();
    let ids_name_people = rows.iter().any(|row| row.track_id.is_some() && row.track_id == row.truth);
    let recalled = swapped.iter().filter(|row| is_right(row)).count();
    let share = |part: usize, of: usize| part as f64 / of.max(1) as f64;
    IdentityError {
        accuracy: share(right, given),
        coverage: share(given, rows.len()),
        n: rows.len(),
        people_predicted: rows.iter().filter_map(|row| row.given.as_deref()).collect::<BTreeSet<_>>().len(),
        n_swapped: ids_name_people.then_some(swapped.len()),
        swapped_recall: (ids_name_people && !swapped.is_empty()).then(|| share(recalled, swapped.len())),
    }
}

/// The true person behind each person of the result.
fn true_person_of(rows: &[IdentityRow]) -> BTreeMap<&str, Option<i64>> {
    struct Vote<'a> {
        truth: Option<i64>,
        given: &'a str,
        count: usize,
    }
    let mut votes: Vec<Vote> = Vec::new();
    for row in rows {
        let Some(given) = row.given.as_deref() else { continue };
        match votes.iter_mut().find(|vote| vote.truth == row.truth && vote.given == given) {
            Some(vote) => vote.count += 1,
            None => votes.push(Vote { truth: row.truth, given, count: 1 }),
        }
    }
    votes.sort_by_key(|vote| std::cmp::Reverse(vote.count));
    let mut truth_of = BTreeMap::new();
    for vote in votes {
        let taken = truth_of.values().any(|truth| *truth == vote.truth);
        if !taken && !truth_of.contains_key(vote.given) {
            truth_of.insert(vote.given, vote.truth);
        }
    }
    truth_of
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(truth: i64, given: Option<&str>, track_id: Option<i64>) -> IdentityRow {
        IdentityRow { truth: Some(truth), given: given.map(str::to_owned), track_id }
    }

    #[test]
    fn names_do_not_matter_but_mixing_people_does() {
        let rows = [
            row(0, Some("b"), Some(0)),
            row(0, Some("b"), Some(1)),
            row(1, Some("a"), Some(1)),
            row(1, Some("b"), Some(0)),
            row(1, None, Some(1)),
        ];
        let found = identity_error(&rows);
        assert_eq!((found.accuracy, found.coverage), (0.75, 0.8));
        // Two ids were swapped; the result kept the first of them with its person.
        assert_eq!((found.n_swapped, found.swapped_recall), (Some(2), Some(0.5)));
        assert_eq!(found.people_predicted, 2);
    }

    #[test]
    fn ids_that_name_nobody_are_not_called_swapped() {
        let found = identity_error(&[row(0, Some("0"), Some(55)), row(1, Some("1"), None)]);
        assert_eq!((found.accuracy, found.n_swapped, found.swapped_recall), (1.0, None, None));
    }
}
