//! A person's points in a detector's file: one flat list of triples, a list of triples, or a list of pairs.

use crate::session::recording::Keypoint;
use crate::session::upload::detections::MAX_COORDINATE_PX;
use nalgebra::Vector2;
use serde::de::{Deserialize, Deserializer, Error, SeqAccess, Visitor};
use std::fmt;

/// Points in the source's order; a null or `[null, ...]` is a missing point, a pair has confidence 1.
///
/// Where all are null the list is empty: trackers write this for people who are not there. Confidences are as written, but never below 0; a missing point lies at (0, 0).
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Points(pub(super) Vec<Keypoint>);

/// Largest number of entries of a person.
const MAX_ENTRIES: usize = 3000;

/// A keypoint, missing where a value is NaN or the confidence is not positive, or the reason why it is invalid.
pub(super) fn checked_point(x: f64, y: f64, confidence: f64) -> Result<Keypoint, String> {
    if confidence.is_nan() || x.is_nan() || y.is_nan() || confidence <= 0.0 {
        return Ok(missing());
    }
    if x.abs() > MAX_COORDINATE_PX || y.abs() > MAX_COORDINATE_PX || !confidence.is_finite() {
        return Err(format!(
            "a keypoint lies at ({x:e}, {y:e}) px with confidence {confidence}, expected at most {MAX_COORDINATE_PX:e} px and a finite confidence"
        ));
    }
    Ok(Keypoint::new(Vector2::new(x, y), confidence))
}

/// A point that was not detected.
pub(super) fn missing() -> Keypoint {
    Keypoint::MISSING
}

impl<'de> Deserialize<'de> for Points {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(PointsVisitor)
    }
}

struct PointsVisitor;

impl<'de> Visitor<'de> for PointsVisitor {
    type Value = Points;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of [x, y, confidence]")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Points, A::Error> {
        let mut points = Vec::new();
        let (mut open, mut n_open) = ([0.0; 3], 0);
        for n_entries in 0.. {
            let Some(entry) = seq.next_element::<Entry>()? else { break };
            if n_entries == MAX_ENTRIES {
                return Err(A::Error::custom(format!("a person has more than {MAX_ENTRIES} numbers")));
            }
            match entry {
                Entry::Number(number) => {
                    open[n_open] = number;
                    n_open += 1;
                }
                Entry::Point(_) if n_open > 0 => return Err(A::Error::custom("a list mixes points and numbers")),
                Entry::Point(triple) => points.push(triple),
            }
            if n_open == 3 {
                points.push(open);
                n_open = 0;
            }
        }
        if n_open > 0 {
            return Err(A::Error::custom("the numbers of a person are not triples of x, y, confidence"));
        }
        if points.iter().all(|[x, y, _]| x.is_nan() || y.is_nan()) {
            return Ok(Points::default());
        }
        let checked = points.into_iter().map(|[x, y, confidence]| checked_point(x, y, confidence));
        checked.collect::<Result<_, _>>().map(Points).map_err(A::Error::custom)
    }
}

enum Entry {
    Number(f64),
    Point([f64; 3]),
}

impl<'de> Deserialize<'de> for Entry {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(EntryVisitor)
    }
}

struct EntryVisitor;

impl<'de> Visitor<'de> for EntryVisitor {
    type Value = Entry;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number or [x, y, confidence]")
    }

    fn visit_f64<E: Error>(self, number: f64) -> Result<Entry, E> {
        Ok(Entry::Number(number))
    }

    fn visit_u64<E: Error>(self, number: u64) -> Result<Entry, E> {
        Ok(Entry::Number(number as f64))
    }

    fn visit_i64<E: Error>(self, number: i64) -> Result<Entry, E> {
        Ok(Entry::Number(number as f64))
    }

    fn visit_unit<E: Error>(self) -> Result<Entry, E> {
        Ok(Entry::Number(f64::NAN))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Entry, A::Error> {
        let mut triple = [f64::NAN, f64::NAN, 1.0];
        let mut n = 0;
        while let Some(number) = seq.next_element::<Option<f64>>()? {
            if n == 3 {
                return Err(A::Error::custom("a point has more than 3 numbers"));
            }
            triple[n] = number.unwrap_or(f64::NAN);
            n += 1;
        }
        Ok(Entry::Point(triple))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_three_layouts_alike() {
        let read = |text: &str| serde_json::from_str::<Points>(text).map(|points| points.0).map_err(|e| e.to_string());
        let expected = vec![Keypoint::new(Vector2::new(1.0, 2.5), 0.5), missing()];
        assert_eq!(read("[1, 2.5, 0.5, 7, 7, 0]"), Ok(expected.clone()));
        assert_eq!(read("[[1, 2.5, 0.5], [null, null]]"), Ok(expected.clone()));
        assert_eq!(read("[[1, 2.5, 0.5], [3, 4, -1]]"), Ok(expected));
        assert_eq!(read("[[1, 2]]").unwrap()[0].confidence, 1.0);
        assert_eq!(read("[null, null, null, null, null, null]"), Ok(Vec::new()));
        for bad in ["[1, 2]", "[1, [2, 3]]", "[[1, 2, 3, 4]]", "[1e9, 1, 1]", "[\"1\"]", "{}"] {
            assert!(read(bad).is_err(), "{bad}");
        }
    }
}
