//! Fragments of one person, joined across the time in which nobody saw them.

use super::Scene;
use super::person::TrackedPerson;
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
        people[i].claims.extend(later.claims);
        people[i].skeletons.extend(later.skeletons);
        people.remove(j);
    }
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
