//! Fragments of one person, joined across the time in which nobody saw them.

use super::person::TrackedPerson;
use super::{Scene, TrackerConfig};
use crate::optim::robust::median;

/// Fragments further apart than this in time are left apart, s: nothing but place and size speaks for them.
const MAX_GAP: f64 = 4.0;

/// Someone out of sight is expected within this distance, m, growing with their walking speed.
const REACH: f64 = 0.5;

/// Walking speed, m/s.
const WALK: f64 = 1.2;

/// Joins fragments end to start, nearest first.
pub(super) fn join_fragments(scene: &Scene, mut people: Vec<TrackedPerson>) -> Vec<TrackedPerson> {
    loop {
        let mut best: Option<(f64, usize, usize)> = None;
        for (i, earlier) in people.iter().enumerate() {
            for (j, later) in people.iter().enumerate() {
                if i == j {
                    continue;
                }
                let cost = gap_cost(scene, earlier, later);
                if let Some(cost) = cost.filter(|c| best.is_none_or(|b| *c < b.0)) {
                    best = Some((cost, i, j));
                }
            }
        }
        let Some((_, i, j)) = best else { return people };
        let later = people[j].clone();
        people[i].continue_as(later);
        people.remove(j);
    }
}

/// The person out of sight, if any, who comes back as `newborn`: somebody who moved faster than predicted is not two people.
pub(super) fn returned(
    scene: &Scene,
    config: &TrackerConfig,
    newborn: &TrackedPerson,
    people: &[TrackedPerson],
) -> Option<usize> {
    let cost = |(i, person): (usize, &TrackedPerson)| Some((gap_cost(scene, person, newborn)?, i));
    let lost = people.iter().enumerate().filter(|(_, person)| person.is_real(scene, config));
    lost.filter_map(cost).min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, i)| i)
}

/// Distance from where `earlier` should be to where `later` starts, as a share of what is believable.
fn gap_cost(scene: &Scene, earlier: &TrackedPerson, later: &TrackedPerson) -> Option<f64> {
    if later.first() <= earlier.last_seen() {
        return None;
    }
    let seconds = (later.first() - earlier.last_seen()) as f64 / scene.fps;
    if seconds > MAX_GAP {
        return None;
    }
    let predicted = earlier.predict(later.first(), scene.fps);
    let mut distances: Vec<f64> =
        predicted.iter().zip(&later.skeletons[0]).filter_map(|(a, b)| Some(((*a)? - (*b)?).norm())).collect();
    let distance = median(&mut distances)?;
    let reach = REACH + WALK * seconds;
    (distance < reach).then_some(distance / reach + seconds / MAX_GAP)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    /// A person of six points about `x`, first seen at `frame`.
    fn person(frame: usize, x: f64) -> TrackedPerson {
        let skeleton = (0..6).map(|k| Some(Vector3::new(x, 0.2 * f64::from(k), 0.0))).collect();
        TrackedPerson::new(frame, Vec::new(), skeleton)
    }

    #[test]
    fn somebody_who_moved_faster_than_predicted_is_not_two_people() {
        let scene = Scene { views: &[], cameras: &[], bones: &[], fps: 30.0, n_frames: 3 };
        let config = TrackerConfig::default();
        let people = [person(0, 5.0), person(7, 0.0), person(7, 0.3)];
        let found = |frame: usize, x: f64| returned(&scene, &config, &person(frame, x), &people);
        assert_eq!(found(10, -0.4), Some(1), "the nearer of two");
        assert_eq!(found(10, 2.5), None, "too far for anybody");
        assert_eq!(found(7, 0.05), None, "who is in sight does not come back");
        let mut joined = people[1].clone();
        joined.continue_as(person(10, -0.4));
        assert_eq!((joined.first(), joined.last_seen(), joined.skeletons.len()), (7, 10, 2));
    }
}
