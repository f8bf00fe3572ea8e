//! Jitter of motions: mean acceleration, and its error.

use super::camera_error::mean;
use super::person_matching::{Frames, Matching, People, matched};
use super::shelf14::{Point, Shelf14};
use serde::Serialize;

/// Mean acceleration over people and joints.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Jitter {
    /// Mean second difference, mm per frame squared.
    pub mm_per_frame2: Option<f64>,
    /// The same, m/s^2.
    pub m_per_s2: Option<f64>,
    /// Number of second differences.
    pub n: usize,
}

/// Mean of `|x(t+1) - 2 x(t) + x(t-1)|` over all joints known in three consecutive frames.
///
/// People must keep their names over time. A value below the truth's indicates excessive smoothing.
pub fn jitter(frames: &Frames<Vec<Point>>, fps: f64) -> Jitter {
    let mut differences = Vec::new();
    for (frame, people) in frames {
        let (Some(before), Some(after)) = (frames.get(&(frame - 1)), frames.get(&(frame + 1))) else { continue };
        for (name, now) in people {
            let (Some(before), Some(after)) = (before.get(name), after.get(name)) else { continue };
            let joints = before.iter().zip(now).zip(after);
            differences.extend(joints.filter_map(|((b, n), a)| Some(((*a)? - (*n)? * 2.0 + (*b)?).norm())));
        }
    }
    let metres = mean(differences.iter().copied());
    Jitter { mm_per_frame2: metres.map(|m| 1e3 * m), m_per_s2: metres.map(|m| m * fps * fps), n: differences.len() }
}

/// Mean of `|a_solved - a_true|`, `a = x(t+1) - 2 x(t) + x(t-1)`, over the 14 joints of `actors`, mm per frame squared.
///
/// People are matched one to one in the middle frame; a person of the result whose name does not occur in all three frames is
/// ignored.
pub fn acceleration_error(truth: &Frames<Shelf14>, solved: &Frames<Shelf14>, actors: &[String]) -> Option<f64> {
    let mut differences = Vec::new();
    for frame in truth.keys() {
        let (Some(true_people), Some(people)) = (three_frames(truth, *frame), three_frames(solved, *frame)) else {
            continue;
        };
        for (actor, name) in matched(true_people[1], people[1], Matching::One2one) {
            let poses = |[before, now, after]: [&People<Shelf14>; 3], name: &str| {
                Some([*before.get(name)?, *now.get(name)?, *after.get(name)?])
            };
            let (Some(t), Some(s)) = (poses(true_people, actor), poses(people, name)) else { continue };
            if actors.iter().any(|a| a == actor) {
                let second_difference = |p: &[Shelf14; 3], j: usize| Some(p[2][j]? - p[1][j]? * 2.0 + p[0][j]?);
                differences.extend(
                    (0..t[0].len())
                        .filter_map(|j| Some((second_difference(&s, j)? - second_difference(&t, j)?).norm())),
                );
            }
        }
    }
    mean(differences.into_iter()).map(|m| 1e3 * m)
}

/// A frame and its two neighbours.
fn three_frames(frames: &Frames<Shelf14>, frame: i64) -> Option<[&People<Shelf14>; 3]> {
    Some([frames.get(&(frame - 1))?, frames.get(&frame)?, frames.get(&(frame + 1))?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use std::collections::BTreeMap;

    #[test]
    fn measures_gravity_and_ignores_gaps() {
        let at = |frame: i64| Some(Vector3::new(0.0, -0.5 * 9.81 * (frame as f64 / 50.0).powi(2), 0.0));
        let mut frames: Frames<Vec<Point>> = Frames::new();
        for frame in [0, 1, 2, 3, 7, 8] {
            frames.insert(frame, BTreeMap::from([("0".to_owned(), vec![at(frame), None])]));
        }
        let found = jitter(&frames, 50.0);
        assert_eq!(found.n, 2);
        assert!((found.m_per_s2.unwrap() - 9.81).abs() < 1e-9);
        assert_eq!(jitter(&Frames::new(), 50.0).m_per_s2, None);
    }

    #[test]
    fn acceleration_error_ignores_drift_and_counts_trembling() {
        let person = |frame: i64, extra: f64| -> Shelf14 {
            std::array::from_fn(|j| Some(Vector3::new(0.02 * frame as f64 + extra, 0.1 * j as f64, 0.0)))
        };
        let take = |name: &str, extra: &dyn Fn(i64) -> f64| -> Frames<Shelf14> {
            (0..20).map(|t| (t, BTreeMap::from([(name.to_owned(), person(t, extra(t)))]))).collect()
        };
        let (truth, actors) = (take("a", &|_| 0.0), ["a".to_owned()]);
        let drifting = acceleration_error(&truth, &take("7", &|t| 0.01 * t as f64), &actors).unwrap();
        assert!(drifting < 1e-9);
        // Alternating by 2 mm: every second difference is 8 mm.
        let trembling = take("7", &|t| if t % 2 == 0 { 2e-3 } else { -2e-3 });
        assert!((acceleration_error(&truth, &trembling, &actors).unwrap() - 8.0).abs() < 1e-9);
        assert_eq!(acceleration_error(&truth, &trembling, &["b".to_owned()]), None);
    }
}
