//! Accuracy of the identities of detections.

use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// Identities of one detection.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct IdentityRow {
    /// The true person; `None`: the detection shows no person (a ghost).
    pub truth: Option<i64>,
    /// The person in the result; `None`: rejected.
    pub given: Option<String>,
    /// The detector's track number.
    pub track_id: Option<i64>,
}

/// Accuracy and coverage of the assignment of detections to people.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct IdentityError {
    /// Share of the assigned detections that have the right person, 0 to 1; an assigned ghost is wrong.
    pub accuracy: f64,
    /// Share of the detections of people that are assigned to a person, 0 to 1.
    pub coverage: f64,
    /// Detections.
    pub n: usize,
    /// Number of people in the result.
    pub people_predicted: usize,
    /// Detections with a swapped track number; `None` where track numbers do not correspond to true people at all.
    pub n_swapped: Option<usize>,
    /// Share of the swapped detections that have the right person, 0 to 1.
    pub swapped_recall: Option<f64>,
}

/// Compares identities. People of the result are mapped one to one to true people, greedily by the number of common
/// detections over the whole session; among equal pairs the first one in `rows` is taken.
pub fn identity_error(rows: &[IdentityRow]) -> IdentityError {
    let truth_of = true_person_of(rows);
    let is_right = |row: &&IdentityRow| {
        let expected = row.given.as_deref().and_then(|given| truth_of.get(given));
        row.truth.is_some() && expected == row.truth.as_ref()
    };
    let given = rows.iter().filter(|row| row.given.is_some()).count();
    let people: Vec<&IdentityRow> = rows.iter().filter(|row| row.truth.is_some()).collect();
    let right = people.iter().copied().filter(is_right).count();
    let swapped: Vec<&IdentityRow> =
        people.iter().copied().filter(|row| row.track_id.is_some() && row.track_id != row.truth).collect();
    let ids_name_people = people.iter().any(|row| row.track_id == row.truth);
    let recalled = swapped.iter().filter(|row| is_right(row)).count();
    let share = |part: usize, of: usize| part as f64 / of.max(1) as f64;
    IdentityError {
        accuracy: share(right, given),
        coverage: share(people.iter().filter(|row| row.given.is_some()).count(), people.len()),
        n: rows.len(),
        people_predicted: rows.iter().filter_map(|row| row.given.as_deref()).collect::<BTreeSet<_>>().len(),
        n_swapped: ids_name_people.then_some(swapped.len()),
        swapped_recall: (ids_name_people && !swapped.is_empty()).then(|| share(recalled, swapped.len())),
    }
}

/// The true person of each person of the result; a person of ghosts alone has none.
fn true_person_of(rows: &[IdentityRow]) -> BTreeMap<&str, i64> {
    struct Pair<'a> {
        truth: i64,
        given: &'a str,
        count: usize,
    }
    let mut pairs: Vec<Pair> = Vec::new();
    for row in rows {
        let (Some(given), Some(truth)) = (row.given.as_deref(), row.truth) else { continue };
        match pairs.iter_mut().find(|pair| pair.truth == truth && pair.given == given) {
            Some(pair) => pair.count += 1,
            None => pairs.push(Pair { truth, given, count: 1 }),
        }
    }
    pairs.sort_by_key(|pair| std::cmp::Reverse(pair.count));
    let mut truth_of = BTreeMap::new();
    for pair in pairs {
        let taken = truth_of.values().any(|truth| *truth == pair.truth);
        if !taken && !truth_of.contains_key(pair.given) {
            truth_of.insert(pair.given, pair.truth);
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
    fn ignores_names_and_counts_mixed_people() {
        let rows = [
            row(0, Some("b"), Some(0)),
            row(0, Some("b"), Some(1)),
            row(1, Some("a"), Some(1)),
            row(1, Some("b"), Some(0)),
            row(1, None, Some(1)),
        ];
        let found = identity_error(&rows);
        assert_eq!((found.accuracy, found.coverage), (0.75, 0.8));
        // Two track numbers were swapped; the result assigns the first of them correctly.
        assert_eq!((found.n_swapped, found.swapped_recall), (Some(2), Some(0.5)));
        assert_eq!(found.people_predicted, 2);
    }

    #[test]
    fn assigned_ghosts_are_wrong_and_rejected_ones_are_not_missed() {
        let ghost =
            |given: Option<&str>| IdentityRow { truth: None, given: given.map(str::to_owned), track_id: Some(9) };
        let mut rows = vec![row(0, Some("a"), Some(0)), row(1, Some("b"), Some(1)), ghost(None)];
        let found = identity_error(&rows);
        assert_eq!((found.accuracy, found.coverage, found.n_swapped), (1.0, 1.0, Some(0)));
        // A person of ghosts alone, and a ghost in the track of a person.
        rows.extend([ghost(Some("c")), ghost(Some("a"))]);
        let found = identity_error(&rows);
        assert_eq!((found.accuracy, found.coverage, found.people_predicted), (0.5, 1.0, 3));
    }

    #[test]
    fn unrelated_track_numbers_are_not_swapped() {
        let found = identity_error(&[row(0, Some("0"), Some(55)), row(1, Some("1"), None)]);
        assert_eq!((found.accuracy, found.n_swapped, found.swapped_recall), (1.0, None, None));
    }
}
